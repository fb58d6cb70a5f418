"""Outliers: Huber's loss about the filtered signal, by pseudo-observations (Huber and Ronchetti 2009, section 7.8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from odescope.records import Coordinate, Record, Records
from odescope.signals.differentiators import Differentiator

BEND = 3.0  # standard deviations beyond which a residual counts no more than this
NORMAL = 1.4826  # standard deviation over median absolute deviation of a normal distribution
ROUNDS = 8


def clip_outliers(
    records: Records, coordinates: Sequence[Coordinate], differentiator: Differentiator
) -> tuple[Records, dict[str, int]]:
    """Return the records with residuals about the filtered coordinates clipped, and how many samples of each.

    Filtering what is clipped minimises Huber's loss of what was recorded; the deviation is the median one, which
    outliers do not move. Cutoff and deviation settle in a few rounds, each beginning from the record itself.
    """
    period = records.runs[0].sample_period
    columns = {c.name: [run.column(c.name) for run in records] for c in coordinates}
    counts = {}
    for c in coordinates:
        recorded = clipped = columns[c.name]
        for _ in range(ROUNDS):
            smooth = differentiator.derivatives(clipped, period, c.order).values
            residuals = [y - s[0] for y, s in zip(recorded, smooth, strict=True)]
            joined = np.concatenate(residuals)
            bound = BEND * NORMAL * float(np.median(np.abs(joined - np.median(joined))))
            if bound == 0.0:  # more than half of the samples are on the filtered signal: nothing says what is usual
                break
            again = [
                np.where(np.abs(r) > bound, s[0] + np.sign(r) * bound, y)
                for y, s, r in zip(recorded, smooth, residuals, strict=True)
            ]
            moved = max(float(np.abs(a - b).max()) for a, b in zip(again, clipped, strict=True))
            clipped = again
            if moved < 0.01 * bound:
                break
        columns[c.name] = clipped
        counts[c.name] = sum(int((a != b).sum()) for a, b in zip(clipped, recorded, strict=True))
    return Records(tuple(_replaced(run, columns, k) for k, run in enumerate(records))), counts


def _replaced(run: Record, columns: dict[str, list[np.ndarray]], k: int) -> Record:
    values = run.values.copy()
    for name, pieces in columns.items():
        values[:, run.names.index(name)] = pieces[k]
    return replace(run, values=values)
