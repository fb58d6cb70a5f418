"""Steps of an input that come by a clock of their own: when each came between two samples of a log."""

from __future__ import annotations

import math

import numpy as np

from odescope.arrays import FloatArray, IntArray

BY_CHANCE = 1e-3  # probability at which steps at any times are taken for those of a clock
MANY = 1000  # steps that are compared with each other, at most
CLOSE = 1e-6  # samples that times may be off by their rounding
DIGITS = 12  # of a period, at most


def times_by_clock(steps: IntArray, period: float) -> FloatArray | None:
    """Return when an input steps (S,) in samples, where it steps by a clock: at multiples of a period, not all of them.

    A controller that has another period than the log steps between samples. Which samples show its steps says when they
    came, the better the more there are: the time of each lies after the sample before it and no later than that which
    shows it. Of the periods that agree with this the roundest is taken; and the clock of the log, where it agrees.

    None where no clock makes such steps, where times at random may look like it, and where a whole number of samples
    agrees: such steps may come at samples.

    Args:
        steps: (S,) the last sample before each, increasing.
        period: of the samples, in seconds.
    """
    number = _numbers(steps)
    if number is None:
        return None
    some = np.unique(np.linspace(0, len(steps) - 1, MANY).astype(np.int64))
    ticks, samples = (
        np.subtract.outer(v[some], v[some])[np.tri(len(some), k=-1, dtype=np.bool_)] for v in (number, steps)
    )
    low, high = float(((samples - 1) / ticks).max()), float(((samples + 1) / ticks).min())
    if not low < high or math.floor(high - CLOSE) > low or (2.0 / low) ** (len(steps) - 2) > BY_CHANCE:
        return None
    for every in (_roundest(low * period, high * period) / period, 0.5 * (low + high)):
        first, last = float((steps - number * every).max()), float((steps + 1 - number * every).min())
        if first < last + CLOSE:
            with_log = round(0.5 * (first + last) / every) * every
            begin = with_log if first < with_log <= last + CLOSE else 0.5 * (first + last)
            times: FloatArray = np.clip(begin + number * every, steps, steps + 1.0)
            return times
    return None


def _numbers(steps: IntArray) -> IntArray | None:
    """Return which tick of a clock each step (S,) is at, from 0 at the first; None where none agrees with two steps."""
    if len(steps) < 3:
        return None
    apart = np.diff(steps)
    ticks = np.zeros_like(apart)
    low, high = float(apart.min()) - 1.0, float(apart.min()) + 1.0
    if low <= 0.0:
        return None
    for k in np.argsort(apart, kind="stable").tolist():
        ticks[k] = max(round(float(apart[k]) / (0.5 * (low + high))), 1)
        low, high = max(low, (apart[k] - 1) / ticks[k]), min(high, (apart[k] + 1) / ticks[k])
        if not low < high:
            return None
    return np.concatenate([[0], np.cumsum(ticks)])


def _roundest(low: float, high: float) -> float:
    """Return the number of the fewest digits between two positive ones."""
    for digits in range(DIGITS):
        unit = 10.0 ** (math.floor(math.log10(high)) - digits)
        found = round(0.5 * (low + high) / unit) * unit
        if low < found < high:
            return found
    return 0.5 * (low + high)
