"""The best of all small sets of mechanisms that may stand for those of one relation, to second order.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.likelihood.evidence import TOLD_APART
from odescope.likelihood.expansion import Expansion, scaled
from odescope.likelihood.gauge import inverse
from odescope.parallel.kernels import kernel

LARGEST = 3  # of these sets
LOST = 1e-12  # of what the present mechanisms explain: rounding, where others say the same


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of coefficients of which the data say nothing
def subsets(
    expansion: Expansion, theta: FloatArray, present: BoolArray, own: BoolArray, prices: FloatArray, scale: float
) -> list[tuple[float, IntArray]]:
    """Return sets of mechanisms that may stand for the present ones of a relation, and what each earns, best first.

    Of every size that is no more than what is there the best: what several add up to may be one or two others, none
    of which says anything beside them, so that steps one by one do not lead there.

    Args:
        expansion: of the cost about theta, initial states eliminated.
        theta: (f,) coefficients.
        present: (f,) which are in the model.
        own: (f,) which stand in the relation alone, present or not.
        prices: (f,) what each has to earn.
        scale: of the cost, residual variance.
    """
    if not np.any(own & present):
        return []
    information, size = scaled(expansion.information)
    pull, others = (expansion.information @ theta - expansion.gradient) / size, present & ~own
    covariance, cross = inverse(information[np.ix_(others, others)]), information[np.ix_(own, others)]
    left, pull = _unit(
        information[np.ix_(own, own)] - cross @ covariance @ cross.T, pull[own] - cross @ covariance @ pull[others]
    )
    if not (np.isfinite(left).all() and np.isfinite(pull).all()):
        return []
    numbers, here = np.flatnonzero(own), present[own]
    explained = float(pull[here] @ inverse(left[np.ix_(here, here)]) @ pull[here])
    paid, found = prices[own], list[tuple[float, IntArray]]()
    for members, worth in _of_every_size(left, pull, min(int(here.sum()), LARGEST)):
        lost = (explained * (1.0 - LOST) - worth) / scale
        earned = paid[here].sum() - paid[members].sum(axis=1) - lost
        best = int(np.argmax(earned))
        found.append((float(earned[best]), numbers[members[best]]))
    return sorted(found, key=lambda one: -one[0])


def _unit(information: FloatArray, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return information (c, c) with ones on its diagonal, and pull (c,): both zero where others leave nothing."""
    alone = np.diag(information)
    told = alone > TOLD_APART
    weight = np.where(told, 1.0 / np.sqrt(np.where(told, alone, 1.0)), 0.0)
    return information * weight * weight[:, None], pull * weight


def _of_every_size(information: FloatArray, pull: FloatArray, largest: int) -> Iterator[tuple[IntArray, FloatArray]]:
    """Yield sets (s, k) for k = 1, 2, ... and what each explains (s,); of three the best with every first one.

    Args:
        information: (c, c) with ones on the diagonal.
        pull: (c,) on each candidate.
        largest: of the sets.
    """
    c = len(pull)
    if largest >= 1:
        yield np.arange(c)[:, None], pull**2
    if largest >= 2 and c >= 2:
        one, other = np.triu_indices(c, 1)
        yield np.column_stack([one, other]), _pairs(information, pull)[one, other]
    if largest >= 3 and c >= 3:
        yield _threes(information, pull, TOLD_APART)


@kernel()
def _threes(information: FloatArray, pull: FloatArray, apart: float) -> tuple[IntArray, FloatArray]:
    """Return, with every first candidate, the best set of three (c - 2, 3), and what each explains (c - 2,).

    Args:
        information: (c, c) with ones on the diagonal.
        pull: (c,) on each candidate.
        apart: share of a candidate's information that others leave to it, at least, where it is told apart from them.
    """
    c = pull.shape[0]
    members, worth = np.empty((c - 2, 3), dtype=np.int64), np.empty(c - 2)
    left, alone = np.empty(c), np.empty(c)  # pull on a candidate beside the first, and 1 over its standard deviation
    for i in range(c - 2):
        for j in range(i + 1, c):
            rest = 1.0 - information[i, j] ** 2
            alone[j] = 1.0 / np.sqrt(rest) if rest > apart else 0.0
            left[j] = (pull[j] - information[i, j] * pull[i]) * alone[j]
        best, second, third = 0.0, i + 1, i + 2
        for j in range(i + 1, c - 1):
            known, one, weight = information[i, j], left[j], alone[j]
            for k in range(j + 1, c):
                cosine = (information[j, k] - known * information[i, k]) * weight * alone[k]
                own = 1.0 - cosine * cosine
                if own > apart:
                    both = (one * one - 2.0 * cosine * one * left[k] + left[k] * left[k]) / own
                    if both > best:
                        best, second, third = both, j, k
        members[i, 0], members[i, 1], members[i, 2] = i, second, third
        worth[i] = pull[i] ** 2 + best
    return members, worth


def _pairs(information: FloatArray, pull: FloatArray) -> FloatArray:
    """Return what every two explain (c, c), nothing where they cannot be told apart."""
    apart = 1.0 - information**2
    one, other = pull[:, None], pull
    worth = (one**2 - 2.0 * information * one * other + other**2) / np.maximum(apart, TOLD_APART)
    explained: FloatArray = np.where(apart > TOLD_APART, worth, 0.0)
    return explained
