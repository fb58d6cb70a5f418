"""Outliers: Huber's loss about the filtered signal, by pseudo-observations (Huber and Ronchetti 2009, section 7.8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records, Stretch
from odescope.signals.differentiators import Differentiator, settled

BEND = 3.0  # standard deviations beyond which a residual counts no more than this
NORMAL = 1.4826  # standard deviation over median absolute deviation of a normal distribution
ROUNDS = 8


@dataclass(frozen=True)
class Clipping:
    """How each coordinate was clipped: for every round the cutoff in hertz, and the bound in the coordinate's unit."""

    rounds: Mapping[str, tuple[tuple[float, float], ...]]


def clip_outliers(
    records: Records, coordinates: Sequence[Coordinate], differentiator: Differentiator
) -> tuple[Records, dict[str, int], Clipping]:
    """Return the records with residuals about the filtered coordinates clipped, how many samples of each, and how.

    Filtering what is clipped minimises Huber's loss of what was recorded; the deviation is the median one, which
    outliers do not move. Cutoff and deviation settle in a few rounds, each beginning from the record itself.
    """
    period = records.runs[0].sample_period
    columns = {c.name: [run.column(c.name) for run in records] for c in coordinates}
    counts, rounds = {}, {}
    for c in coordinates:
        recorded = clipped = columns[c.name]
        taken = []
        for _ in range(ROUNDS):
            found = differentiator.derivatives(clipped, period, c.order)
            joined = np.concatenate([y - s[0] for y, s in zip(recorded, found.values, strict=True)])
            bound = BEND * NORMAL * float(np.median(np.abs(joined - np.median(joined))))
            if bound == 0.0:  # more than half of the samples are on the filtered signal: nothing says what is usual
                break
            taken.append((found.cutoff, bound))
            again = [_clipped(y, s[0], bound) for y, s in zip(recorded, found.values, strict=True)]
            moved = max(float(np.abs(a - b).max()) for a, b in zip(again, clipped, strict=True))
            clipped = again
            if moved < 0.01 * bound:
                break
        columns[c.name] = clipped
        rounds[c.name] = tuple(taken)
        counts[c.name] = sum(int((a != b).sum()) for a, b in zip(clipped, recorded, strict=True))
    return Records(tuple(_replaced(run, columns, k) for k, run in enumerate(records))), counts, Clipping(rounds)


def clip_like(
    clipping: Clipping, stretch: Stretch, coordinates: Sequence[Coordinate], differentiator: Differentiator
) -> Stretch:
    """Return another record clipped as those before."""
    record, columns = stretch.record, {}
    for c in coordinates:
        recorded = clipped = record.column(c.name)
        for cutoff, bound in clipping.rounds[c.name]:
            again = settled(differentiator, cutoff, stretch.cut).derivatives([clipped], record.sample_period, c.order)
            clipped = _clipped(recorded, again.values[0][0], bound)
        columns[c.name] = [clipped]
    return replace(stretch, record=_replaced(record, columns, 0))


def _clipped(recorded: FloatArray, smooth: FloatArray, bound: float) -> FloatArray:
    residual = recorded - smooth
    clipped: FloatArray = np.where(np.abs(residual) > bound, smooth + np.sign(residual) * bound, recorded)
    return clipped


def _replaced(run: Record, columns: dict[str, list[np.ndarray]], k: int) -> Record:
    values = run.values.copy()
    for name, pieces in columns.items():
        values[:, run.names.index(name)] = pieces[k]
    return replace(run, values=values)
