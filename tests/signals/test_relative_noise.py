"""Noise that grows with what is read: told from white noise, in its size, and from outliers."""

import numpy as np
import pytest

from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.outliers import gate_outliers
from odescope.signals.relative_noise import noise_of_recordings, recording_levels, relative_noise, usual_deviations

COUNT = 100
THERE = np.ones(COUNT, dtype=bool)


def decay(count=COUNT):
    return 1.0 + 9.0 * np.exp(-np.linspace(0.0, 4.0, count))


@pytest.mark.parametrize("count", [60, 5000])
def test_white_noise_is_not_taken_for_noise_that_grows(count):
    there = np.ones(count, dtype=bool)
    for seed in range(60):
        rest = np.random.default_rng(seed).standard_normal(count)
        assert relative_noise(rest, decay(count), there, 0.1) is None


@pytest.mark.parametrize("seed", range(6))
def test_noise_that_is_a_share_of_the_reading_is_found_with_its_size(seed):
    signal = decay()
    rest = 0.05 * signal * np.random.default_rng(seed).standard_normal(COUNT)
    found = relative_noise(rest, signal, THERE, 0.0)
    assert np.mean(found.deviations**2) == pytest.approx(1.0)
    wide = np.sqrt(np.mean(rest**2)) * found.level * found.deviations
    assert np.all(np.abs(np.log(wide / (0.05 * signal))) < 0.5)  # constant noise is off by a factor of four
    assert np.abs(np.log(wide / (0.05 * signal))).mean() < 0.25


def test_a_reading_that_was_not_taken_says_nothing():
    signal, there = decay(), np.arange(COUNT) % 2 == 0
    rest = 0.05 * signal * np.random.default_rng(0).standard_normal(COUNT)
    found = relative_noise(rest, signal, there, 0.0)
    alone = relative_noise(rest[there], signal[there], THERE[there], 0.0)
    np.testing.assert_allclose(found.deviations[there], alone.deviations)
    assert found.level == pytest.approx(alone.level)


def test_few_outliers_are_no_noise_that_grows():
    signal, rest = decay(1000), np.random.default_rng(1).standard_normal(1000)
    rest[:6] = 40.0  # where the signal is largest
    (wide,) = usual_deviations([rest], [signal])([signal])
    assert np.ptp(wide) == 0.0
    assert wide[0] == pytest.approx(1.0, rel=0.1)


def test_usual_deviations_grow_with_a_signal_whose_noise_does_and_never_fall_below_those_of_all():
    signal = decay(1000)
    rest = 0.05 * signal * np.random.default_rng(2).standard_normal(1000)
    (wide,) = usual_deviations([rest], [signal])([signal])
    assert wide[0] == pytest.approx(0.5, rel=0.2)
    assert wide.min() == usual_deviations([rest], [np.ones(1000)])([signal])[0][0]


@pytest.mark.parametrize("seed", range(4))
def test_readings_of_a_large_signal_with_a_share_of_noise_are_no_outliers(seed):
    t = 0.05 * np.arange(200)
    rng, signal = np.random.default_rng(seed), 0.5 + 20.0 * np.exp(-0.7 * t)
    x = signal * (1.0 + 0.05 * rng.standard_normal(len(t)))
    x[120] += 3.0
    (run,) = gate_outliers(Records.of(Record(t, x[:, None], ("x",))), (Coordinate("x", 1),), Spectral())
    assert np.flatnonzero(run.counted("x") == 0.0).tolist() == [120]


def recordings(levels, seed, count=400):
    return [level * np.random.default_rng((seed, k)).standard_normal(count) for k, level in enumerate(levels)]


def test_recordings_of_one_sensor_are_not_told_apart():
    runs = [(400 * k, 400 * (k + 1)) for k in range(4)]
    there = np.ones(1600, dtype=bool)
    for seed in range(100):
        rest = recordings([1.0] * 4, seed)
        assert recording_levels(rest) == [1.0] * 4
        assert noise_of_recordings(np.concatenate(rest), there, runs, 0.8, 0.0) is None


@pytest.mark.parametrize("seed", range(5))
def test_a_recording_that_is_noisier_is_told_with_its_size(seed):
    levels = np.array([1.0, 1.0, 3.0])
    rest = recordings(levels, seed)
    usual = levels / np.sqrt(np.mean(levels**2))
    assert recording_levels(rest) == pytest.approx(usual, rel=0.15)
    rest[0][:10] = 40.0  # outliers move no median
    assert recording_levels(rest) == pytest.approx(usual, rel=0.15)
    runs, there = [(400 * k, 400 * (k + 1)) for k in range(3)], np.arange(1200) >= 10
    found = noise_of_recordings(np.sqrt(0.8) * np.concatenate(rest), there, runs, 0.8, 0.0)
    assert found[[0, 400, 800]] == pytest.approx(levels, rel=0.15)
    assert all(np.ptp(found[low:high]) == 0.0 for low, high in runs)


def test_what_was_rounded_is_no_quieter_than_its_steps():
    still, moving = np.zeros(400) + 1e-9, 0.3 * np.random.default_rng(0).standard_normal(400)
    runs, there = [(0, 400), (400, 800)], np.ones(800, dtype=bool)
    assert noise_of_recordings(np.concatenate([still, moving]), there, runs, 1.0, 0.3) is None
    assert recording_levels([np.zeros(400), moving]) == [1.0, 1.0]
