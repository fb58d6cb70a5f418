"""The targets that a model gives at known states and inputs, and what its relations leave there."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.tape import evaluate
from odescope.model.model import Model


def predicted(model: Model, variables: FloatArray) -> FloatArray:
    """Return the targets (T, N) that a model gives at states and inputs (variables, N); NaN at a pole."""
    count = len(model.targets)
    matrix, right = _coupled(model, variables)
    sound = np.abs(np.linalg.det(matrix)) > 0.0
    found = np.full((variables.shape[1], count), np.nan)
    found[sound] = np.linalg.solve(matrix[sound], right[sound][..., None])[..., 0]
    return found.T


def relation_errors(model: Model, variables: FloatArray, targets: FloatArray) -> list[tuple[float, float]]:
    """Return of every relation the root mean square that it leaves of zero, and that of its target's prediction error.

    Args:
        model: its relations hold at all states and inputs.
        variables: states and inputs (variables, N).
        targets: as they were estimated there, (T, N).
    """
    matrix, right = _coupled(model, variables)
    left = np.einsum("nij,jn->in", matrix, targets) - right.T
    missed = predicted(model, variables) - targets
    return [
        (float(np.sqrt(np.mean(own**2))), float(np.sqrt(np.mean(off**2))))
        for own, off in zip(left, missed, strict=True)
    ]


def _coupled(model: Model, variables: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return A (N, T, T) and b (N, T) of A y' = b."""
    count, values = len(model.targets), evaluate(model.tape, variables)
    matrix = np.moveaxis(values[: count * count].reshape(count, count, -1), -1, 0)
    return matrix, values[count * count :].T
