"""The scale of a relation is a gauge: one coefficient of every scale group is held, whichever the record knows well.

Relations are homogeneous: those that are tied by common mechanisms keep their meaning when all their coefficients are
multiplied by one number. Cost and scores do not depend on which coefficient is held, Wald statistics do: a weak one
that is held would make all others look weak. docs/method.md, The gauge.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.mechanism import Mechanism, scale_groups
from odescope.likelihood.evaluator import scaled

BETTER = 4.0  # times the Wald statistic that the held coefficient has at best: another pair that has more is held
SINGULAR = 1e-10  # least eigenvalue of a scaled information matrix, over the largest, that is not rounding


def inverse(information: FloatArray) -> FloatArray:
    """Return the covariance (p, p) of coefficients with this information.

    What two terms cannot be told apart by is rounding, of either sign: large variances, never negative ones.
    """
    correlations, scale = scaled(information)
    values, vectors = np.linalg.eigh(correlations)
    values = np.maximum(values, SINGULAR * values.max(initial=0.0))
    covariance: FloatArray = (vectors / values) @ vectors.T / scale / scale[:, None]
    return covariance


def held_of(mechanisms: Sequence[Mechanism], present: IntArray, strength: FloatArray) -> IntArray:
    """Return the mechanisms that are held: those that are known, and the strongest of every group without any.

    Args:
        mechanisms: all candidates.
        present: those in the model.
        strength: of each candidate (mechanisms,).
    """
    held = list[int]()
    for group in map(np.array, scale_groups(mechanisms, present)):
        known = [k for k in group.tolist() if mechanisms[k].known is not None]
        held += known or [int(group[np.argmax(strength[group])])]
    return np.array(sorted(held), dtype=np.int64)


def rechosen(
    mechanisms: Sequence[Mechanism], present: IntArray, held: IntArray, theta: FloatArray, information: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return what is to be held, and the information about the others, where a fit held a weak coefficient.

    Args:
        mechanisms: all candidates.
        present: those in the model, ascending.
        held: of these, ascending.
        theta: (mechanisms,) coefficients.
        information: (p, p) about those that were not held.
    """
    for group in map(np.array, scale_groups(mechanisms, present)):
        own = [k for k in group.tolist() if k in held]
        if len(group) < 3 or len(own) != 1 or mechanisms[own[0]].known is not None:
            continue
        free = np.setdiff1d(present, held)
        wald = np.where(np.isin(free, group), theta[free] ** 2 / np.maximum(np.diag(inverse(information)), 1e-300), 0.0)
        best = int(free[np.argmax(wald)])
        others, moved = _moved(present, held, theta, information, group, own[0], best)
        again = np.setdiff1d(present, others)
        rest = np.isin(again, group) & (again != own[0])
        there = theta[again] ** 2 / np.maximum(np.diag(inverse(moved)), 1e-300)
        if there[rest].max() > BETTER * wald.max():
            held, information = others, moved
    return held, information


def _moved(
    present: IntArray,
    held: IntArray,
    theta: FloatArray,
    information: FloatArray,
    group: IntArray,
    before: int,
    after: int,
) -> tuple[IntArray, FloatArray]:
    """Return held mechanisms and information with another member of a group held.

    Along the scale of a group nothing changes, so what the held coefficient does is minus what all others do together.
    """
    free, others = np.setdiff1d(present, held), np.sort(np.append(held[held != before], after))
    again = np.setdiff1d(present, others)
    slopes = np.zeros((len(free), len(again)))
    for column, k in enumerate(again.tolist()):
        if k == before:
            slopes[:, column] = np.where(np.isin(free, group), -theta[free] / theta[before], 0.0)
        else:
            slopes[int(np.searchsorted(free, k)), column] = 1.0
    return others, slopes.T @ information @ slopes
