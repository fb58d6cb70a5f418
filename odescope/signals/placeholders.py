"""A number that a log holds where nothing was read, such as 0 or -999."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.taken_out import taken_out

LEAST = 5  # times that a signal leaps to it and back
OFTEN = 5.0  # times as often as any other value
USUAL = 0.95  # of the steps between other samples are no leaps
LEAP = 3.0  # times such a step


def placeholders(records: Records, coordinates: Sequence[Coordinate]) -> dict[str, float]:
    """Return the number that stands for no reading, of every coordinate that has one.

    Args:
        records: uniformly sampled.
        coordinates: what was measured.
    """
    found = {c.name: placeholder([run.column(c.name) for run in records]) for c in coordinates}
    return {name: value for name, value in found.items() if value is not None}


def without_placeholders(run: Record, known: Mapping[str, float]) -> Record:
    """Return a record in which samples that stand for no reading, the known number exactly, count as not measured."""
    return taken_out(run, {name: run.column(name) == value for name, value in known.items()}) if known else run


def placeholder(columns: Sequence[FloatArray]) -> float | None:
    """Return the value to which samples (N,) leap again and again from elsewhere, exactly; None where there is none."""
    values, count = np.unique(np.concatenate(columns), return_counts=True)
    most = int(count.argmax())
    if count[most] < max(LEAST, OFTEN * np.delete(count, most).max(initial=0)):
        return None
    there = [y == values[most] for y in columns]
    steps = np.concatenate([np.abs(np.diff(y)) for y in columns])
    kind = np.concatenate([t[1:].astype(np.int64) + t[:-1] for t in there])  # how many of the two samples are it
    leaps, others = steps[kind == 1], steps[kind == 0]
    if len(leaps) < 2 * LEAST or not len(others):
        return None
    usual = float(np.quantile(others, USUAL))
    return float(values[most]) if usual > 0.0 and float(np.median(leaps)) > LEAP * usual else None
