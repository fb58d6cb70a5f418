"""Samples that say nothing of the signal: late reads, outliers, ends of a sensor's range; and the steps of a sensor."""

from dataclasses import replace

import numpy as np
import pytest

from odescope.errors import NoModelError
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals
from odescope.signals.noise import sensor_step
from odescope.signals.outliers import gate_outliers

PERIOD, NOISE = 0.005, 0.002
X = (Coordinate("x", 2),)


def motion(count=6000):
    t = PERIOD * np.arange(count)
    return t, np.sin(2 * np.pi * 0.8 * t) + 0.4 * np.cos(2 * np.pi * 0.31 * t + 1) + 0.2 * np.sin(2 * np.pi * 1.7 * t)


def gated(t, x):
    records = gate_outliers(Records.of(Record(t, x[:, None], ("x",))), X, Spectral())
    (run,) = records
    return run.counted("x") == 0.0, records


@pytest.mark.parametrize("seed", range(3))
def test_outliers_are_told_from_noise_and_the_noise_is_that_of_the_others(seed):
    rng = np.random.default_rng(seed)
    t, x = motion()
    wrong = rng.random(len(t)) < 0.01
    measured = x + NOISE * rng.standard_normal(len(t))
    measured[wrong] += NOISE * rng.uniform(10.0, 50.0, wrong.sum()) * rng.choice([-1, 1], wrong.sum())
    far, records = gated(t, measured)
    assert np.mean(far[wrong]) > 0.97
    assert np.count_nonzero(far & ~wrong) <= 2
    (channel,) = estimate_signals(records, X, (), Spectral()).channels
    assert channel.noise == pytest.approx(NOISE, rel=0.08)
    (before,) = estimate_signals(Records.of(Record(t, measured[:, None], ("x",))), X, (), Spectral()).channels
    assert before.noise > 1.5 * NOISE  # what the gate is for


def test_a_read_that_repeats_the_last_value_is_told_where_the_signal_moves():
    rng = np.random.default_rng(4)
    t, x = motion()
    measured = x + 1e-4 * rng.standard_normal(len(t))
    late = np.flatnonzero(rng.random(len(t)) < 0.01)
    late = late[late > 0]
    measured[late] = measured[late - 1]
    far, _ = gated(t, measured)
    fast = late[np.abs(x[late] - x[late - 1]) > 0.5 * np.sqrt(np.mean(np.diff(x) ** 2))]
    assert np.mean(far[fast]) > 0.95
    assert np.count_nonzero(np.delete(far, late)) <= 2


def test_samples_at_the_end_of_the_sensors_range_do_not_count():
    t, x = motion()
    measured = np.minimum(x + NOISE * np.random.default_rng(5).standard_normal(len(t)), 1.1)
    far, _ = gated(t, measured)
    flat = measured == 1.1
    assert 100 < flat.sum() < 0.2 * len(t)
    assert np.mean(far[flat]) > 0.9
    assert np.count_nonzero(far & ~flat) < 0.002 * len(t)


def test_what_was_filled_in_between_samples_at_the_end_of_the_range_does_not_hide_that_it_is_one():
    t, x = motion()
    rng = np.random.default_rng(5)
    measured = np.minimum(x + NOISE * rng.standard_normal(len(t)), 1.1)
    flat, lost = measured == 1.1, rng.random(len(t)) < 0.2
    bridged = np.where(lost & flat, 1.3, measured)
    record = Record(t, bridged[:, None], ("x",), counts=np.where(lost, 0.0, 1.0)[:, None])
    (run,) = gate_outliers(Records.of(record), X, Spectral())
    assert np.mean(run.counted("x")[flat] == 0.0) > 0.9
    assert np.mean(run.counted("x")[~flat & ~lost] == 0.0) < 0.002


def test_a_signal_without_noise_whose_acceleration_jumps_keeps_all_its_samples():
    t, _ = motion()
    pace = np.cumsum(np.sign(np.sin(2 * np.pi * 0.5 * t))) * PERIOD  # speeds up and slows down abruptly
    far, _ = gated(t, np.cumsum(pace) * PERIOD)
    assert not far.any()


