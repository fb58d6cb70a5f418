"""Noise that grows with what is measured.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from odescope.arrays import BoolArray, FloatArray, robust_deviation

SHARES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)  # of the mean variance that does not grow with the reading
FAR = 5.0  # standard deviations beyond which a sample says nothing of the signal
SURE = 10.0  # fall of -2 ln(likelihood) that is asked for: odds of 150 to 1
WORTH = 1.2  # times the information that constant noise leaves, at least


@dataclass(frozen=True, eq=False)
class RelativeNoise:
    """How noise grows with what is read: standard deviations (n,), in root mean squares of all, and what they fit.

    `level` is the root of the mean variance that the readings then have over the one that they seemed to have.
    """

    deviations: FloatArray
    level: float


def relative_noise(rest: FloatArray, signal: FloatArray, there: BoolArray, error: float) -> RelativeNoise | None:
    """Return how the noise of readings grows with them, None where it seems to be the same for all.

    The variance has a part that does not grow and one that goes with the square of the signal, of which the shares are
    the likeliest of a few. That a signal which seems to be zero may differ from that by its own error counts with it.

    Args:
        rest: (n,) readings less the signal, each in units of what its number of samples lets expect.
        signal: (n,).
        there: (n,) which of them were measured.
        error: standard deviation of the signal's own error.
    """
    r, square = rest[there], signal**2 + error**2
    if not np.any(r):
        return None
    best, least = None, len(r) * np.log(np.mean(r**2)) - SURE
    for share in SHARES:
        shape = share + (1.0 - share) * square / square[there].mean()
        found = len(r) * np.log(np.mean(r**2 / shape[there])) + np.sum(np.log(shape[there]))
        if found < least:
            best, least = shape, found
    if best is None or np.mean(1.0 / best[there]) < WORTH:
        return None
    return RelativeNoise(np.sqrt(best), float(np.sqrt(np.mean(r**2 / best[there]) / np.mean(r**2))))


def usual_deviations(rest: FloatArray, smooth: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return what gives the usual deviation of readings, which may grow with the signal, whatever outliers are among.

    That is no less than where they all have the same: a signal that is filtered badly where it is near zero shows no
    outliers there.

    Args:
        rest: (n,) readings less the filtered signal.
        smooth: (n,) that signal.
    """
    same, mean = robust_deviation(rest), float(np.mean(smooth**2))

    def scale(share: float, signal: FloatArray) -> FloatArray:
        found: FloatArray = np.sqrt(share + (1.0 - share) * signal**2 / mean)
        return found

    least, best = np.inf, 1.0
    for share in (1.0, *SHARES) if same > 0.0 and mean > 0.0 else ():
        by = scale(share, smooth)
        each = np.abs(rest) / by
        deviation = max(robust_deviation(rest / by), 1e-300)
        # Laplace's density, which few outliers move little, and these cut off.
        found = 2.0 * (len(rest) * np.log(np.mean(np.minimum(each, FAR * deviation))) + np.sum(np.log(by)))
        if found < least - (0.0 if share == 1.0 else SURE if best == 1.0 else 0.0):
            least, best = found, share
    if best == 1.0:
        return lambda signal: np.full(len(signal), same)
    grown = robust_deviation(rest / scale(best, smooth))
    return lambda signal: np.maximum(same, grown * scale(best, signal))
