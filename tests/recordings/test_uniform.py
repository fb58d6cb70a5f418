import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.recordings.record import Record
from odescope.recordings.uniform import uniform, unwrap

TIME = np.arange(40) * 0.01


def record(**columns):
    t = columns.pop("t", TIME)
    return Record(t, np.column_stack(list(columns.values())), tuple(columns), source="run1.csv")


# angles


@settings(deadline=None)
@given(start=st.floats(-3, 3), steps=st.lists(st.floats(-2.3, 2.3), min_size=1, max_size=60))
def test_unwrap_removes_all_jumps(start, steps):
    angle = start + np.cumsum([0, *steps])
    wrapped = np.angle(np.exp(1j * angle))
    run = record(t=np.arange(len(angle)), phi=wrapped, x=wrapped)
    assert np.abs(unwrap(run, ["phi"]).column("phi") - angle).max() < 1e-9 * (1 + np.abs(angle).max())
    assert np.array_equal(unwrap(run, ["phi"]).column("x"), wrapped)


@pytest.mark.parametrize("step", [2.4, 3.0, -3.0])
def test_unwrap_follows_a_fast_turn(step):
    angle = step * np.arange(40)
    run = record(phi=np.angle(np.exp(1j * angle)))
    assert np.abs(unwrap(run, ["phi"]).column("phi") - angle).max() < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_steps_further_than_pi_is_not_taken_for_turns(seed):
    t = np.arange(40_000) * 1e-3
    angle = 3.0 * t + 4.0 * np.sin(2.0 * t) + 0.55 * np.random.default_rng(seed).standard_normal(len(t))
    wrapped = np.angle(np.exp(1j * angle))
    assert np.abs(np.diff(angle)).max() > np.pi
    turns = (unwrap(record(t=t, phi=wrapped), ["phi"]).column("phi") - angle) / (2.0 * np.pi)
    assert np.abs(turns - np.rint(turns[0])).max() < 1e-9


def test_an_angle_that_jumps_by_360_is_taken_for_degrees():
    degrees = np.mod(np.arange(40) * 25.0, 360)
    with pytest.raises(InputError, match=r"'phi' jumps by about 360 in run1\.csv \(2 times, .*radians .* pi/180"):
        unwrap(record(phi=degrees), ["phi"])


# uniform time


def test_a_uniform_record_keeps_its_values_and_loses_its_rounding():
    t = 5 + np.arange(1000) * 1e-3
    values = np.random.default_rng(0).normal(size=(1000, 1))
    run = uniform(Record(t, values, ("x",)))
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
    run = uniform(record(t=t, x=np.sin(np.arange(count))), jitter=0.0)
    assert np.array_equal(run.column("x"), np.sin(np.arange(count)))
    assert np.abs(run.t - ideal).max() <= 1.01 * tick + 1e-6
    assert np.ptp(np.diff(run.t)) <= 4 * np.spacing(t[-1])


def test_a_single_precision_clock_is_seen_through():
    t = (0.001 * np.arange(20_000)).astype(np.float32).astype(float)
    assert np.abs(uniform(record(t=t, x=t), jitter=1e-4).t - 0.001 * np.arange(20_000)).max() < 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_jitter_is_resampled(seed):
    rng = np.random.default_rng(seed)
    t = 0.01 * (np.arange(500) + rng.uniform(-0.04, 0.04, 500))
    stairs = np.floor(np.arange(500) / 50)
    run = uniform(record(t=t, x=np.sin(6 * t), u=stairs), held=frozenset({"u"}))
    assert np.ptp(np.diff(run.t)) < 1e-14
    assert np.abs(run.column("x") - np.sin(6 * run.t)).max() < 2e-6  # untouched values would be off by 2e-3
    assert np.array_equal(run.column("u"), stairs)


def test_resampling_a_step_overshoots_unless_held():
    t = 0.01 * (np.arange(60) + 0.03 * np.random.default_rng(0).uniform(-1, 1, 60))
    run = uniform(record(t=t, u=np.where(t > 0.3, 1.0, 0.0)))
    assert run.column("u").max() > 1.0003


def test_the_jitter_is_the_least_over_all_grids():
    """Against a dense search over slopes and offsets."""
    rng = np.random.default_rng(3)
    t = np.arange(30) + rng.uniform(-0.2, 0.2, 30)
    slopes = np.linspace(0.98, 1.02, 4001)
    rest = t - slopes[:, None] * np.arange(30)
    least = np.ptp(rest, axis=1).min() / 2 / np.median(np.diff(t))
    with pytest.raises(InputError, match=r"tolerance is 0\.05") as caught:
        uniform(record(t=t, x=t))
    told = float(re.search(r"deviates by ([\d.]+) sample periods", str(caught.value))[1])
    assert told == pytest.approx(least, rel=0.01)
    uniform(record(t=t, x=t), jitter=0.25)


def test_uniform_refuses_gaps():
    t = np.r_[np.arange(20.0), np.arange(22.0, 40.0)]
    with pytest.raises(InputError, match=r"time jumps by 3 in run1\.csv, the sample period being 1"):
        uniform(record(t=t, x=t), jitter=0.25)
