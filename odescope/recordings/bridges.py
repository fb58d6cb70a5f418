"""What a column may have done in its gaps: how far a straight line over as many samples is off where all are there."""

from __future__ import annotations

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.recordings.record import Records

WINDOWS = 2000  # of a record at most, spread over it


def bridged(records: Records, name: str) -> tuple[int, float]:
    """Return how long the longest gap of a column is, in samples, and how far a line over as many is off elsewhere.

    That is the root mean square between the ends of the line, over the standard deviation of the column; 0 where
    nothing is missing, and where no stretch is long enough to tell.

    Args:
        records: uniformly sampled.
        name: of the column.
    """
    measured = [run.counted(name) > 0.0 for run in records]
    longest = max((stop - first for there in measured for first, stop in _stretches(~there)), default=0)
    if not longest:
        return 0, 0.0
    spread = float(np.concatenate([run.column(name)[m] for run, m in zip(records, measured, strict=True)]).std())
    off = [
        _off_lines(run.column(name)[first:stop], longest)
        for run, there in zip(records, measured, strict=True)
        for first, stop in _stretches(there)
        if stop - first > longest + 1
    ]
    return longest, float(np.sqrt(np.mean(np.concatenate(off) ** 2))) / spread if off and spread > 0.0 else 0.0


def _off_lines(y: FloatArray, gap: int) -> FloatArray:
    """Return how far values (N,) are from the lines that would bridge gaps of so many samples among them."""
    windows = np.lib.stride_tricks.sliding_window_view(y, gap + 2)
    windows = windows[:: max(len(windows) // WINDOWS, 1)]
    part = np.linspace(0.0, 1.0, gap + 2)
    off: FloatArray = windows - windows[:, :1] * (1.0 - part) - windows[:, -1:] * part
    return off[:, 1:-1].ravel()


def _stretches(inside: BoolArray) -> list[tuple[int, int]]:
    """Return first and stop of every stretch of samples (N,) that are inside."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    return [(int(first), int(stop)) for first, stop in zip(edges[::2], edges[1::2], strict=True)]
