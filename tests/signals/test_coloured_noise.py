"""Noise that a sensor filtered: its density where signals are, by theory."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt

from odescope.signals.coloured_noise import coloured_noise
from odescope.signals.noise import noise_level
from odescope.signals.spectral import Spectrum

SAMPLES, BEFORE = 4000, 1000  # of a record, and of its noise that nobody sees


def smoothed(white):
    return lfilter([0.3], [1.0, -0.7], white)


def correlated(white):
    return lfilter([1.0], [1.0, -0.8], white)


def averaged(white):
    return np.convolve(white, np.full(8, 1.0 / 8.0), "same")


def filtered(white):
    return sosfilt(butter(2, 0.2, output="sos"), white)


def read_too_often(white):
    """Four rows a reading, on the line between."""
    at = np.arange(len(white)) / 4.0
    return np.interp(at, np.arange(len(white) // 4 + 2), white[: len(white) // 4 + 2])


# What multiplies the standard deviation of white noise: the gain at frequency zero, by the root of the rows a reading.
SENSORS = {smoothed: 1.0, correlated: 5.0, averaged: 1.0, filtered: 1.0, read_too_often: 2.0}


def swings(rng):
    """A motion below a hundredth of half the sampling rate, with harmonics that fall."""
    phase = 2.0 * np.pi * (0.001 * np.arange(SAMPLES) + rng.uniform())
    return 3.0 * sum(0.3**k * np.sin(k * phase + k) for k in range(1, 6))


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_level_is_that_of_white_noise_as_dense_below_the_corner(sensor):
    ratios = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        noise = sensor(rng.standard_normal(SAMPLES + BEFORE))[BEFORE:]
        ratios.append(coloured_noise([Spectrum.of(swings(rng) + 0.005 * noise)]).deviation / (0.005 * SENSORS[sensor]))
    assert 0.8 < np.median(ratios) < 1.25
    assert 0.4 < min(ratios) <= max(ratios) < 2.0


@pytest.mark.parametrize("samples", [60, 300, 4000])
def test_white_noise_has_no_colour(samples):
    told = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        phase = 2.0 * np.pi * rng.uniform(1.0, 4.0) * np.linspace(0.0, 1.0, samples) + rng.uniform(0.0, 6.0)
        spectrum = Spectrum.of(np.exp(np.sin(phase)) + 0.01 * rng.standard_normal(samples))
        told += coloured_noise([spectrum]).deviation > 0.0
    assert told <= 1


def test_the_foot_of_a_signal_that_reaches_half_the_sampling_rate_is_no_noise():
    rng = np.random.default_rng(1)
    t = np.arange(2000)
    pulses = sum(np.exp(-np.abs(t - c) / 1.5) for c in rng.uniform(0.0, 2000.0, 60))
    assert coloured_noise([Spectrum.of(pulses + 1e-3 * rng.standard_normal(2000))]) == (0.0, 1.0)


def test_nor_is_that_of_what_follows_a_stepped_input_slowly():
    """No plateau is seen in it: it falls from the lowest frequencies on, to white noise."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        u, rate = np.repeat(rng.uniform(0.0, 1.0, 30), 50), rng.uniform(0.005, 0.03)
        x = lfilter([0.0, rate], [1.0, rate - 1.0], u)
        noisy = x + rng.choice([0.003, 0.01]) * x.std() * rng.standard_normal(len(x))
        assert coloured_noise([Spectrum.of(noisy)]).deviation == 0.0


def test_a_recording_that_is_noisier_stays_noisier_under_a_filter():
    rng = np.random.default_rng(2)
    records = [swings(rng) + scale * filtered(rng.standard_normal(SAMPLES + BEFORE))[BEFORE:] for scale in (0.01, 0.03)]
    both = noise_level([Spectrum.of(r) for r in records])
    assert both == pytest.approx(np.sqrt(np.mean([0.01**2, 0.03**2])), rel=0.3)
