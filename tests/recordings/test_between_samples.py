"""Band-limited interpolation against sines and Fourier series, polygons, commands that are seen to be held."""

import numpy as np
import pytest

from odescope.recordings.between_samples import FINER, REACH, laid_out, looks_held, on_polygon, shifted

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
    slow = np.sin(1e-3 * np.arange(3000))
    assert looks_held(slow[(np.arange(3000) + 2) // 7 * 7])  # small jumps, all in step
    assert not looks_held(np.round(300.0 * slow))  # of a converter, at any row
    assert not looks_held(levels)
    assert not looks_held(np.round(np.sin(2e-3 * t), 2))  # a slow signal after a converter of 8 bits
    assert looks_held(np.repeat(levels[:10], 100))
    assert looks_held(np.where(t < 500, 0.0, 1.0))  # a single step
    assert not looks_held(np.zeros(1000))
    assert not looks_held(np.where(t < 500, 0.0, np.sin(0.2 * (t - 500))))


def uneven(seed=2, count=120):
    late = np.random.default_rng(seed).uniform(-0.3, 0.3, count)
    late[[0, -1]] = 0.0
    return np.arange(count) + late


def test_a_polygon_on_the_grid_stays_and_a_line_is_a_line_however_it_is_sampled():
    grid, values = 0.25 * np.arange(120) + 7.0, np.random.default_rng(0).standard_normal(120)
    assert on_polygon(grid, values, grid) == pytest.approx(values, abs=1e-10)
    t = 0.25 * uneven() + 7.0
    assert on_polygon(t, 3.0 * t - 2.0, grid) == pytest.approx(3.0 * grid - 2.0, abs=1e-10)


def test_the_polygon_on_the_grid_is_that_of_dense_least_squares():
    t, grid = uneven(), np.arange(120.0)
    values = np.random.default_rng(1).standard_normal(120)
    dense = (np.arange(119 * 400) + 0.5) / 400
    hats = np.maximum(1.0 - np.abs(dense[:, None] - grid), 0.0)
    wanted = np.linalg.lstsq(hats, np.interp(dense, t, values), rcond=None)[0]
    assert on_polygon(t, values, grid) == pytest.approx(wanted, abs=1e-4)


def test_what_is_slow_sees_the_same_input_and_not_the_one_of_samples_moved_to_the_grid():
    """Two integrations of commands whose clock jitters: a position, which no moving of single samples gets right."""
    t, grid = uneven(count=2000), np.arange(2000.0)
    values = np.sin(0.1 * grid)
    dense = np.arange(1999 * 20 + 1) / 20
    moved = np.sin(0.1 * (2.0 * grid - t))

    def position(at, heights):
        return np.cumsum(np.cumsum(np.interp(dense, at, heights) - np.sin(0.1 * dense))) / 400

    true = position(t, values)
    left, wrong = (np.abs(position(grid, u) - true).max() for u in (on_polygon(t, values, grid), moved))
    assert left < 0.05 * wrong
