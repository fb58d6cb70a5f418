"""A sensor that is read more often than it measures: the rows that repeat its last value say nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.recordings.repeats import stale
from odescope.signals.taken_out import taken_out

FEWEST = 32  # new values of which a rhythm is told
REGULAR = 0.95  # of the repeats are as long as the usual one, or a row shorter or longer
UNLIKE = 0.25  # of the steps may be of the least size: those of an encoder that turns slowly all are


def without_repeats(records: Records, coordinates: Sequence[Coordinate]) -> Records:
    """Return records in which the repeated values of a slow sensor count as not measured.

    The sensor is slow where its value changes every so many rows, by steps of many sizes: those of an encoder that
    turns slowly are of one. So do single values that a row holds once more.

    Args:
        records: uniformly sampled.
        coordinates: what was measured.
    """
    slow = [c.name for c in coordinates if is_slow([run.column(c.name) for run in records])]
    records = Records.of(_less_repeats(run, slow) for run in records) if slow else records
    gone = [{c.name: stale(run.column(c.name)) for c in coordinates if c.name not in slow} for run in records]
    if not any(own.any() for found in gone for own in found.values()):
        return records
    return Records.of(map(taken_out, records, gone))


def is_slow(columns: Sequence[FloatArray]) -> bool:
    """Tell whether the values (N,) of all records change in a rhythm of two rows or more, and by how much they like."""
    lengths = np.concatenate([np.diff(np.flatnonzero(np.diff(y))) for y in columns])
    if len(lengths) < FEWEST or np.median(lengths) < 2.0:
        return False
    steps = np.concatenate([np.abs(np.diff(y)) for y in columns])
    steps = steps[steps > 0.0]
    regular = np.mean(np.abs(lengths - np.median(lengths)) <= 1.0)
    return bool(regular >= REGULAR and np.mean(steps < 1.5 * steps.min()) <= UNLIKE)


def _less_repeats(run: Record, slow: Sequence[str]) -> Record:
    return taken_out(run, {name: np.concatenate([[False], np.diff(run.column(name)) == 0.0]) for name in slow})
