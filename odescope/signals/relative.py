"""Noise that grows with the reading, as that of many sensors does: variance a^2 + (b reading)^2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray

SHARES = (0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99)  # of the mean variance that may go with the reading
LIKELIER = 20.0  # fall of -2 ln likelihood from which on noise goes with the reading
FEWEST = 40  # samples that tell
WHITE = 0.5  # correlation of neighbours, beyond which what is left is no noise
FAR = 4.0  # standard deviations beyond which a sample has no say in how large noise is


@dataclass(frozen=True)
class RelativeNoise:
    """A variance that is, at a reading of root mean square size `reading`, by this `share` that of the reading."""

    share: float
    reading: float

    def variance(self, smooth: FloatArray) -> FloatArray:
        """Return the variance of a sample (N,) over the mean one, given the signal (N,)."""
        ratio: FloatArray = 1.0 - self.share + self.share * (smooth / self.reading) ** 2
        return ratio


def relative_noise(rest: Sequence[FloatArray], smooth: Sequence[FloatArray]) -> RelativeNoise | None:
    """Return how noise goes with the reading; None where it does not clearly do so.

    Args:
        rest: (n,) what a filter leaves of the measured samples of a record.
        smooth: (n,) the signal there.
    """
    left, reading = np.concatenate(rest), float(np.sqrt(np.mean(np.concatenate(smooth) ** 2)))
    if len(left) < FEWEST or not reading > 0.0 or not left.any():
        return None
    said = {share: _minus_two_log(left, np.concatenate(smooth), RelativeNoise(share, reading)) for share in SHARES}
    best = RelativeNoise(min(said, key=lambda share: said[share]), reading)
    if said[best.share] > _minus_two_log(left, np.concatenate(smooth), RelativeNoise(0.0, reading)) - LIKELIER:
        return None
    even = [r / np.sqrt(best.variance(s)) for r, s in zip(rest, smooth, strict=True)]
    along = sum(float(e[1:] @ e[:-1]) for e in even) / sum(float(e @ e) for e in even)
    return best if abs(along) < WHITE else None


def _minus_two_log(rest: FloatArray, smooth: FloatArray, noise: RelativeNoise) -> float:
    """Return -2 ln likelihood of residuals (n,), but for a constant; those far off weigh as if they were less so."""
    ratio = noise.variance(smooth)
    even = rest / np.sqrt(ratio)
    bound = FAR * 1.4826 * float(np.median(np.abs(even)))
    power = float(np.mean(np.minimum(even**2, max(bound, 1e-300) ** 2)))
    return len(rest) * float(np.log(max(power, 1e-300))) + float(np.log(ratio).sum())
