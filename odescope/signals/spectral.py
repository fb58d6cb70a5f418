"""Spectral filter and differentiation in one transform (paper, 3.1 and 3.2).

A record is mirrored, x -> [x, reversed x]: its DFT is then the cosine transform of the record, so the transforms here
are DCTs and DSTs of length N. The mirror leaves kinks at both ends wherever the slope there is not zero; a cubic,
fitted together with the cosines below the cutoff, takes them up. That fit is the one that leaves the least energy above
the cutoff.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy.fft
from numpy.polynomial import legendre
from scipy.special import ndtr

from odescope.arrays import FloatArray

# The median of chi-squared with one degree of freedom: each bin of a cosine transform of white noise has that spread.
MEDIAN_CHI_SQUARED = 0.45493642311957174
TREND_DEGREE = 3
EDGE = 0.025  # of the cutoff: deviation of the error function by which a smooth gain falls
EDGE_DEVIATIONS = 5.0  # of these from the cutoff, where the gain is 1 - 3e-7, to the middle of the fall
ENDS = 8.5  # of these beyond the middle the gain is below the last digit
FORGOTTEN = 1e-7


@lru_cache(maxsize=8)
def _trend_spectrum(samples: int) -> FloatArray:
    time = np.linspace(-1.0, 1.0, samples)
    basis = legendre.legvander(time, TREND_DEGREE)[:, 1:]
    spectrum: FloatArray = scipy.fft.dct(basis, axis=0, norm="ortho")
    spectrum.flags.writeable = False
    return spectrum


def bin_frequencies(samples: int, period: float) -> FloatArray:
    """Return the frequency in hertz of each bin of the mirrored record, (N,): v / (2 N dt), as (17) mended."""
    return np.arange(samples) / (2.0 * samples * period)


def last_bin(samples: int, period: float, hertz: float) -> int:
    """Return the last bin that a cutoff keeps, at least the first after the mean.

    Args:
        samples: how many there are.
        period: of the samples, in seconds.
        hertz: the cutoff.
    """
    return max(int(np.searchsorted(bin_frequencies(samples, period), hertz * (1 + 1e-12), side="right")) - 1, 1)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Cosine spectrum of one record, and of the trend that is fitted with it.

    Shapes: values (N,), trend (N, 3).
    """

    values: FloatArray
    trend: FloatArray

    @staticmethod
    def of(samples: FloatArray) -> Spectrum:
        """Return the spectrum of samples (N,)."""
        return Spectrum(scipy.fft.dct(samples, norm="ortho"), _trend_spectrum(len(samples)))

    def cubics(self, cutoffs: Sequence[int]) -> FloatArray:
        """Return the Legendre coefficients (len(cutoffs), 3) of the cubics that leave least energy above each bin.

        Cutoffs ascend. The products of trend and values are summed once, from the last bin down.
        """
        joined = np.column_stack([self.trend, self.values])
        edges = np.array([*(min(c + 1, len(self.values)) for c in cutoffs), len(self.values)])
        bands = np.array([joined[low:high].T @ joined[low:high] for low, high in pairwise(edges)])
        found = _solve_cubics(np.cumsum(bands[::-1], axis=0)[::-1])
        found[len(self.values) - edges[:-1] <= TREND_DEGREE] = 0.0  # so few bins do not determine a cubic
        return found

    def cubic(self, cutoff: int) -> FloatArray:
        """Return the Legendre coefficients (3,) of the cubic that leaves least energy above bin `cutoff`."""
        cubic: FloatArray = self.cubics([cutoff])[0]
        return cubic

    def power(self, cubic: FloatArray, bins: slice) -> FloatArray:
        """Return |DCT|^2 of the record less `cubic` for these bins."""
        residual = self.values[bins] - self.trend[bins] @ cubic
        power: FloatArray = residual**2
        return power


