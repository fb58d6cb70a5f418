"""Where rows of a regular clock were lost, told from stamps that are read with jitter, and some of them late."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray, IntArray, robust_deviation
from odescope.recordings.gaps import GAP_PERIODS

LEAST_JITTER = 0.05  # periods
BLOCK = 256  # rows over which a clock keeps its rate
BLOCKS = 8  # that the period is told from
NEAR = 1.3  # of the usual step, up or down, that the period is
ROUNDS = 2  # of counting the rows and taking the period from that


def sample_numbers(t: FloatArray) -> IntArray:
    """Return the number (n,) of each sample on a regular clock, one missed where samples are lost.

    Of all ways to number the rows, rising by one or, where rows are lost, by more, the one is taken under which the
    stamps are likeliest: off a clock of slowly moving phase by normal jitter, a row now and then by anything.

    Args:
        t: (n,) stamps, not falling.
    """
    steps = np.diff(t)
    usual = float(np.median(steps))
    numbers: IntArray = np.arange(len(t))
    if steps.max() <= GAP_PERIODS * usual:
        return numbers
    from odescope.recordings.loss_paths import lost_before

    period = _most_regular(t, usual)
    for _ in range(ROUNDS):
        rest = steps / period - np.rint(steps / period)
        jitter = max(robust_deviation(rest) / np.sqrt(2.0), LEAST_JITTER)
        numbers = np.arange(len(t)) + lost_before((t - t[0]) / period - np.arange(len(t)), jitter)
        period, origin = np.polyfit(numbers, t - t[0], 1).tolist()
        if np.abs(t - t[0] - origin - period * numbers).max() < 0.5 * period:
            break  # every row is nearest to its own number
    return numbers


def _most_regular(t: FloatArray, usual: float) -> float:
    """Return the period near a usual step with which the stamps are most in phase, block by block of `BLOCK` rows."""
    count = max(len(t) // BLOCK, 1)
    blocks = [t[k * BLOCK : (k + 1) * BLOCK] for k in np.unique(np.linspace(0, count - 1, BLOCKS).astype(int))]
    rates = np.arange(1.0 / NEAR, NEAR, 0.5 / BLOCK) / usual
    in_phase = sum(np.abs(np.exp(2j * np.pi * rates[:, None] * (b - b[0])).sum(axis=1)) ** 2 for b in blocks)
    return float(1.0 / rates[np.argmax(in_phase)])
