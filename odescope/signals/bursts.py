"""Bursts: where a signal is too quick for its filter, as when a reactor ignites, and leaves more than noise there.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.recordings.record import Record, Records
from odescope.signals.estimate import Signals, stride_of

WINDOW = 16  # rows over which the square of what a filter leaves is averaged: about two periods of the highest cutoff
LOUD = 6.0  # times the median of such averages, which noise hardly ever reaches,
CORE = 0.01  # and of the largest of them: further away from the burst it is the filter that rings
FIERCE = 20.0  # largest over median of them: noise that goes with its signal is less uneven
MOST = 0.5  # of all samples, in bursts: what is more is no exception
SHORTEST = 2 * WINDOW  # rows of a piece between bursts
ROUNDS = 4  # beside the largest bursts smaller ones are not seen


def without_bursts(
    signals: Signals, records: Records, estimate: Callable[[Records], Signals]
) -> tuple[Signals, Records] | None:
    """Return signals and samples of the pieces of records between bursts; None where there are no bursts.

    Args:
        signals: of all the records.
        records: what they were filtered from.
        estimate: returns the signals of records.
    """
    pieces = records
    for _ in range(ROUNDS):
        parts = _between_bursts(signals, pieces)
        if parts is None:
            break
        if sum(map(len, parts)) < (1.0 - MOST) * records.samples:
            return None
        pieces = Records.of(parts)
        signals = estimate(pieces)
    return None if pieces is records else (signals, pieces)


def _between_bursts(signals: Signals, records: Records) -> list[Record] | None:
    """Return the pieces of records between their bursts; None where there are none.

    Args:
        signals: of all the records.
        records: what they were filtered from.
    """
    if len(signals.columns) < len(records):
        return None
    rest = [[_rest(signals, c.name, run, k) for c in signals.channels] for k, run in enumerate(records)]
    loud = [np.any([bursts(own) for own in channels], axis=0) for channels in rest]
    if not any(np.any(there) for there in loud):
        return None
    parts = list[Record]()
    for k, (run, there) in enumerate(zip(records, loud, strict=True)):
        edges = np.flatnonzero(np.concatenate([[True], there, [True]])).tolist()
        pairs = [(a, b - 1) for a, b in pairwise(edges) if b - 1 - a >= SHORTEST]
        sample = _samples(signals, run, k)
        # What is dropped at the ends of a record belongs to its first and last piece.
        begin, end = [0, *sample[1:]], [*sample[:-1], len(run)]
        parts += [run.part(begin[a], end[b]) for a, b in pairs]
    return parts


def bursts(rest: FloatArray) -> BoolArray:
    """Return which rows (N,) of a record are in a burst.

    Args:
        rest: (N,) what the filter leaves of a coordinate.
    """
    level = np.convolve(rest**2, np.ones(WINDOW) / WINDOW)[WINDOW // 2 :][: len(rest)]
    usual = float(np.median(level))
    if usual <= 0.0 or level.max() < FIERCE * usual:
        return np.zeros(len(rest), dtype=np.bool_)
    near = np.ones(2 * WINDOW + 1)
    loud: BoolArray = np.convolve(level > max(LOUD * usual, CORE * level.max()), near)[WINDOW:][: len(level)] > 0.5
    return loud


def _samples(signals: Signals, run: Record, number: int) -> list[int]:
    """Return which sample of a record each of its rows is, and that after the last.

    Args:
        signals: of all the records.
        run: the record.
        number: which of all.
    """
    stride = stride_of(signals, run)
    first = round((signals.start[number] - float(run.t[0])) / run.sample_period)
    return [first + stride * row for row in range(signals.columns[number].shape[1] + 1)]


def _rest(signals: Signals, name: str, run: Record, number: int) -> FloatArray:
    """Return what the filter leaves of a coordinate at the rows of a record, (N,).

    Args:
        signals: of all the records.
        name: of the coordinate.
        run: the record.
        number: which of all.
    """
    rest: FloatArray = (
        run.column(name)[_samples(signals, run, number)[:-1]] - signals.columns[number][signals.row(name)]
    )
    return rest
