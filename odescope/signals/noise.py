"""The noise level of a channel: what is left of its records above all that moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.signals.spectral import Spectrum

# The median of chi-squared with one degree of freedom: each bin of a cosine transform of white noise has that spread.
MEDIAN_CHI_SQUARED = 0.45493642311957174


def noise_level(spectra: Sequence[Spectrum]) -> float:
    """Return the standard deviation of the white noise, from the median power of the upper half of the spectra."""
    upper = []
    for spectrum in spectra:
        count = len(spectrum.values)
        upper.append(spectrum.power(spectrum.cubic(count // 2), slice(count // 2, count)))
    return float(np.sqrt(np.median(np.concatenate(upper)) / MEDIAN_CHI_SQUARED))
