"""Bursts: where a signal is too quick for its filter, as when a reactor ignites, and leaves more than noise there.

docs/method.md, Signals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.recordings.record import Record, Records
from odescope.signals.estimate import Channel, Signals

WINDOW = 16  # rows over which what a filter leaves is averaged: about two periods of the highest cutoff
LOUD = 6.0  # times the median of such averages, which noise hardly ever reaches
FIERCE = 2.0  # mean over median of them: noise that goes with its signal is less uneven
MOST = 0.5  # of all rows, in bursts: what is more is no exception
SHORTEST = 2 * WINDOW  # rows of a piece between bursts


def without_bursts(signals: Signals, records: Records) -> tuple[Signals, Records] | None:
    """Return the pieces of records between bursts, with the noise there; None where there are none.

    Args:
        signals: of all the records.
        records: what they were filtered from.
    """
    if len(signals.columns) < len(records):
        return None
    rest = {c.name: [_rest(signals, c, run, k) for k, run in enumerate(records)] for c in signals.channels}
    loud = {name: found for name, own in rest.items() if (found := bursts(own))}
    if not loud:
        return None
    either = [np.any(own, axis=0) for own in zip(*loud.values(), strict=True)]
    pieces = [(k, *piece) for k, there in enumerate(either) for piece in _between(there)]
    if sum(stop - first for _, first, stop in pieces) < (1.0 - MOST) * signals.samples:
        return None
    channels = [_quiet(c, rest[c.name], loud[c.name], records) if c.name in loud else c for c in signals.channels]
    columns = [np.ascontiguousarray(signals.columns[k][:, first:stop]) for k, first, stop in pieces]
    start = [signals.start[k] + first * signals.period for k, first, _ in pieces]
    kept = replace(signals, columns=tuple(columns), start=tuple(start), channels=tuple(channels))
    return kept, Records.of(_part(signals, records.runs[k], k, first, stop) for k, first, stop in pieces)


def bursts(rest: Sequence[FloatArray]) -> tuple[BoolArray, ...]:
    """Return which rows (N,) of every record are in a burst of a channel; nothing where it has none.

    Args:
        rest: (N,) a record, what the filter leaves of the channel.
    """
    levels = [np.convolve(r**2, np.ones(WINDOW) / WINDOW)[WINDOW // 2 :][: len(r)] for r in rest]
    joined = np.concatenate(levels)
    usual = float(np.median(joined))
    if usual <= 0.0 or joined.mean() < FIERCE * usual:
        return ()
    near = np.ones(2 * WINDOW + 1)  # a filter rings about a burst
    return tuple(np.convolve(level > LOUD * usual, near)[WINDOW:][: len(level)] > 0.5 for level in levels)


def _between(loud: BoolArray) -> list[tuple[int, int]]:
    """Return the first row of every piece that is long enough without a loud one, and the one after its last."""
    edges = np.flatnonzero(np.concatenate([[True], loud, [True]]))
    return [(a, b - 1) for a, b in pairwise(edges.tolist()) if b - 1 - a >= SHORTEST]


def _quiet(channel: Channel, rest: Sequence[FloatArray], loud: Sequence[BoolArray], records: Records) -> Channel:
    """Return a channel with the noise that its filter leaves between bursts, above the cutoff.

    Args:
        channel: with the noise of everything.
        rest: (N,) a record, what the filter leaves.
        loud: (N,) which rows are in a burst.
        records: whose samples are white as far as they are noise.
    """
    left = np.concatenate([r[~there] for r, there in zip(rest, loud, strict=True)])
    above = 1.0 - 2.0 * channel.cutoff * records.runs[0].sample_period  # of the frequencies
    noise = float(left.std()) / max(above, 1e-3) ** 0.5
    return replace(channel, noise=min(channel.noise, max(noise, channel.floor)))


def _stride(signals: Signals, run: Record) -> int:
    """Return how many samples of a record make a row."""
    return max(1, round(signals.period / run.sample_period))


def _first(signals: Signals, run: Record, number: int) -> int:
    """Return the sample of a record that is its first row."""
    return round((signals.start[number] - float(run.t[0])) / run.sample_period)


def _rest(signals: Signals, channel: Channel, run: Record, number: int) -> FloatArray:
    """Return what the filter leaves of a channel at the rows of a record, (N,).

    Args:
        signals: of all the records.
        channel: the one.
        run: the record.
        number: which of all.
    """
    filtered = signals.columns[number][signals.row(channel.name)]
    samples = run.column(channel.name)[_first(signals, run, number) :: _stride(signals, run)]
    rest: FloatArray = samples[: len(filtered)] - filtered
    return rest


def _part(signals: Signals, run: Record, number: int, first: int, stop: int) -> Record:
    """Return the samples of a record from one row to another.

    Args:
        signals: of all the records.
        run: the record.
        number: which of all.
        first: row.
        stop: the row after the last.
    """
    stride, begin = _stride(signals, run), _first(signals, run, number)
    return run.part(begin + first * stride, min(begin + stop * stride, len(run)))
