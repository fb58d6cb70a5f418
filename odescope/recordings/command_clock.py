"""Inputs that change by a regular clock of their own while samples are taken off even times.

A controller computes its command at every tick; whoever logs it now and then a little before or after one reads the
command of the last tick. That shows where two samples within one period of the clock always have the same value.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.recordings.clock import LOCAL, off_cubics

PHASES = 200  # of the clock that are tried, in one period
NARROWER = (0.05, 0.02, 0.01, 0.003, 0.001)  # periods, from which on phase and drift are looked for together
EACH_SIDE = 5  # of either that are tried
PAIRS = 20_000  # of samples beside each other that tell, at most
MISREAD = 0.02  # of the pairs of samples within a period, at most, differ: rows that were mended
OTHERS = 0.1  # as often as elsewhere a pair within a period may differ, by the clock
SURE = 10.0  # in log-likelihood: by so much the clock is likelier than values that change at any sample


def command_clock(at: FloatArray, inputs: Sequence[FloatArray]) -> tuple[float, float] | None:
    """Return a tick of the clock by which inputs change, and its period; None where that is not seen.

    Args:
        at: (n,) when samples were taken, in periods.
        inputs: (n,) values of each input, NaN where one is missing.
    """
    if not inputs or not np.ptp(at - np.rint(at)):
        return None
    middle, span = 0.5 * (at[0] + at[-1]), at[-1] - at[0]
    pairs = [_pairs(at - middle, values) for values in inputs]
    if not any(equal.any() for _, _, equal in pairs):
        return None

    def best(settings: FloatArray) -> tuple[FloatArray, float]:
        gained = [
            sum(_likelier(*pair, phase, 1.0 + drift / span) for pair in pairs) for phase, drift in settings.tolist()
        ]
        # Of the ticks between two samples none is likelier than another: the middle one.
        return settings[np.array(gained) == max(gained)].mean(axis=0), max(gained)

    found, most = max((best(np.array([[k / PHASES, 0.0]])) for k in range(PHASES)), key=lambda tried: tried[1])
    if most < SURE:
        return None
    steps = np.linspace(-1.0, 1.0, 2 * EACH_SIDE + 1)
    for width in NARROWER:
        found, _ = best(found + width * np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2))
    phase, drift = found.tolist()
    return middle + phase, 1.0 + drift / span


def _pairs(at: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return when the samples of pairs beside each other were taken (m,), before and after, and whether they agree."""
    there = ~np.isnan(values)
    at, equal = at[there], np.diff(values[there]) == 0.0
    kept = slice(None, None, len(at) // PAIRS + 1)
    return at[:-1][kept], at[1:][kept], equal[kept]


def _likelier(before: FloatArray, after: FloatArray, equal: BoolArray, phase: float, period: float) -> float:
    """Return how much likelier an input is to change at ticks alone than at any sample, in log-likelihood.

    Args:
        before: (m,) when the first sample of each pair was taken.
        after: (m,) the second.
        equal: (m,) whether they agree.
        phase: of the clock.
        period: of the clock.
    """
    same = np.floor((before - phase) / period) == np.floor((after - phase) / period)
    pairs, apart = np.count_nonzero(same), np.count_nonzero(~same)
    if not pairs or equal.all():
        return 0.0
    changes = (np.count_nonzero(~equal & ~same) + 0.5) / (apart + 1.0)
    misread = np.count_nonzero(same & ~equal)
    return float((pairs - misread) * np.log((1.0 - OTHERS * changes) / (1.0 - changes)) + misread * np.log(OTHERS))


def integrals(commands: Sequence[FloatArray], at: FloatArray) -> FloatArray:
    """Return what inputs that are held from tick to tick add up to, once and twice integrated, (n, 2 i).

    That is what a rate or an acceleration that goes with an input makes of a state: it has a kink at every tick.

    Args:
        commands: (N,) of each input, from every tick on.
        at: (n,) when, in periods since the first tick.
    """
    cell = np.clip(np.floor(at).astype(np.int64), 0, min(map(len, commands)) - 1)
    within, columns = at - cell, list[FloatArray]()
    for command in commands:
        u = command - command.mean()
        once = np.concatenate([[0.0], np.cumsum(u)])
        twice = np.concatenate([[0.0], np.cumsum(once[:-1] + 0.5 * u)])
        columns += [once[cell] + within * u[cell], twice[cell] + within * (once[cell] + 0.5 * within * u[cell])]
    return np.column_stack(columns)


def by_clock(tick: IntArray, values: FloatArray, count: int) -> FloatArray | None:
    """Return an input (count,) as it is from each tick on, None where it changes between ticks.

    What was not read of a tick lies on a line between the ticks before and after, or on a smooth curve where that says
    more of those that were read.

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
    known, every = values[begins], np.arange(count, dtype=np.float64)
    at, fine = read.astype(np.float64), len(read) >= LOCAL
    if fine:
        before, after = at[2:-2] - at[1:-3], at[3:-1] - at[2:-2]
        line = (after * known[1:-3] + before * known[3:-1]) / (before + after)
        fine = bool(np.sum(off_cubics(at, known)[0] ** 2) < np.sum((known[2:-2] - line) ** 2))
    found: FloatArray
    if fine:
        from scipy.interpolate import CubicSpline

        found = CubicSpline(at, known)(np.clip(every, at[0], at[-1]))
    else:
        found = np.interp(every, at, known)
    return found
