"""Inputs that change by a regular clock of their own while samples are taken off even times.

A controller computes its command at every tick; whoever logs it now and then a little before or after one reads the
command of the last tick. That shows where two samples within one period of the clock always have the same value.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray, IntArray

PHASES = 200  # of the clock that are tried, in one period
MISREAD = 0.02  # of the pairs of samples within a period, at most, differ: rows that were mended
OTHERS = 0.1  # as often as elsewhere a pair within a period may differ, by the clock
SURE = 5.0  # in log-likelihood: by so much the clock is likelier than values that change at any sample


def clock_phase(at: FloatArray, inputs: Sequence[FloatArray]) -> float | None:
    """Return when within a period inputs change, from -1/2 to 1/2; None where that is not seen.

    Args:
        at: (n,) when samples were taken, in periods.
        inputs: (n,) values of each input, NaN where one is missing.
    """
    if not inputs or not np.ptp(at - np.rint(at)):
        return None
    phases = np.arange(PHASES) / PHASES - 0.5
    gained = [sum(_likelier(last_ticks(at, float(phase)), values) for values in inputs) for phase in phases]
    best = max(gained)
    if best < SURE:
        return None
    # Of the phases between two samples none is likelier than another: the middle one, wherever a period begins.
    turns = np.exp(2j * np.pi * phases[np.array(gained) == best])
    return float(np.angle(turns.sum()) / (2.0 * np.pi))


def last_ticks(at: FloatArray, phase: float) -> IntArray:
    """Return the number of the last tick (n,) before samples that were taken `at` (n,) periods."""
    found: IntArray = np.floor(at - phase).astype(np.int64)
    return found


def _likelier(tick: IntArray, values: FloatArray) -> float:
    """Return how much likelier an input (n,) is to change at ticks alone than at any sample, in log-likelihood."""
    there = ~np.isnan(values)
    same, equal = np.diff(tick[there]) == 0, np.diff(values[there]) == 0.0
    pairs, apart = np.count_nonzero(same), np.count_nonzero(~same)
    if not pairs or equal.all():
        return 0.0
    changes = (np.count_nonzero(~equal & ~same) + 0.5) / (apart + 1.0)
    misread = np.count_nonzero(same & ~equal)
    return float((pairs - misread) * np.log((1.0 - OTHERS * changes) / (1.0 - changes)) + misread * np.log(OTHERS))


def by_clock(tick: IntArray, values: FloatArray, count: int) -> FloatArray | None:
    """Return an input (count,) as it is from each tick on, None where it changes between ticks.

    What was not read of a tick is taken to lie in the middle between the ticks before and after.

    Args:
        tick: (n,) the last one before each sample.
        values: (n,) of the input, NaN where one is missing.
        count: ticks, from 0 on.
    """
    there = ~np.isnan(values)
    tick, values = tick[there], values[there]
    same = np.diff(tick) == 0
    if np.sum(same & (np.diff(values) != 0.0)) > MISREAD * max(float(np.sum(same)), 1.0):
        return None
    read, begins = np.unique(tick, return_index=True)
    found: FloatArray = np.interp(np.arange(count), read, values[begins])
    return found
