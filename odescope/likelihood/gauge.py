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

WEAK = 100.0  # largest Wald statistic beside a held coefficient that is known to no more than a tenth of its value
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

    That is the best known of the others; where none is known, because all are relative to one that may be nothing, the
    one that makes most of the inertia.

    Args:
        mechanisms: all candidates.
        present: those in the model, ascending.
        held: of these, ascending.
        theta: (mechanisms,) coefficients.
        information: (p, p) about those that were not held.
        size: (mechanisms,) what each makes of the inertia.
    """
    free = np.setdiff1d(present, held)
    wald = np.zeros(len(mechanisms))
    with np.errstate(over="ignore"):  # of coefficients that ran away
        wald[free] = theta[free] ** 2 / np.maximum(np.diag(inverse(information)), 1e-300)
    again = held.copy()
    for group in scale_groups(mechanisms, present):
        own = [k for k in group if k in held]
        others = [k for k in group if k not in held]
        if len(others) < 2 or mechanisms[own[0]].known is not None or max(wald[others]) >= WEAK:
            continue
        best = max(others, key=lambda k: (wald if wald[others].max() > 1.0 else size)[k])
        again[again == own[0]] = best
    return np.sort(again)
