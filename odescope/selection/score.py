"""Held-out scores of many relations in one pass over the blocks of the signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.parallel.workers import Threads
from odescope.regression.factor import Factor, merge
from odescope.regression.problem import Problem
from odescope.regression.proposers import Support

AT_ONCE = 32  # relations evaluated together: their predictions on a block stay in cache


@dataclass(frozen=True, eq=False)
class Scores:
    """What C relations leave of the target, relations fitted on the other folds where a block is held out.

    Shapes: xi (C, m) fitted on all rows; weighted, squares (C,) sums of squares of the held-out residual in rows and in
    samples; total, power, rows, samples those of the target; sound (C,) whether the denominator keeps its sign; gram
    (C, C) products of the residuals of xi, in rows. elsewhere (C,) is what the data beyond the signals add to -2 log
    likelihood, to be compared among relations with the same target terms; None where the signals are all the data.
    """

    xi: FloatArray
    weighted: FloatArray
    squares: FloatArray
    total: float
    power: float
    rows: int
    samples: int
    sound: BoolArray
    gram: FloatArray
    elsewhere: FloatArray | None


def score(problem: Problem, supports: Sequence[Support], left: Sequence[int]) -> Scores:
    """Return the scores of relations.

    Args:
        problem: where they are fitted and tried.
        supports: their columns.
        left: the column of each that has the coefficient 1.
    """
    pairs = list(zip(supports, left, strict=True))
    xi = np.array([problem.factor.solve(s, k) for s, k in pairs])
    held_out = {fold: np.array([f.solve(s, k) for s, k in pairs]) for fold, f in problem.training.items()}

    def on_block(k: int) -> _Part:
        return _on_block(problem, k, held_out[problem.blocks[k].fold], xi)

    count = len(pairs)
    weighted, squares, gram = np.zeros(count), np.zeros(count), np.zeros((count, count))
    total, first, second, rows, samples = 0.0, 0.0, 0.0, 0, 0
    sound, signs = np.ones(count, dtype=np.bool_), np.zeros(count)
    for part in Threads().map(on_block, range(len(problem.blocks))):
        weighted, squares, gram = weighted + part.weighted, squares + part.squares, gram + part.gram
        total, first, second = total + part.total, first + part.first, second + part.second
        rows, samples = rows + part.rows, samples + part.samples
        # A denominator may keep its sign in every block and yet change it from one recording to the next.
        signs = np.where(signs == 0.0, part.signs, signs)
        sound &= (part.signs != 0.0) & (part.signs == signs)
    # About the mean over all blocks: of a stretch at rest, what varies about its own mean is noise.
    power = max(second - first**2 / samples, 0.0)
    elsewhere = None
    if problem.sample is not None:
        everywhere = _evidence(problem, problem.folds, xi, held_out)
        elsewhere = everywhere - _evidence(problem, problem.sample, xi, held_out)
    return Scores(xi, weighted, squares, total, power, rows, samples, sound, gram, elsewhere)


def _evidence(
    problem: Problem, folds: Mapping[int, Factor], xi: FloatArray, held_out: Mapping[int, FloatArray]
) -> FloatArray:
    """Return rows times ln of the held-out square of each relation over the least that its denominator allows, (C,).

    Factors know relations, not predictions, and a multiple of a relation has another size in every stretch of the data.
    So relations with one denominator can be compared, by what their terms without the target leave beside what all such
    terms would; which denominator predicts best, only the signals tell.
    """
    whole = merge(list(folds.values()))
    own = list(problem.own)
    plain = [j for j in range(whole.width) if j not in problem.own]
    products = whole.r[:, own] @ (xi[:, own] * whole.scale[own]).T
    fitted = np.linalg.lstsq(whole.r[:, plain], products, rcond=1e-10)[0]
    least = np.sum((products - whole.r[:, plain] @ fitted) ** 2, axis=0)
    left = np.sum([np.sum((f.r @ (held_out[k] * f.scale).T) ** 2, axis=0) for k, f in folds.items()], axis=0)
    rounding = 1e-20 * np.sum(products**2, axis=0)
    evidence: FloatArray = whole.rows * np.log(np.maximum(left, rounding) / np.maximum(least, rounding))
    return evidence


@dataclass(frozen=True, eq=False)
class _Part:
    """Scores on one block.

    `first` and `second` are the sums of the target and of its square, signs (C,) those of the denominators, 0 where one
    changes it.
    """

    weighted: FloatArray
    squares: FloatArray
    total: float
    first: float
    second: float
    rows: int
    samples: int
    signs: FloatArray
    gram: FloatArray


def _on_block(problem: Problem, k: int, held_out: FloatArray, xi: FloatArray) -> _Part:
    evaluated = problem.evaluated(k)
    measured = problem.measured(k)
    target = problem.row_map.rows(measured[None])
    count, rows = len(xi), len(target)
    weighted, squares, signs = np.zeros(count), np.zeros(count), np.zeros(count)
    left = np.empty((rows, count))
    for start in range(0, count, AT_ONCE):
        now = slice(start, start + AT_ONCE)
        tried, kept = residuals(problem, held_out[now], evaluated)
        final, keeps = residuals(problem, xi[now], evaluated)
        mapped = problem.row_map.rows(np.concatenate([tried, final]))
        weighted[now] = np.einsum("rc,rc->c", mapped[:, : len(tried)], mapped[:, : len(tried)])
        squares[now] = np.einsum("cn,cn->c", tried, tried)
        left[:, now] = mapped[:, len(tried) :]
        signs[now] = keeps * (kept != 0.0)
    total = float(target[:, 0] @ target[:, 0])
    first, second = float(measured.sum()), float(measured @ measured)
    return _Part(weighted, squares, total, first, second, rows, len(measured), signs, left.T @ left)


def residuals(problem: Problem, xi: FloatArray, evaluated: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return target minus prediction (c, n) of relations (c, m), and the sign of their denominators, 0 if it changes.

    The prediction solves the relation for the target: -(terms without it) / (what multiplies it). Where it cannot, the
    residual is 0.

    Args:
        problem: of the target.
        xi: (c, m) coefficients of the relations.
        evaluated: (m + k, n) values of `Problem.evaluated`.
    """
    m = xi.shape[1]
    multiplier = xi[:, list(problem.own)] @ evaluated[m:]
    low, high = multiplier.min(axis=1), multiplier.max(axis=1)
    sign = np.where(low * high > 0.0, np.sign(low), 0.0)
    multiplier[sign == 0.0] = 1.0
    residual: FloatArray = (xi @ evaluated[:m]) / multiplier
    residual[sign == 0.0] = 0.0
    return residual, sign