def _solve_cubics(moments: FloatArray) -> FloatArray:
    """Return the cubics (K, 3) of sums of products (K, 4, 4) of trend and values."""
    gram, right = moments[:, :TREND_DEGREE, :TREND_DEGREE], moments[:, :TREND_DEGREE, TREND_DEGREE]
    sizes = np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
    known = np.all(sizes > 0.0, axis=1)
    scale = np.where(known[:, None], sizes, 1.0)
    eigenvalues, vectors = np.linalg.eigh(gram / (scale[:, :, None] * scale[:, None, :]))
    # Far above the kinks' own bandwidth the three tails look alike: what rounding decides is left at zero.
    good = known[:, None] & (eigenvalues > 1e-9 * eigenvalues[:, -1:])
    along = np.einsum("kji,kj->ki", vectors, right / scale)
    shares = np.divide(along, eigenvalues, out=np.zeros_like(along), where=good)
    solution: FloatArray = np.einsum("kij,kj->ki", vectors, shares) / scale
    return solution


def differentiate(samples: FloatArray, period: float, cutoff: int, order: int) -> FloatArray:
    """Return the filtered record and its derivatives up to `order`, (order + 1, N).

    The spectrum above bin `cutoff` is set to zero (21b) and the rest multiplied by (i w)^k (19).

    Args:
        samples: (N,) measured values.
        period: sampling period in seconds.
        cutoff: last bin kept; bin v is the frequency v / (2 N dt).
        order: highest derivative.
    """
    return _differentiated(samples, period, np.ones(min(cutoff + 1, len(samples))), order)


def differentiate_smoothly(samples: FloatArray, period: float, hertz: float, order: int) -> FloatArray:
    """Return the same with a gain that falls smoothly, from 1 at `hertz` through 1/2 at 1.125 times that.

    What a sharp cutoff does to a sample depends on samples however far away, as 1 / distance. This gain, an error
    function of the frequency, forgets what is further away than `reach(hertz)` but for 1e-7: so a long record can be
    filtered chunk by chunk.

    Args:
        samples: (N,) measured values.
        period: sampling period in seconds.
        hertz: up to where the gain is 1.
        order: highest derivative.
    """
    frequency = bin_frequencies(len(samples), period)
    middle, deviation = (1.0 + EDGE_DEVIATIONS * EDGE) * hertz, EDGE * hertz
    below = frequency[: int(np.searchsorted(frequency, middle + ENDS * deviation, side="right"))]
    return _differentiated(samples, period, ndtr((middle - below) / deviation), order)


def reach(hertz: float) -> float:
    """Return the time in seconds beyond which `differentiate_smoothly` has forgotten a sample but for 1e-7.

    The impulse response of an error function of deviation s is that of a sharp edge times exp(-2 (pi s t)^2).
    """
    return float(np.sqrt(0.5 * np.log(1.0 / FORGOTTEN)) / (np.pi * EDGE * hertz))


def _differentiated(samples: FloatArray, period: float, gain: FloatArray, order: int) -> FloatArray:
    """Return filtered record and derivatives; the gain is that of the first bins, and 0 beyond."""
    count = len(samples)
    spectrum = Spectrum.of(samples)
    cubic = spectrum.cubic(len(gain) - 1)
    kept = np.zeros(count)
    kept[: len(gain)] = (spectrum.values[: len(gain)] - spectrum.trend[: len(gain)] @ cubic) * gain
    omega = 2.0 * np.pi * bin_frequencies(count, period)
    time = np.linspace(-1.0, 1.0, count)
    slope = 2.0 / ((count - 1) * period)
    result = np.empty((order + 1, count))
    for k in range(order + 1):
        turned = kept * omega**k
        if k % 2 == 0:
            wave = scipy.fft.idct(turned * (-1.0) ** (k // 2), norm="ortho")
        else:
            # The derivative of a cosine series is a sine series, whose first bin is the cosine's second.
            wave = scipy.fft.idst(np.append(turned[1:], 0.0) * -((-1.0) ** (k // 2)), norm="ortho")
        result[k] = wave + legendre.legval(time, legendre.legder(np.append(0.0, cubic), k)) * slope**k
    return result
