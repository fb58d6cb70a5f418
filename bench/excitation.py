"""What drives the machines of the benchmarks."""

from __future__ import annotations

import numpy as np


def band(rng: np.random.Generator, t: np.ndarray, hertz: float, size: float) -> np.ndarray:
    """Return white noise cut at a frequency, of this root mean square."""
    spectrum = np.fft.rfft(rng.standard_normal(len(t)))
    spectrum[np.fft.rfftfreq(len(t), t[1]) > hertz] = 0.0
    spectrum[0] = 0.0
    values = np.fft.irfft(spectrum, len(t))
    return values * size / values.std()
