"""Outliers: Huber's loss about the filtered signal, by pseudo-observations (Huber and Ronchetti 2009, section 7.8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records, Stretch
from odescope.signals.differentiators import Differentiator, derivatives_like

BEND = 3.0  # standard deviations beyond which a residual counts no more than this
NORMAL = 1.4826  # standard deviation over median absolute deviation of a normal distribution
ROUNDS = 8


@dataclass(frozen=True)
class Clipping:
    """How each coordinate is clipped: for every round the cutoff in hertz, and the bound in the coordinate's unit.

    `period` is that of the samples, in seconds.
    """

    rounds: Mapping[str, tuple[tuple[float, float], ...]]
    period: float


def settle_clipping(records: Records, coordinates: Sequence[Coordinate], differentiator: Differentiator) -> Clipping:
    """Return how residuals about the filtered coordinates are to be clipped.

    Filtering what is clipped minimises Huber's loss of what was recorded; the deviation is the median one, which
    outliers do not move. Cutoff and deviation settle in a few rounds, each beginning from the record itself.

    Args:
        records: uniformly sampled, at one period.
        coordinates: what was measured.
        differentiator: filters them.
    """
    period = records.runs[0].sample_period
    rounds = {}
    for c in coordinates:
        recorded = clipped = [run.column(c.name) for run in records]
        measured = [run.counted(c.name) > 0.0 for run in records]
        taken = []
        for _ in range(ROUNDS):
            found = differentiator.derivatives(clipped, period, c.order)
            joined = np.concatenate([(y - s[0])[n] for y, s, n in zip(recorded, found.values, measured, strict=True)])
            bound = BEND * NORMAL * float(np.median(np.abs(joined - np.median(joined))))
            if bound == 0.0:  # more than half of the samples are on the filtered signal: nothing says what is usual
                break
            taken.append((found.cutoff, bound))
            again = [_clipped(y, s[0], bound) for y, s in zip(recorded, found.values, strict=True)]
            moved = max(float(np.abs(a - b).max()) for a, b in zip(again, clipped, strict=True))
            clipped = again
            if moved < 0.01 * bound:
                break
        rounds[c.name] = tuple(taken)
    return Clipping(rounds, period)


def clip_outliers(
    stretches: Sequence[Stretch],
    coordinates: Sequence[Coordinate],
    differentiator: Differentiator,
    clipping: Clipping,
) -> tuple[Stretch, ...]:
    """Return records clipped as was settled.

    Args:
        stretches: uniformly sampled.
        coordinates: what was measured.
        differentiator: with which the clipping was settled.
        clipping: see `settle_clipping`.
    """
    columns, cut = {}, [s.cut for s in stretches]
    for c in coordinates:
        recorded = clipped = [s.record.column(c.name) for s in stretches]
        for cutoff, bound in clipping.rounds[c.name]:
            smooth = derivatives_like(differentiator, cutoff, clipped, cut, clipping.period, c.order)
            clipped = [_clipped(y, s[0], bound) for y, s in zip(recorded, smooth, strict=True)]
        columns[c.name] = clipped
    return tuple(replace(s, record=_replaced(s.record, columns, k)) for k, s in enumerate(stretches))


def count_clipped(
    before: Sequence[Stretch], after: Sequence[Stretch], coordinates: Sequence[Coordinate]
) -> dict[str, int]:
    """Return how many samples of each coordinate differ.

    Args:
        before: the records as they were.
        after: as they were clipped.
        coordinates: what was measured.
    """
    pairs = [(a.record, b.record) for a, b in zip(before, after, strict=True)]
    return {c.name: sum(int((a.column(c.name) != b.column(c.name)).sum()) for a, b in pairs) for c in coordinates}


def _clipped(recorded: FloatArray, smooth: FloatArray, bound: float) -> FloatArray:
    residual = recorded - smooth
    clipped: FloatArray = np.where(np.abs(residual) > bound, smooth + np.sign(residual) * bound, recorded)
    return clipped


def _replaced(run: Record, columns: dict[str, list[np.ndarray]], k: int) -> Record:
    values = run.values.copy()
    for name, clipped in columns.items():
        values[:, run.names.index(name)] = clipped[k]
    return replace(run, values=values)
