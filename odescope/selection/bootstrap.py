"""How often each term is chosen when the data are drawn anew: a bootstrap of pieces of the record on their factors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.parallel.workers import Workers, nothing
from odescope.regression.factor import Factor, merge
from odescope.regression.problem import Problem
from odescope.regression.proposers import Proposer, Support
from odescope.selection.criterion import penalty
from odescope.selection.ranking import Candidate
from odescope.selection.sweep import Quotients

REPLICATES = 50  # together no dearer than two sweeps
LEAST_PIVOT = 1e-5  # of unit columns: rounding takes a hundred thousandth of what is left of such a column


@dataclass(frozen=True, eq=False)
class _Drawn:
    """What replicates are drawn from, and how they are searched: the factors of pieces and their Gram matrices.

    Shapes: grams (pieces, m, m) of columns divided by scale (m,); own are the columns with the target, quotients those
    of the library.
    """

    pieces: tuple[Factor, ...]
    grams: FloatArray
    scale: FloatArray
    quotients: Quotients
    own: frozenset[int]
    guess: int
    nested: tuple[Support, ...]
    proposers: tuple[Proposer, ...]


def inclusion(
    problem: Problem,
    chosen: Candidate,
    nested: Sequence[Support],
    proposers: Sequence[Proposer],
    rng: np.random.Generator,
    workers: Workers,
    check: Callable[[], None] = nothing,
) -> FloatArray:
    """Return the share of replicates whose best relation holds each term, (m,).

    A replicate draws as many pieces of the record as there are, with replacement, merges their factors, and searches
    with the chosen relation's guess: one guess instead of m, so that all replicates cost about as much as a sweep.
    Forms of one law count once: a law times a function is counted as the law.

    Args:
        problem: with the factors of the pieces.
        chosen: whose guess is the left-hand side.
        nested: the sets of columns of the sweep; the smallest and the largest that hold the relation are searched.
        proposers: searched with.
        rng: draws the pieces.
        workers: where it is searched.
        check: called several times a second; what it raises ends the search.
    """
    drawn, count = _drawn(problem, chosen, nested, proposers), len(problem.pieces)
    draws = [np.bincount(rng.integers(count, size=count), minlength=count) for _ in range(REPLICATES)]
    chosen_in = np.zeros(len(problem.terms))
    for support in workers.map(_best, draws, drawn, check=check):
        chosen_in[list(support)] += 1.0
    return chosen_in / REPLICATES


def _drawn(problem: Problem, chosen: Candidate, nested: Sequence[Support], proposers: Sequence[Proposer]) -> _Drawn:
    holding = sorted((n for n in nested if set(chosen.support) <= set(n)), key=len)
    searched = (holding[0], holding[-1]) if len(holding) > 1 else tuple(holding)
    scale = problem.factor.scale
    scaled = np.array([(p.r * p.scale / scale) for p in problem.pieces])
    grams = scaled.transpose(0, 2, 1) @ scaled
    own = frozenset(problem.own)
    return _Drawn(problem.pieces, grams, scale, Quotients(problem.terms), own, chosen.guess, searched, tuple(proposers))


def _merged(times: IntArray, drawn: _Drawn) -> Factor:
    """Return the factor of pieces drawn so many times each.

    By Cholesky, ten times as quick as by orthogonal merging, unless a column nearly depends on others.
    """
    gram = np.tensordot(times, drawn.grams, axes=1)
    norms = np.sqrt(np.diag(gram))
    if norms.all():
        try:
            r = np.linalg.cholesky(gram / np.outer(norms, norms)).T
            if np.diag(r).min() > LEAST_PIVOT:
                rows = sum(p.rows * int(n) for p, n in zip(drawn.pieces, times, strict=True))
                return Factor(np.asfortranarray(r), norms * drawn.scale, rows)
        except np.linalg.LinAlgError:  # dependent columns: merge with all digits
            pass
    return merge([p for p, n in zip(drawn.pieces, times, strict=True) for _ in range(n)])


def _best(times: IntArray, drawn: _Drawn) -> Support:
    """Return the relation of least criterion that holds the target and the guess; empty if there is none.

    A multiple of a relation is that relation: what is common to all its terms is divided out.
    """
    factor, guess = _merged(times, drawn), drawn.guess
    found = {
        tuple(sorted((*support, guess)))
        for columns in drawn.nested
        if guess in columns
        for p in drawn.proposers
        for support in p.supports(factor, guess, columns)
    }
    best = _least((s for s in found if set(s) & drawn.own), factor, guess, max(drawn.nested, key=len, default=()))
    if not best:
        return best
    return tuple(sorted(drawn.quotients.primitive(best).values()))


def _least(supports: Iterable[Support], factor: Factor, guess: int, columns: Support) -> Support:
    """Return the support of least criterion, empty of none; the small ones first.

    None explains more than all columns together do: once that cannot pay for its terms, neither can those after it.

    Args:
        supports: with the guess.
        factor: of all columns.
        guess: the left-hand side.
        columns: those that the supports were chosen from.
    """
    dear = float(penalty(factor.rows, 1.0 / factor.width))

    def criterion(support: Support, terms: int) -> float:
        rest = max(factor.unexplained(support, guess), 1e-10 * float(factor.scale[guess]))
        return 2.0 * factor.rows * float(np.log(rest)) + dear * terms

    bound = criterion(columns, 0)
    best, least = Support(), np.inf
    for support in sorted(supports, key=lambda s: (len(s), s)):
        if bound + dear * len(support) > least:
            break
        value = criterion(support, len(support))
        if value < least:
            best, least = support, value
    return best
