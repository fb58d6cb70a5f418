import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.recordings.gaps import RawRun
from odescope.recordings.uniform import uniform

TIME = np.arange(40) * 0.01


def raw(**columns):
    t = columns.pop("t", TIME)
    names, values = tuple(columns), np.column_stack(list(columns.values()))
    return RawRun(t, values, names, (None,) * len(names), "run1.csv", np.arange(1, len(t) + 1), names)


# uniform time


def test_a_uniform_record_keeps_its_values_and_loses_its_rounding():
    t = 5 + np.arange(1000) * 1e-3
    values = np.random.default_rng(0).normal(size=(1000, 1))
    run, _ = uniform(raw(t=t, x=values[:, 0]))
    assert np.array_equal(run.values, values)
    assert np.ptp(np.diff(run.t)) < 3e-15


@settings(deadline=None, max_examples=60)
@given(
    period=st.floats(0.0023, 0.05),
    start=st.sampled_from([0.0, 3.1, 1.7e9]),
    tick=st.sampled_from([1e-3, 2e-4, 2**-12, 1e-5]),
    count=st.integers(20, 400),
)
def test_a_rounded_clock_is_seen_through(period, start, tick, count):
    """Values stay untouched though rounding exceeds the tolerance, and the true grid is found to half a tick."""
    ideal = start + period * np.arange(count)
    t = np.rint(ideal / tick) * tick
    step = np.diff(t)
    if step.max() > 1.5 * np.median(step):
        return
    run, _ = uniform(raw(t=t, x=np.sin(np.arange(count))), jitter=0.0)
    assert np.array_equal(run.column("x"), np.sin(np.arange(count)))
    assert np.abs(run.t - ideal).max() <= 1.01 * tick + 1e-6
    assert np.ptp(np.diff(run.t)) <= 4 * np.spacing(t[-1])


def test_a_single_precision_clock_is_seen_through():
    t = (0.001 * np.arange(20_000)).astype(np.float32).astype(float)
    assert np.abs(uniform(raw(t=t, x=t), jitter=1e-4)[0].t - 0.001 * np.arange(20_000)).max() < 1e-6


def moving(t):
    return np.sin(3.0 * t) + 0.5 * np.cos(7.3 * t + 1.0)


COUNT, PERIOD, NOISE = 3000, 0.005, 1e-3
REGULAR = PERIOD * np.arange(COUNT)
LOST = np.random.default_rng(7).choice(np.arange(1, COUNT - 1), 150, replace=False)


def normal(seed):
    return np.random.default_rng(seed).standard_normal(COUNT)


def uneven(seed, size=0.3):
    return np.random.default_rng(seed).uniform(-size, size, COUNT)


LOGS = {  # when samples were taken, their stamps, what was lost
    "clock jitter": (REGULAR, REGULAR + 0.1 * PERIOD * normal(1), ()),
    "sampling jitter": (t := REGULAR + PERIOD * uneven(2), t, ()),
    "irregular steps": (t := np.cumsum(PERIOD * (1.0 + uneven(3))), t, ()),
    "late stamps": (REGULAR, REGULAR + 0.9 * PERIOD * (np.arange(COUNT) % 70 == 3), ()),
    "long first step": (t := np.r_[-0.7 * PERIOD, REGULAR[1:]], t, ()),
    "lost rows": (REGULAR, REGULAR, LOST),
    "lost rows of a clock with jitter": (REGULAR, REGULAR + 0.1 * PERIOD * normal(4), LOST),
    "a gap": (REGULAR, REGULAR, range(1000, 1015)),
}


@pytest.mark.parametrize("log", LOGS)
def test_white_noise_about_the_truth_stays_white_and_keeps_its_variance(log):
    """Interpolation would colour the noise and take a third of its variance at 30 % jitter."""
    taken, stamps, lost = LOGS[log]
    y = moving(taken) + NOISE * normal(11)
    run, _ = uniform(raw(t=np.delete(stamps, lost), x=np.delete(y, lost)))
    measured = run.counted("x") > 0
    assert run.counted("x").sum() == COUNT - len(lost)
    error = ((run.column("x") - moving(run.t)) * np.sqrt(run.counted("x")))[measured] / NOISE
    deviation = 1.0 / np.sqrt(len(error))
    assert abs(error.mean()) < 4.0 * deviation
    assert abs(error.std() - 1.0) < 4.0 * deviation / np.sqrt(2.0)
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 4.0 * deviation
    filled = (run.column("x") - moving(run.t))[~measured]
    assert not filled.size or np.abs(filled).max() < 4.0 * NOISE
    assert run.sample_period == pytest.approx(PERIOD, rel=2e-5 if "irregular" not in log else 0.02)


