"""Spectral filter and differentiation in one transform (paper, 3.1 and 3.2; METHOD section 3).

A record is mirrored, x -> [x, reversed x]: its DFT is then the cosine transform of the record, so the transforms here
are DCTs and DSTs of length N. The mirror leaves kinks at both ends wherever the slope there is not zero; a cubic,
fitted together with the cosines below the cutoff, takes them up. That fit is the one that leaves the least energy above
the cutoff.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.polynomial import legendre

from odescope.arrays import FloatArray

TREND_DEGREE = 3


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


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Cosine spectrum of one record and the moments that give the best cubic for every cutoff.

    Shapes: values (N,), trend (N, 3), tails (N + 1, 4, 4): tails[k] sums the products of [trend, values] from bin k on.
    """

    values: FloatArray
    trend: FloatArray
    tails: FloatArray

    @staticmethod
    def of(samples: FloatArray) -> Spectrum:
        """Return the spectrum of samples (N,)."""
        values = scipy.fft.dct(samples, norm="ortho")
        trend = _trend_spectrum(len(samples))
        joined = np.column_stack([trend, values])
        tails = np.zeros((len(samples) + 1, joined.shape[1], joined.shape[1]))
        products = joined[:, :, None] * joined[:, None, :]
        tails[:-1] = np.cumsum(products[::-1], axis=0)[::-1]
        return Spectrum(values, trend, tails)

    def cubic(self, cutoff: int) -> FloatArray:
        """Return the Legendre coefficients (3,) of the cubic that leaves least energy above bin `cutoff`."""
        moments = self.tails[min(cutoff + 1, len(self.values))]
        gram, right = moments[:TREND_DEGREE, :TREND_DEGREE], moments[:TREND_DEGREE, TREND_DEGREE]
        scale = np.sqrt(np.diag(gram))
        if not np.all(scale > 0.0):
            return np.zeros(TREND_DEGREE)
        eigenvalues, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
        # Far above the kinks' own bandwidth the three tails look alike: what rounding decides is left at zero.
        good = eigenvalues > 1e-9 * eigenvalues[-1]
        solution: FloatArray = vectors[:, good] @ ((vectors[:, good].T @ (right / scale)) / eigenvalues[good]) / scale
        return solution

    def power(self, cubic: FloatArray, first: int, last: int) -> FloatArray:
        """Return |DCT|^2 of the record less `cubic` for bins first to last - 1."""
        residual = self.values[first:last] - self.trend[first:last] @ cubic
        power: FloatArray = residual**2
        return power


def differentiate(samples: FloatArray, period: float, cutoff: int, order: int) -> FloatArray:
    """Return the filtered record and its derivatives up to `order`, (order + 1, N).

    The spectrum above bin `cutoff` is set to zero (21b) and the rest multiplied by (i w)^k (19).

    Args:
        samples: (N,) measured values.
        period: sampling period in seconds.
        cutoff: last bin kept; bin v is the frequency v / (2 N dt).
        order: highest derivative.
    """
    count = len(samples)
    spectrum = Spectrum.of(samples)
    cubic = spectrum.cubic(cutoff)
    kept = spectrum.values - spectrum.trend @ cubic
    kept[cutoff + 1 :] = 0.0
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
