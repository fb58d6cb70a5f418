"""The targets at the smoothed states: as these change, as a model has them, and whether it has any there."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.search_space import SearchSpace

SINGULAR = 1e-3  # of its root mean square: a smaller determinant of what multiplies the targets is next to none


def rates(space: SearchSpace) -> FloatArray:
    """Return the targets, as differences of smoothed states say, (targets, N)."""
    segments, frame = space.segments, space.frame
    found: FloatArray = np.empty((len(frame.targets), len(segments.filtered)))
    for low, high in segments.runs:
        slopes = np.gradient(segments.filtered[low:high], segments.step, axis=0)
        for state, after in enumerate(frame.following):
            if after < 0:
                found[-1 - after, low:high] = slopes[:, state]
    return found


def explicit(space: SearchSpace, found: Fit) -> FloatArray:
    """Return the targets as a model has them at the smoothed states, (targets, N); NaN where it has none."""
    matrix, right = _linear_system(space, found)
    solved = np.full_like(right, np.nan)
    with suppress(np.linalg.LinAlgError):
        solved[:] = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    return np.ascontiguousarray(solved.T)


def singular(space: SearchSpace, found: Fit) -> bool:
    """Say whether a model has no targets somewhere between the smoothed states: a denominator passes zero.

    So does a law times a function that does, as v^2 (v' + v - u) = 0. It holds of the record as the law itself does,
    and says nothing of a machine that stands still.
    """
    determinant = np.linalg.det(_linear_system(space, found)[0])
    low, high = float(determinant.min()), float(determinant.max())
    return low * high <= 0.0 or min(abs(low), abs(high)) < SINGULAR * float(np.sqrt(np.mean(determinant**2)))


def _linear_system(space: SearchSpace, found: Fit) -> tuple[FloatArray, FloatArray]:
    """Return what multiplies the targets at the smoothed states, (N, targets, targets), and what it equals."""
    frame, samples = space.frame, len(space.segments.filtered)
    matrix, right = np.zeros((samples, len(frame.targets), len(frame.targets))), np.zeros((samples, len(frame.targets)))
    parts = [(k, p) for k in found.present for p in space.mechanisms[k].parts]
    values = space.evaluated([p.product.term for _, p in parts], found.theta)
    for (k, part), column in zip(parts, values, strict=True):
        size = found.theta[k] * part.share * column
        if part.product.factor is None:
            right[:, part.relation] -= size
        else:
            matrix[:, part.relation, frame.targets.index(part.product.factor)] += size
    return matrix, right