def test_a_column_at_a_third_of_the_rate_is_filled_between_its_samples():
    y = np.column_stack([moving(REGULAR), np.where(np.arange(COUNT) % 3 == 0, moving(REGULAR), np.nan)])
    run, _ = uniform(raw(t=REGULAR, x=y[:, 0], v=y[:, 1]))
    assert np.array_equal(run.column("x"), moving(run.t))
    assert np.array_equal(run.counted("v"), np.arange(len(run)) % 3 == 0)
    assert np.abs(run.column("v") - moving(run.t)).max() < 1e-5


def test_a_record_holds_what_lies_between_samples_of_every_column():
    """A column's samples before and after that still say what it is at the ends."""
    y, start, end = moving(REGULAR), np.arange(COUNT) < 5, np.arange(COUNT) > 2900
    x = np.where(start, np.nan, y)
    v = np.where(end | (np.arange(COUNT) % 7 > 0), np.nan, y)
    run, points = uniform(raw(t=REGULAR, x=x, v=v))
    assert (run.t[0], run.t[-1]) == (REGULAR[5], REGULAR[2898])
    assert np.array_equal(REGULAR[(points >= 0) & (points < len(run))], run.t)
    assert np.abs(run.column("v") - moving(run.t)).max() < 1e-4
    assert np.array_equal(run.column("x"), moving(run.t))


def test_a_held_value_fills_the_interval_after_it_and_gaps():
    stairs = np.floor(np.arange(500) / 50)
    t = 0.01 * (np.arange(500) + np.random.default_rng(0).uniform(-0.2, 0.2, 500))
    run, _ = uniform(raw(t=t, x=np.sin(6 * t), u=stairs), held=frozenset({"u"}))
    assert np.array_equal(run.column("u"), stairs)
    kept = np.delete(np.arange(500), np.arange(120, 130))
    run, _ = uniform(raw(t=0.01 * kept, u=stairs[kept]), held=frozenset({"u"}))
    assert np.array_equal(run.column("u"), stairs)


def test_commands_say_nothing_of_when_samples_were_taken():
    """A regular sequence of commands, played by a clock with jitter, would have it that the clock is regular."""
    t = REGULAR + PERIOD * uneven(5)
    log = raw(t=t, x=moving(t) + NOISE * normal(6), u=np.sin(2.0 * REGULAR))
    run, _ = uniform(log, inputs=frozenset({"u"}))
    assert run.repairs.jitter == 0.0
    assert np.std(run.column("x") - moving(run.t)) == pytest.approx(NOISE, rel=0.1)
    assert uniform(log)[0].repairs.jitter > 0.1


