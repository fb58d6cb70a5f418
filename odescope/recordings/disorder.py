"""Rows out of order or doubled, as loggers that buffer and send again write them: sorted and merged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odescope.errors import InputError
from odescope.recordings.gaps import RawRun
from odescope.recordings.record import Repairs, check_increasing, within

FARTHEST = 32  # rows that a row may be away from its place; if it is further, another recording has begun
PART = 4  # of a short run: nor may a row be further away than this part of it
AMBIGUOUS = 0.1  # of all rows: where more share a time but not their values, the clock is too coarse to tell them apart


def in_order(run: RawRun) -> RawRun:
    """Return the run in the order of its times, rows of the same time merged: values that differ are averaged.

    Rows without a time are left out. The numbers of the rows stay in order too, as if the file had been sorted.

    Raises:
        InputError: time stands still, goes back by many rows, or repeats while the values change, again and again.
    """
    rows = len(run.t)
    run = replace(run, repairs=Repairs(rows))
    if not np.isnan(run.t).any() and np.all(np.diff(run.t) > 0.0):
        return run
    timed = np.flatnonzero(~np.isnan(run.t))
    if len(timed) > 1 and np.ptp(run.t[timed]) == 0.0:
        raise InputError(
            f"time is {run.t[timed[0]]:.9g} in every row{within(run.source)}; name the column that holds the time of"
            " each sample, or set sample_period in its place"
        )
    order = np.argsort(run.t[timed], kind="stable")
    away = np.abs(order - np.arange(len(order)))
    if len(away) and away.max() > min(FARTHEST, len(away) // PART):
        check_increasing(run.t[timed], run.rows[timed], run.source)
    disordered = int(np.sum(run.t[timed] < np.maximum.accumulate(run.t[timed]))) if len(timed) else 0
    sorted_run = replace(run.take(timed[order]), rows=run.rows[timed])
    merged = _merged(sorted_run)
    doubled = len(timed) - len(merged.t)
    return replace(merged, repairs=Repairs(rows, disordered, doubled))


def _merged(run: RawRun) -> RawRun:
    """Return a run whose times do not fall, with rows of the same time as one."""
    first = np.flatnonzero(np.diff(run.t, prepend=-np.inf) > 0.0)
    if len(first) == len(run.t):
        return run
    measured = ~np.isnan(run.values)
    counts = np.add.reduceat(measured, first, axis=0, dtype=np.float64)
    total = np.add.reduceat(np.where(measured, run.values, 0.0), first, axis=0)
    low = np.fmin.reduceat(run.values, first, axis=0)
    same = ~(np.fmax.reduceat(run.values, first, axis=0) > low)
    if np.mean(~same.all(axis=1)) > AMBIGUOUS:
        check_increasing(run.t, run.rows, run.source)
    with np.errstate(invalid="ignore"):
        values = np.where(same, low, total / counts)  # what was sent twice was measured once
    counts = np.where(same, np.minimum(counts, 1.0), counts)
    return replace(run, t=run.t[first], values=values, rows=run.rows[first], counts=counts)