def test_where_most_of_a_channel_stands_at_its_ends_there_is_nothing_to_go_by():
    t, x = motion()
    measured = np.clip(x, -0.25, 0.25)
    with pytest.raises(NoModelError, match=r"of 6000 samples of x .* % stand at -0\.25 or 0\.25, where its range ends"):
        gated(t, measured)


def test_a_switch_is_told_from_a_position():
    t, x = motion()
    with pytest.raises(NoModelError, match=r"it holds 2 levels only \(-1, 1\), as a switch does"):
        gated(t, np.sign(x))


def test_a_mechanism_that_rests_at_an_end_most_of_the_time_is_not_saturated():
    t, _ = motion()
    moves = np.maximum(np.sin(2 * np.pi * 0.05 * t) - 0.8, 0.0) ** 3  # comes to rest smoothly
    far, _ = gated(t, 1e-3 * np.round(100.0 * moves / 1e-3))
    assert not far.any()


def test_one_leap_does_not_hide_that_a_sensor_is_saturated():
    t, x = motion()
    measured = np.minimum(x + 1e-3 * np.random.default_rng(6).standard_normal(len(t)), 1.1)
    flat = measured == 1.1
    measured[3000] = -1e4
    assert not flat[3000]
    far, _ = gated(t, measured)
    assert np.mean(far[flat]) > 0.9


@pytest.mark.parametrize("step", [2 * np.pi / 4096, 0.01, 3e-4])
def test_the_step_of_an_encoder_is_found_and_bounds_the_noise(step):
    t, x = motion()
    measured = step * np.round(x / step)
    found = sensor_step([measured])
    assert found == (pytest.approx(step, rel=1e-6) if len(np.unique(measured)) * 4 < len(t) else 0.0)
    (channel,) = estimate_signals(Records.of(Record(t, measured[:, None], ("x",))), X, (), Spectral()).channels
    assert channel.noise >= 0.999 * found / np.sqrt(12.0)


def test_values_without_steps_have_none():
    _, x = motion()
    assert sensor_step([x + NOISE * np.random.default_rng(6).standard_normal(len(x))]) == 0.0
    assert sensor_step([np.repeat([1.0, 2.0, 4.5, 4.63], 100)]) == 0.0


@pytest.mark.parametrize("rows", [[200, 640], [200, 202, 640], [3, 200, 201, 640]])
def test_spikes_in_one_of_two_records_do_not_pass_for_signal_at_high_frequencies(rows):
    """Far above the noise of the other record at every frequency, they had the cutoff near half the sampling rate."""
    rng = np.random.default_rng(8)
    t = 0.02 * np.arange(1000)
    runs = []
    for start, count in ((0.0, 1000), (1.0, 600)):
        x = 0.5 * np.sin(1.3 * t + start) + 0.01 * rng.standard_normal(1000)
        runs.append(Record(t[:count], x[:count, None], ("x",)))
    spoilt = runs[0].values.copy()
    spoilt[rows] += 0.8
    found = gate_outliers(Records.of([replace(runs[0], values=spoilt), runs[1]]), X, Spectral())
    gone = [np.flatnonzero(run.counted("x") == 0.0).tolist() for run in found]
    assert gone == [rows, []]


@pytest.mark.parametrize(("width", "swings"), [(2.5, 0.0), (3.0, 0.3), (3.0, 0.5)])
def test_a_burst_over_several_samples_in_one_of_two_records_is_no_spike(width, swings):
    """A peak, or an oscillation that comes and goes, far above all else: it was clipped from its top down."""
    rng, runs, t = np.random.default_rng(5), [], 0.01 * np.arange(1000)
    after = np.arange(1000) - 300.0
    burst = 40.0 * np.exp(-((after / width) ** 2)) * np.cos(swings * after)
    for start, size in ((0.0, 1.0), (1.0, 0.0)):
        x = 4.0 * np.sin(1.3 * t + start) + size * burst + 0.05 * rng.standard_normal(1000)
        runs.append(Record(t, x[:, None], ("x",)))
    found = gate_outliers(Records.of(runs), X, Spectral())
    assert [np.count_nonzero(run.counted("x") == 0.0) for run in found] == [0, 0]