def test_commands_that_look_held_stay_held_where_sampling_jitters():
    stairs = np.repeat(np.random.default_rng(9).standard_normal(COUNT // 5), 5)
    t = REGULAR + PERIOD * uneven(5)
    run, _ = uniform(raw(t=t, x=moving(t), u=stairs), inputs=frozenset({"u"}))
    assert np.array_equal(run.column("u"), stairs)


def test_the_points_of_rows_are_where_their_samples_went():
    run, points = uniform(raw(t=np.delete(REGULAR, LOST), x=np.delete(REGULAR, LOST)))
    assert np.array_equal(np.flatnonzero(run.counted("x")), points)
    assert np.array_equal(run.column("x")[points], np.delete(REGULAR, LOST))


def test_the_jitter_is_the_least_over_all_grids():
    """Against a dense search over slopes and offsets."""
    rng = np.random.default_rng(3)
    t = np.arange(30) + rng.uniform(-0.2, 0.2, 30)
    slopes = np.linspace(0.98, 1.02, 4001)
    rest = t - slopes[:, None] * np.arange(30)
    least = np.ptp(rest, axis=1).min() / 2 / np.median(np.diff(t))
    with pytest.raises(InputError, match=r"limit is 0\.05") as caught:
        uniform(raw(t=t, x=t), jitter=0.05)
    told = float(re.search(r"deviates by ([\d.]+) sample periods", str(caught.value))[1])
    assert told == pytest.approx(least, rel=0.03)  # periods are those of the grid here, medians there
    uniform(raw(t=t, x=t), jitter=1.01 * told)


@pytest.mark.parametrize("seed", range(10))
def test_a_regular_clock_that_lost_half_of_its_rows_is_seen_through(seed):
    ideal = 3.0 + np.linspace(0.0, 10.0, 150)
    kept = np.sort(np.random.default_rng(seed).choice(150, 75, replace=False))
    run, points = uniform(raw(t=ideal[kept], x=np.sin(ideal[kept])))
    assert run.sample_period == pytest.approx(10.0 / 149)
    assert np.abs(run.t[points] - ideal[kept]).max() < 1e-6
    assert np.array_equal(run.column("x")[points], np.sin(ideal[kept]))
    assert run.counted("x").sum() == 75


def test_a_coarse_clock_read_with_jitter_is_not_taken_for_a_fine_one_with_lost_rows():
    """Its steps are whole ticks too, but what comes late is made up for by the next."""
    rng, period = np.random.default_rng(4), 0.02
    ideal = period * np.arange(400)
    t = np.rint((ideal + rng.uniform(-0.008, 0.008, 400)) / 0.01) * 0.01
    t = np.maximum.accumulate(t + 0.01 * np.concatenate([[0.0], np.diff(t) == 0.0]))
    keep = np.concatenate([[True], np.diff(t) > 0.0])
    run, _ = uniform(raw(t=t[keep], x=np.sin(t[keep])))
    assert run.sample_period == pytest.approx(period, rel=0.02)


@pytest.mark.parametrize("ratio", [1.02, 1.067, 1.1, 1.3, 1.49])
@pytest.mark.parametrize("jitter", [0.0, 0.02])
def test_a_regular_clock_with_a_coarse_tick_is_not_taken_for_a_faster_one_with_lost_rows(ratio, jitter):
    rng = np.random.default_rng(8)
    ideal = 0.01 * ratio * np.arange(800)
    t = 0.01 * np.floor(ideal / 0.01 + 0.3 + jitter * rng.uniform(-1.0, 1.0, 800))
    keep = np.concatenate([[True], np.diff(t) > 1e-6])
    run, _ = uniform(raw(t=t[keep], x=moving(ideal[keep])))
    assert run.sample_period == pytest.approx(0.01 * ratio, rel=3e-3)
    if keep.all():
        assert np.array_equal(run.column("x"), moving(ideal))
        assert run.counts is None


@pytest.mark.parametrize("every", [4, 10, 24])
def test_a_clock_that_loses_every_so_many_rows_is_told_by_its_values_from_a_coarse_tick(every):
    ideal = 0.01 * np.arange(800)
    kept = np.arange(800) % every > 0
    x = moving(ideal) + 1e-4 * np.random.default_rng(9).standard_normal(800)
    run, _ = uniform(raw(t=ideal[kept], x=x[kept]))
    assert run.sample_period == pytest.approx(0.01)
    assert run.counted("x").sum() == kept.sum()


@pytest.mark.parametrize("seed", range(5))
def test_rows_that_are_lost_by_chance_are_no_coarse_tick(seed):
    kept = np.sort(np.random.default_rng(seed).choice(400, 385, replace=False))
    run, _ = uniform(raw(t=0.01 * kept, x=np.zeros(385)))
    assert run.sample_period == pytest.approx(0.01)


def test_stamps_that_fit_no_grid_are_taken_as_irregular():
    t = np.cumsum(np.random.default_rng(5).uniform(0.5, 1.5, 200))
    run, _ = uniform(raw(t=t, x=moving(t)))
    assert run.sample_period == pytest.approx(np.mean(np.diff(t)), rel=0.05)
