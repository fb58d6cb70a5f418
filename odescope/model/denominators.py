"""Where the denominators of a model's explicit form go: a model whose denominator vanishes has a pole there."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.tape import evaluate, write_tape
from odescope.model.model import Model


def denominator_ranges(
    model: Model, columns: FloatArray, rng: np.random.Generator
) -> dict[str, dict[str, list[float]]]:
    """Return the range of each target's denominator over the data and over the box of the data.

    Args:
        model: whose explicit form is looked at.
        columns: states and inputs of the data, (variables, N).
        rng: draws the 4 096 points that sample the box.
    """
    quotients = model.quotients
    tape = write_tape(model.variables, [q.denominator for q in quotients])
    low, high = columns.min(axis=1), columns.max(axis=1)
    box = low[:, None] + (high - low)[:, None] * rng.random((len(columns), 4096))
    ranges: dict[str, dict[str, list[float]]] = {}
    for q, inside, around in zip(quotients, evaluate(tape, columns), evaluate(tape, box), strict=True):
        both = np.concatenate([inside, around])
        ranges[q.target] = {
            "data": [float(inside.min()), float(inside.max())],
            "box": [float(both.min()), float(both.max())],
        }
    return ranges
