"""Band-limited interpolation against sines and Fourier series, and commands that are seen to be held."""

import numpy as np
import pytest

from odescope.recordings.between_samples import FINER, REACH, laid_out, looks_held, shifted

COUNT = 400
INNER = slice(2 * REACH, COUNT - 2 * REACH)


@pytest.mark.parametrize("late", [0.0, 0.37, -0.5, 3.8, -12.25, 17.0])
@pytest.mark.parametrize("frequency", [0.02, 0.11, 0.3, 0.45])
def test_a_sine_below_nine_tenths_of_half_the_rate_is_shifted_exactly(frequency, late):
    at = np.arange(COUNT)
    found = shifted(np.sin(2.0 * np.pi * frequency * at + 0.3), late)
    assert found[INNER] == pytest.approx(np.sin(2.0 * np.pi * frequency * (at - late) + 0.3)[INNER], abs=2e-4)


@pytest.mark.parametrize("late", [0.4, -1.7])
def test_a_periodic_signal_is_interpolated_as_its_fourier_series_is(late):
    rng = np.random.default_rng(0)
    spectrum = np.zeros(COUNT // 2 + 1, dtype=complex)
    spectrum[1:180] = rng.standard_normal(179) + 1j * rng.standard_normal(179)
    moved = np.fft.irfft(spectrum * np.exp(-2j * np.pi * np.arange(COUNT // 2 + 1) * late / COUNT), COUNT)
    signal = np.fft.irfft(spectrum, COUNT)
    assert shifted(signal, late)[INNER] == pytest.approx(moved[INNER], abs=3e-4 * np.abs(signal).max())


def test_what_lies_outside_the_record_stays_at_its_ends():
    samples = np.random.default_rng(1).standard_normal(50)
    assert np.all(shifted(samples, 60.25) == samples[0])
    assert np.all(shifted(samples, -60.25) == samples[-1])
    assert np.array_equal(shifted(samples, 7.0)[7:], samples[:-7])


def test_the_ends_of_a_smooth_record_are_not_torn():
    at = np.arange(200)
    true = np.sin(0.3 * (at + 0.5) + 1.0)[:-1]
    assert np.abs(shifted(np.sin(0.3 * at + 1.0), -0.5)[:-1] - true).max() < 0.02


@pytest.mark.parametrize(("frequency", "error"), [(0.03, 1e-4), (0.11, 1e-4), (0.25, 5e-4), (0.4, 3e-3)])
def test_the_polygon_has_the_means_of_the_signal_between_its_nodes(frequency, error):
    w = 2.0 * np.pi * frequency
    nodes = laid_out(np.sin(w * np.arange(COUNT)))
    at = np.arange(len(nodes)) / FINER
    mean = (np.cos(w * at[:-1]) - np.cos(w * at[1:])) / w * FINER
    inner = slice(FINER * INNER.start, FINER * INNER.stop)
    assert (0.5 * (nodes[1:] + nodes[:-1]))[inner] == pytest.approx(mean[inner], abs=error)


@pytest.mark.parametrize("count", [1, 2, 3, 10])
def test_short_records_of_a_constant_stay_constant(count):
    assert laid_out(np.full(count, 3.0)) == pytest.approx(np.full(FINER * count, 3.0), abs=1e-12)
    assert shifted(np.full(count, 3.0), 0.4) == pytest.approx(np.full(count, 3.0), abs=1e-12)


def test_a_command_that_changes_every_fifth_row_is_seen_and_others_are_not():
    rng = np.random.default_rng(2)
    levels, t = rng.standard_normal(200), np.arange(1000)
    assert looks_held(np.repeat(levels, 5))
    assert not looks_held(levels)
    assert not looks_held(np.round(np.sin(2e-3 * t), 2))  # a slow signal after a converter of 8 bits
    assert not looks_held(np.repeat(levels[:10], 100))  # too few jumps to matter
    assert not looks_held(np.where(t < 500, 0.0, np.sin(0.2 * (t - 500))))
