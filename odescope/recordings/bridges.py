"""What a column may have done in its gaps: how far a straight line over as many samples is off where all are there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray, true_ranges
from odescope.recordings.between_samples import looks_held
from odescope.recordings.record import Records

WINDOWS = 2000  # of all records at most, spread over them, beside one of every stretch


def bridged(records: Records, name: str) -> tuple[int, float]:
    """Return how long the longest gap of a column is, in samples, and how far a line over as many is off elsewhere.

    That is the root mean square between the ends of the line, over the standard deviation of the column; 0 where
    nothing is missing, and where no stretch is long enough to tell. Gaps in which a command that is seen to be held
    kept its value do not count.

    Args:
        records: uniformly sampled.
        name: of the column.
    """
    measured = [run.counted(name) > 0.0 for run in records]
    unknown = (
        stop - first
        for run, there in zip(records, measured, strict=True)
        for first, stop in true_ranges(~there)
        if not _kept(run.column(name), first, stop)
    )
    longest = max(unknown, default=0)
    whole = [
        run.column(name)[first:stop]
        for run, there in zip(records, measured, strict=True)
        for first, stop in true_ranges(there)
    ]
    off = off_lines(whole, longest) if longest else 0.0  # of a column that moves, which has a standard deviation
    return longest, off / float(np.concatenate(whole).std()) if off > 0.0 else 0.0


def _kept(y: FloatArray, first: int, stop: int) -> bool:
    """Say whether a column (N,) is a command that holds its values, and had the same one on both sides of a gap."""
    return bool(y[max(first - 1, 0)] == y[min(stop, len(y) - 1)]) and looks_held(y)


def off_lines(stretches: Sequence[FloatArray], gap: int) -> float:
    """Return the root mean square by which values are off the lines that would bridge gaps among them.

    0 where no stretch is long enough to tell.

    Args:
        stretches: (N,) values each, of which none is missing.
        gap: samples in each gap.
    """
    long = [y for y in stretches if len(y) > gap + 1]
    every = max(sum(len(y) - gap - 1 for y in long) // WINDOWS, 1)
    return float(np.sqrt(np.mean(np.concatenate([_off(y, gap, every) for y in long]) ** 2))) if long else 0.0


def _off(y: FloatArray, gap: int, every: int) -> FloatArray:
    """Return how far values (N,) are from the lines that would bridge gaps among them.

    Args:
        y: the values.
        gap: samples in each.
        every: of the places where one could be is looked at.
    """
    windows = np.lib.stride_tricks.sliding_window_view(y, gap + 2)[::every]
    part = np.linspace(0.0, 1.0, gap + 2)
    off: FloatArray = windows - windows[:, :1] * (1.0 - part) - windows[:, -1:] * part
    return off[:, 1:-1].ravel()
