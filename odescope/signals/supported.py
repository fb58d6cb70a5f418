"""The cutoff that the measured samples of a channel support, where so many were not measured that it matters.

What is filled in between samples follows their noise, which then looks like signal. A fit to the measured samples alone
does not: Akaike's criterion, corrected for few samples (Hurvich and Tsai 1989), says how many cosines they bear.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre

from odescope.arrays import FloatArray
from odescope.signals.spectral import TREND_DEGREE, bin_frequencies

LOST = 0.8  # of the points of a grid: where more were measured, what is filled in matters little
MANY = 1000  # measured samples: of so many the power spectrum tells the cutoff, filled in or not
BUSY = 0.6  # of the measured samples: more parameters leave nothing that tells the noise
MUCH = 0.05  # of the variance of its motion
FINE = 1.0 / 12.0  # of a cutoff, between those that are tried
SAME = 1e-9  # of the largest singular value


def bears_fits(counts: Sequence[FloatArray]) -> bool:
    """Say whether fits to the measured samples are needed, and neither of none nor too large; counts (N,) a record."""
    measured, points = sum(int(np.count_nonzero(n)) for n in counts), sum(map(len, counts))
    return 0 < measured < min(LOST * points, MANY)


def supported_cutoff(channel: Sequence[FloatArray], counts: Sequence[FloatArray], period: float, most: float) -> float:
    """Return the cutoff in hertz of the cosines and cubics by least squares that suit the measured samples best.

    Infinite where these leave much of the signal: it is too fast for so few samples, and noise has no part in it.

    Args:
        channel: (N,) a record.
        counts: (N,) measured samples behind each value.
        period: of the grid, in seconds.
        most: hertz that are of interest.
    """
    longest = max(range(len(channel)), key=lambda k: len(channel[k]))
    measured = sum(int(np.count_nonzero(n)) for n in counts)
    moves = sum(float(np.sum(n * (y - np.average(y, weights=n)) ** 2)) for y, n in zip(channel, counts, strict=True))
    best, found, left = np.inf, np.inf, np.inf
    frequencies = bin_frequencies(len(channel[longest]), period)
    for bin_ in _spread(int(np.count_nonzero(frequencies <= most * (1.0 + SAME))) - 1):
        hertz = float(frequencies[bin_])
        bins = [int(2.0 * hertz * (1.0 + SAME) * len(y) * period) for y in channel]
        free = measured - sum(k + 1 + TREND_DEGREE for k in bins)
        if free < (1.0 - BUSY) * measured:
            break
        missed = sum(_missed(y, n, k) for y, n, k in zip(channel, counts, bins, strict=True))
        criterion = measured * np.log(max(missed, 1e-300)) + 2.0 * measured * (measured - free) / (free - 1)
        if criterion < best:
            best, found, left = criterion, hertz, missed / free
    return found if left < MUCH * moves / measured else np.inf


def _spread(last: int) -> list[int]:
    """Return bins from 1 to the last, each a twelfth above the one before where that is more than one."""
    if last < 1:
        return []
    steps = int(np.log(last) / np.log1p(FINE)) + 2
    return [int(k) for k in np.unique(np.rint(np.geomspace(1, last, steps)))]


def _missed(values: FloatArray, counts: FloatArray, last: int) -> float:
    """Return the sum of squares that cosines up to bin `last` and a cubic leave of the measured samples of a record."""
    points, there = len(values), counts > 0.0
    place = np.pi * (np.flatnonzero(there) + 0.5) / points
    cubic = legendre.legvander(np.linspace(-1.0, 1.0, points)[there], TREND_DEGREE)[:, 1:]
    weight = np.sqrt(counts[there])
    columns = weight[:, None] * np.column_stack([np.cos(np.outer(place, np.arange(last + 1))), cubic])
    wanted = weight * values[there]
    rest = wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=SAME)[0]
    return float(rest @ rest)
