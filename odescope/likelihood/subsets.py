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

LARGEST = 3  # of these sets
MANY = 150  # candidates: of more, sets of three are too many
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
    for members, worth in _of_every_size(left, pull, min(int(here.sum()), LARGEST if len(here) <= MANY else 2)):
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
        members, worth = list[tuple[int, int, int]](), list[float]()
        for first in range(c - 2):
            rest = slice(first + 1, None)
            known = information[rest, first]
            left, lacking = information[rest, rest] - np.outer(known, known), pull[rest] - known * pull[first]
            pairs = _pairs(*_unit(left, lacking))
            i, j = np.unravel_index(int(np.argmax(pairs)), pairs.shape)
            members.append((first, first + 1 + int(min(i, j)), first + 1 + int(max(i, j))))
            worth.append(float(pull[first] ** 2 + pairs[i, j]))
        yield np.array(members), np.array(worth)


def _pairs(information: FloatArray, pull: FloatArray) -> FloatArray:
    """Return what every two explain (c, c), nothing where they cannot be told apart."""
    apart = 1.0 - information**2
    one, other = pull[:, None], pull
    worth = (one**2 - 2.0 * information * one * other + other**2) / np.maximum(apart, TOLD_APART)
    explained: FloatArray = np.where(apart > TOLD_APART, worth, 0.0)
    return explained
