"""Which mechanisms no data could tell apart: rank at random states, inputs and targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.library.expression import Combination
from odescope.library.mechanism import Mechanism
from odescope.library.tape import evaluate, write_tape
from odescope.recordings.coordinate import Coordinate, Input, state_names
from odescope.regression.factor import factorise

REACH = 3.0  # positions, velocities, inputs and targets are drawn from -3 to 3
POINTS = 2  # a mechanism, used at least, so that no combination fits by chance
SPARE = 4  # times as many are drawn, as functions such as a logarithm have no value at some


def told_apart(
    mechanisms: Sequence[Mechanism],
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    rng: np.random.Generator,
    spans: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[tuple[Mechanism, ...], tuple[tuple[Mechanism, tuple[Mechanism, ...]], ...]]:
    """Return the mechanisms that are no combinations of others, and those left out with what they are combinations of.

    Simple ones are kept first, those named first among equals. One that has values at too few of the random states is
    kept unexamined.

    Args:
        mechanisms: what they add to the relations is compared, all relations stacked.
        coordinates: relation i is that of the i-th.
        inputs: as the mechanisms name them.
        rng: draws the states, inputs, targets and constants.
        spans: ranges of the constants that the mechanisms name.
    """
    values = _values(mechanisms, coordinates, inputs, rng, spans or {})
    simple_first = sorted(range(len(mechanisms)), key=lambda k: mechanisms[k].size)
    points, examined = _finite(values, simple_first)
    if not examined:
        return tuple(mechanisms), ()
    stacked = values[examined][:, :, points].reshape(len(examined), -1).T
    left_out = {
        examined[k]: tuple(mechanisms[examined[j]] for j in sorted(others))
        for k, others in factorise([stacked]).dependent()
    }
    kept = tuple(m for k, m in enumerate(mechanisms) if k not in left_out)
    return kept, tuple((mechanisms[k], left_out[k]) for k in sorted(left_out))


def _values(
    mechanisms: Sequence[Mechanism],
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    rng: np.random.Generator,
    spans: Mapping[str, tuple[float, float]],
) -> FloatArray:
    """Return what the mechanisms add, (mechanisms, relations, points), at random points."""
    angles = {c.name for c in coordinates if c.angle}
    names = [*state_names(coordinates), *(i.name for i in inputs), *(c.target for c in coordinates)]
    reach = np.array([np.pi if name in angles else REACH for name in names])
    count = SPARE * POINTS * len(mechanisms)
    points = rng.uniform(-1.0, 1.0, (len(names), count)) * reach[:, None]
    drawn = [rng.uniform(low, high, count) for low, high in spans.values()]
    added = [
        Combination.of((p.share, p.product.expanded) for p in m.parts if p.relation == r)
        for m in mechanisms
        for r in range(len(coordinates))
    ]
    return evaluate(write_tape([*names, *spans], added), np.vstack([points, *drawn])).reshape(
        len(mechanisms), len(coordinates), count
    )


def _finite(values: FloatArray, order: Sequence[int]) -> tuple[BoolArray, list[int]]:
    """Return the points to compare at, as a mask, and which mechanisms have values at all of them, in this order."""
    finite: BoolArray = np.asarray(np.isfinite(values).all(axis=1))
    examined = list(order)
    while examined:
        points = np.asarray(finite[examined].all(axis=0))
        if points.sum() >= POINTS * len(examined):
            return points, examined
        examined.remove(min(examined, key=lambda k: finite[k].sum()))
    return np.zeros(values.shape[2], dtype=bool), examined
