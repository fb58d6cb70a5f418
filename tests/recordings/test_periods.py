from dataclasses import replace

import numpy as np
import pytest

from odescope.recordings.layout import Layout
from odescope.recordings.periods import at_one_period, common_period, sampled_alike, stretch_at_period
from odescope.recordings.record import Record, Records, Stretch

NOISE = 1e-3
PLAIN = Layout(time="t", columns=(("x", "x"), ("u", "u")))


def moving(t):
    return np.sin(3.0 * t) + 0.5 * np.cos(7.3 * t + 1.0)


def sampled(period, count, seed=0, start=0.0):
    t = start + period * np.arange(count)
    x = moving(t) + NOISE * np.random.default_rng(seed).standard_normal(count)
    return Record(t, np.column_stack([x, np.floor(t)]), ("x", "u"))


def test_records_that_are_sampled_alike_stay_as_they_are():
    records = Records((sampled(0.002, 500), sampled(0.002 * (1 + 5e-5), 700)))
    assert at_one_period(records, PLAIN) is records


def test_the_period_is_the_median_of_all_steps():
    records = Records((sampled(0.002, 500), sampled(0.0015, 2000), sampled(0.02, 700)))
    assert common_period(records) == pytest.approx(0.0015)


@pytest.mark.parametrize("period", [0.00200039, 0.0015, 0.0031, 0.02])
def test_noise_about_the_truth_stays_white_on_another_grid(period):
    runs = (sampled(0.00200014, 6000), sampled(period, 5000, seed=1, start=0.7))
    found = at_one_period(Records(runs), replace(PLAIN, held=frozenset({"u"}))).runs
    assert found[0] is runs[0]
    run = found[1]
    assert run.sample_period == pytest.approx(0.00200014, rel=1e-9)
    counts = run.counted("x")
    assert counts.sum() == 5000
    error = ((run.column("x") - moving(run.t)) * np.sqrt(counts))[counts > 0] / NOISE
    deviation = 1.0 / np.sqrt(len(error))
    assert abs(error.mean()) < 4 * deviation
    assert abs(error.std() - 1.0) < 4 * deviation
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 4 * deviation
    assert np.abs(run.column("x") - moving(run.t)).max() < 6 * NOISE
    inside = np.abs(run.t - np.rint(run.t)) > period  # away from the switches
    assert np.array_equal(run.column("u")[inside], np.floor(run.t)[inside])


def test_what_counts_of_a_stretch_is_the_same_time_on_another_grid():
    run = sampled(0.0015, 4000)
    found = stretch_at_period(Stretch(run, 1000, 3000, begins=False, ends=False), 0.002, PLAIN)
    assert found.record.t[found.first] == pytest.approx(run.t[1000], abs=0.001)
    assert found.record.t[found.stop] == pytest.approx(run.t[3000], abs=0.001)
    whole = stretch_at_period(Stretch.whole(run), 0.002, PLAIN)
    assert (whole.first, whole.stop) == (0, len(whole.record))


def test_an_input_runs_in_lines_on_another_grid_as_well():
    fine, coarse = sampled(0.002, 4000), sampled(0.0071, 1000)
    driven = [np.column_stack([run.column("x"), np.sign(np.sin(5.0 * run.t))]) for run in (fine, coarse)]
    square = Records(tuple(replace(run, values=values) for run, values in zip((fine, coarse), driven, strict=True)))
    found = at_one_period(square, replace(PLAIN, inputs=frozenset({"u"}))).runs[1]
    away = np.abs(np.sin(5.0 * found.t)) > 5.0 * 0.0142  # two samples
    assert np.allclose(found.column("u")[away], np.sign(np.sin(5.0 * found.t))[away], atol=0.02)


def test_records_that_differ_both_ways_come_to_one_period_too():
    runs = tuple(sampled(0.002 * (1.0 + off), 500 + k) for k, off in enumerate((-9e-5, 0.0, 9e-5)))
    found = at_one_period(Records(runs), PLAIN)
    assert sampled_alike(found)
    assert [len(run) for run in found] == [len(run) for run in runs]
