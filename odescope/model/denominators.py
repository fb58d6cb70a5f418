"""Where the denominators of a model's explicit form go: a model whose denominator vanishes has a pole there.

They are determinants of what multiplies the targets, and are worked out as numbers: their sums of products may be long.
"""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.tape import evaluate, write_tape
from odescope.model.explicit import Coupled, blocks
from odescope.model.model import Model

SINGULAR = 1e-13  # of the product of the lengths of its rows: a smaller determinant is rounding


def denominator_ranges(
    model: Model, columns: FloatArray, rng: np.random.Generator
) -> dict[str, dict[str, list[float]]]:
    """Return the range of each target's denominator over the data and over the box of the data.

    Args:
        model: whose explicit form is looked at.
        columns: states and inputs of the data, (variables, N).
        rng: draws the 4 096 points that sample the box.

    Raises:
        InputError: two relations hold one target alone, or a target stands in none.
    """
    low, high = columns.min(axis=1), columns.max(axis=1)
    box = low[:, None] + (high - low)[:, None] * rng.random((len(columns), 4096))
    ranges: dict[str, dict[str, list[float]]] = {}
    for block in blocks(model.relations, model.targets):
        inside, around = (_determinants(model, block, points) for points in (columns, box))
        both = np.concatenate([inside, around])
        for target in block.targets:
            ranges[target] = {
                "data": [float(inside.min()), float(inside.max())],
                "box": [float(both.min()), float(both.max())],
            }
    return ranges


def _determinants(model: Model, block: Coupled, points: FloatArray) -> FloatArray:
    """Return the determinant of what multiplies the targets of a block, at every point (N,)."""
    count = len(block.rows)
    parts = [model.relations[r].part(t) for r in block.rows for t in block.targets]
    entries = evaluate(write_tape(model.variables, parts), points)
    found: FloatArray = entries[0]
    if count == 1:
        return found
    matrices = np.moveaxis(entries.reshape(count, count, -1), -1, 0)
    with np.errstate(invalid="ignore", over="ignore"):
        found = np.asarray(np.linalg.det(matrices), dtype=np.float64)
        size = np.prod(np.linalg.norm(matrices, axis=2), axis=1)
    found[np.abs(found) <= SINGULAR * size] = 0.0
    return found