@pytest.mark.parametrize(
    "rows", [[1500], [1500, 1501], [1500, 1501, 1502, 1503], [1500, 1501, 1503, 1504], [0, 1, 2999]]
)
def test_what_takes_the_place_of_readings_of_nothing_is_the_signal(rows):
    """A slow level, of which a few readings in a row are 0: what they read must not raise the cutoff."""
    rng, t = np.random.default_rng(len(rows)), np.arange(3000.0)
    level = 50.0 + 15.0 * np.sin(0.01 * t) + 3.0 * np.abs(np.sin(0.004 * t))
    read = level + 0.2 * rng.standard_normal(len(t))
    read[rows] = 0.0
    found = gate_outliers(Records.of([Record(t, read[:, None], ("h",))]), [Coordinate("h", 1)], Spectral()).runs[0]
    assert np.flatnonzero(found.counted("h") == 0.0).tolist() == rows
    assert np.abs(found.column("h") - level)[rows].max() < 0.3


@pytest.mark.parametrize("seed", range(3))
def test_where_a_held_input_jumps_what_follows_may_bend(seed):
    """A current answers a voltage that is held for .5 s within eight samples: it bends at every step."""
    rng, t = np.random.default_rng(seed), 0.002 * np.arange(15_000)
    u = np.repeat(rng.uniform(0.0, 12.0, 60), 250)
    i = np.zeros(len(t))
    for k in range(1, len(t)):
        i[k] = u[k - 1] + (i[k - 1] - u[k - 1]) * np.exp(-0.002 / 0.016)
    read = i + 0.03 * rng.standard_normal(len(t))
    read[[1234, 7777]] += 3.0
    records = Records.of([Record(t, np.column_stack([read, u]), ("i", "u"))])
    found = gate_outliers(records, [Coordinate("i", 1)], Spectral()).runs[0]
    assert np.flatnonzero(found.counted("i") == 0.0).tolist() == [1234, 7777]


@pytest.mark.parametrize(("told", "most"), [(True, 1), (False, 6)])
def test_a_kink_is_no_outlier_whether_an_input_tells_of_it_or_not(told, most):
    """A temperature whose heating changes every 50 samples: at 31 of these 354 kinks a sample was said to be wrong."""
    called = 0
    for seed in range(6):
        rng, count = np.random.default_rng(seed), 3000
        heat = np.repeat(rng.uniform(-1.0, 1.0, count // 50), 50)
        warm = np.zeros(count)
        for k in range(1, count):
            warm[k] = heat[k - 1] + (warm[k - 1] - heat[k - 1]) * np.exp(-1.0 / 30.0)
        read = warm + 0.004 * rng.standard_normal(count)
        wrong = {333, 1234, 1235, 2477}
        read[sorted(wrong)] += [0.3, -0.3, -0.25, 0.2]
        columns = {"x": read, "u": heat} if told else {"x": read}
        record = Record(np.arange(float(count)), np.column_stack(list(columns.values())), tuple(columns))
        gated = gate_outliers(Records.of([record]), X, Spectral()).runs[0].counted("x") == 0.0
        found = set(np.flatnonzero(gated).tolist())
        assert wrong <= found
        called += len(found - wrong)
    assert called <= most


@pytest.mark.parametrize("seed", range(3))
def test_where_a_held_input_jumps_all_the_time_nothing_more_is_let_pass(seed):
    rng = np.random.default_rng(seed)
    t, x = motion()
    u = np.repeat(rng.uniform(0.0, 12.0, len(t) // 5), 5)
    spikes = np.sort(rng.choice(np.arange(5, len(t) - 5, 5), 30, replace=False))
    measured = x + NOISE * rng.standard_normal(len(t))
    measured[spikes] += 15.0 * NOISE
    found = gate_outliers(Records.of(Record(t, np.column_stack([measured, u]), ("x", "u"))), X, Spectral()).runs[0]
    assert np.flatnonzero(found.counted("x") == 0.0).tolist() == spikes.tolist()
