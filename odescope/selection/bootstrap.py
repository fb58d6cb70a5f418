"""How often each term is chosen when the data are drawn anew: a bootstrap of pieces of the record on their factors."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.regression.factor import Factor, merge
from odescope.regression.proposers import Proposer, Support
from odescope.selection.problem import Problem
from odescope.selection.rank import Candidate

REPLICATES = 50  # together no dearer than two sweeps
LEAST_PIVOT = 1e-4  # of unit columns


def inclusion(
    problem: Problem,
    chosen: Candidate,
    nested: Sequence[Support],
    proposers: Sequence[Proposer],
    rng: np.random.Generator,
) -> FloatArray:
    """Return the share of replicates whose best relation holds each term, (m,).

    A replicate draws as many pieces of the record as there are, with replacement, merges their factors, and searches
    with the chosen relation's guess: one guess instead of m, so that all replicates cost about as much as a sweep.

    Args:
        problem: with the factors of the pieces.
        chosen: whose guess is the left-hand side.
        nested: the sets of columns of the sweep; the smallest and the largest that hold the relation are searched.
        proposers: searched with.
        rng: draws the pieces.
    """
    holding = sorted((n for n in nested if set(chosen.support) <= set(n)), key=len)
    nested = [holding[0], holding[-1]] if len(holding) > 1 else holding
    count = len(problem.pieces)
    grams = np.array([(p.r * p.scale / problem.factor.scale) for p in problem.pieces])
    grams = np.einsum("pki,pkj->pij", grams, grams)
    draws = [np.bincount(rng.integers(count, size=count), minlength=count) for _ in range(REPLICATES)]

    def best(draw: IntArray) -> Support:
        return _best(_merged(problem, grams, draw), problem, chosen.guess, nested, proposers)

    chosen_in = np.zeros(problem.factor.width)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for support in pool.map(best, draws):
            chosen_in[list(support)] += 1.0
    return chosen_in / REPLICATES


def _merged(problem: Problem, grams: FloatArray, times: IntArray) -> Factor:
    """Return the factor of pieces drawn so many times each.

    By Cholesky, ten times as quick as by orthogonal merging, unless that would lose half of the digits.
    """
    gram = np.tensordot(times, grams, axes=1)
    norms = np.sqrt(np.diag(gram))
    if norms.all():
        try:
            r = np.linalg.cholesky(gram / np.outer(norms, norms)).T
            if np.diag(r).min() > LEAST_PIVOT:
                rows = sum(p.rows * int(n) for p, n in zip(problem.pieces, times, strict=True))
                return Factor(np.ascontiguousarray(r), norms * problem.factor.scale, rows)
        except np.linalg.LinAlgError:  # dependent columns: merge with all digits
            pass
    return merge([p for p, n in zip(problem.pieces, times, strict=True) for _ in range(n)])


def _best(
    factor: Factor, problem: Problem, guess: int, nested: Sequence[Support], proposers: Sequence[Proposer]
) -> Support:
    """Return the relation of least criterion that holds the target and the guess; empty if there is none."""
    found = {
        tuple(sorted((*support, guess)))
        for columns in nested
        if guess in columns
        for p in proposers
        for support in p.supports(factor, guess, columns)
    }
    price = np.log(factor.rows) + 2.0 * np.log(factor.width)

    def criterion(support: Support) -> float:
        rest = max(factor.residual(factor.solve(support, guess)), 1e-10 * float(factor.scale[guess]))
        return 2.0 * factor.rows * float(np.log(rest)) + float(price) * len(support)

    return min((s for s in sorted(found) if set(s) & set(problem.own)), key=criterion, default=())
