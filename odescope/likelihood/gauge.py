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
from odescope.likelihood.expansion import scaled

WEAK = 100.0  # median Wald statistic beside a held coefficient that is known to no more than a tenth of its value
BETTER = 2.0  # times the median beside it: that of what is held in its place
SINGULAR = 1e-13  # least eigenvalue of a scaled information matrix, over the largest, that is not rounding


def inverse(information: FloatArray) -> FloatArray:
    """Return the covariance (p, p) of coefficients with this information.

    What two terms cannot be told apart by is rounding, of either sign: large variances, never negative ones.
    """
    correlations, scale = scaled(information)
    values, vectors = np.linalg.eigh(correlations)
    values = np.maximum(values, SINGULAR * values.max(initial=1.0))
    with np.errstate(over="ignore"):  # of coefficients of which the data say nothing
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
    mechanisms: Sequence[Mechanism],
    present: IntArray,
    held: IntArray,
    theta: FloatArray,
    information: FloatArray,
    size: FloatArray,
) -> IntArray:
    """Return what is to be held, where a fit held a coefficient that the record hardly knows.

    That is the one beside which the others are known best, as their median has it: two that go together may be well
    known beside each other, and neither beside the rest. Where none is known, because all are relative to one that may
    be nothing, it is the one that makes most of the inertia; where one is, and half of them are beside none, it stays.

    Args:
        mechanisms: all candidates.
        present: those in the model, ascending.
        held: of these, ascending.
        theta: (mechanisms,) coefficients.
        information: (p, p) about those that were not held.
        size: (mechanisms,) what each makes of the inertia.
    """
    free, again = ~np.isin(present, held), held.copy()
    covariance = np.zeros((len(present), len(present)))
    covariance[np.ix_(free, free)] = inverse(information)
    for group in scale_groups(mechanisms, present):
        places = np.searchsorted(present, group)
        own = int(np.flatnonzero(~free[places])[0])
        if len(group) < 3 or mechanisms[group[own]].known is not None:
            continue
        wald = _wald_beside(theta[present[places]], covariance[np.ix_(places, places)])
        medians = np.nanmedian(wald, axis=1)
        if medians[own] >= WEAK:
            continue
        largest, best = np.nanmax(wald[own]), int(np.argmax(medians))
        if largest <= 1.0:
            best = int(np.argmax(np.where(free[places], size[present[places]], -np.inf)))
        elif medians[best] <= BETTER * medians[own] or medians[best] < WEAK <= largest:
            continue
        again[again == group[own]] = group[best]
    return np.sort(again)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of coefficients that ran away, or are nothing
def _wald_beside(theta: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the Wald statistics (g, g) of a scale group beside each of its coefficients, NaN those beside themselves.

    Args:
        theta: (g,) coefficients of the group.
        covariance: (g, g) of these while one is held, whose own are zero.
    """
    relative = covariance / theta / theta[:, None]
    variances = np.diag(relative)
    wald = np.nan_to_num(1.0 / np.maximum(variances + variances[:, None] - 2.0 * relative, 1e-300), nan=0.0)
    np.fill_diagonal(wald, np.nan)
    return wald
