"""Rows out of order or doubled, as loggers that buffer and send again write them: sorted and merged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.recordings.gaps import RawRun
from odescope.recordings.record import Repairs, check_increasing, within

FARTHEST = 32  # rows that a row may be away from its place; if it is further, another recording has begun
PART = 4  # of a short run: nor may a row be further away than this part of it
FEWEST = 20  # rows that tell a clock that ticks coarsely
TICK = 0.75  # of a tick: how far stamps are off even times, at most; rounding alone takes them half a tick off
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
    if (even := _spread(sorted_run)) is not None:
        return replace(sorted_run, t=even, repairs=Repairs(rows, disordered, coarse=float(np.diff(sorted_run.t).max())))
    merged = _merged(sorted_run)
    doubled = len(timed) - len(merged.t)
    return replace(merged, repairs=Repairs(rows, disordered, doubled))


def _spread(run: RawRun) -> FloatArray | None:
    """Return even times (n,) for stamps of a clock that ticks less often than rows come; None where they are not that.

    Many stamps are then those of the row before, with other values, and all are within a tick of a line over the number
    of the row: none is missing.
    """
    t, steps = run.t, np.diff(run.t)
    if len(t) < FEWEST or np.mean(steps == 0.0) <= AMBIGUOUS or not _ambiguous(run):
        return None
    numbers = np.arange(len(t))
    slope, origin = np.polyfit(numbers, t - t[0], 1)  # dates are large numbers
    even: FloatArray = t[0] + origin + slope * numbers
    tick = float(steps[steps > 0.0].min())
    return even if np.abs(t - even).max() < TICK * tick and steps.max() < 2.0 * tick else None


def _ambiguous(run: RawRun) -> bool:
    """Say whether rows of the same time have other values, more often than a row is sent twice by mistake."""
    first = np.flatnonzero(np.diff(run.t, prepend=-np.inf) > 0.0)
    low, high = (f.reduceat(run.values, first, axis=0) for f in (np.fmin, np.fmax))
    return bool(np.mean((high > low).any(axis=1)) > AMBIGUOUS)


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
    if _ambiguous(run):
        check_increasing(run.t, run.rows, run.source)
    with np.errstate(invalid="ignore"):
        values = np.where(same, low, total / counts)  # what was sent twice was measured once
    counts = np.where(same, np.minimum(counts, 1.0), counts)
    return replace(run, t=run.t[first], values=values, rows=run.rows[first], counts=counts)
