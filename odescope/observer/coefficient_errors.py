"""What the standard errors of a model's coefficients do to its states, as process noise.

An observer that takes an estimated model for exact believes it more than its record allows: along a log the errors of
the coefficients add up. They move each target by what varies as the terms do, with a memory of a fraction of a period.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import Term
from odescope.library.tape import evaluate, write_tape
from odescope.model.model import Model
from odescope.observer.run import ReadyRecord


def noise_of_coefficients(recordings: Sequence[ReadyRecord]) -> dict[str, float]:
    """Return the process noise of every target that stands for the standard errors of the coefficients.

    With A y = b, a coefficient's error dc moves y by A^-1 dc p, p its product: the variances of all are added, as a
    model file holds no covariance. Their spectral density is that times the ratio of the standard deviations of the
    target's integral and the target: the inverse of an angular frequency.

    Args:
        recordings: of one model.
    """
    model = recordings[0].model
    found = np.max([_densities(model, ready) for ready in recordings], axis=0)
    return dict(zip(model.targets, np.sqrt(found).tolist(), strict=True))


def _densities(model: Model, ready: ReadyRecord) -> FloatArray:
    """Return the spectral densities (T,) in one recording."""
    values = ready.first.values
    names = (*model.variables, *model.targets)
    columns = np.array([values[name] for name in names])
    count, samples = len(model.targets), columns.shape[1]
    variances = np.zeros((count, samples))
    for r, relation in enumerate(model.relations):
        uncertain = [t for t in relation.terms if t.std_error]
        if uncertain:
            terms: list[Term] = [t.term for t in uncertain]
            products = evaluate(write_tape(names, terms), columns)
            for t, product in zip(uncertain, products, strict=True):
                by = 1.0 if t.factor is None else values[t.factor]
                variances[r] += (float(t.std_error or 0.0) * by * product) ** 2
    matrix = evaluate(model.tape, columns[: len(model.variables)])[: count * count].T.reshape(samples, count, count)
    fine = np.all(np.isfinite(matrix), axis=(1, 2)) & np.all(np.isfinite(variances), axis=0)
    fine[fine] &= np.abs(np.linalg.det(matrix[fine])) > 0.0
    if not fine.any():
        return np.zeros(count)
    inverse = np.linalg.inv(matrix[fine])
    moved = np.mean(np.einsum("str,rs->st", inverse**2, variances[:, fine]), axis=0)
    memory = [
        float(np.std(values[c.derivative(c.order - 1)])) / max(float(np.std(values[c.target])), 1e-300)
        for c in model.coordinates
    ]
    densities: FloatArray = moved * np.array(memory)
    return densities
