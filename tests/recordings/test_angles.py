import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.recordings.angles import unwrap
from odescope.recordings.gaps import RawRun

TIME = np.arange(40) * 0.01


def raw(**columns):
    t = columns.pop("t", TIME)
    names, values = tuple(columns), np.column_stack(list(columns.values()))
    return RawRun(t, values, names, (None,) * len(names), "run1.csv", np.arange(1, len(t) + 1), names)


def unwrapped(run):
    return unwrap(run, ["phi"]).values[:, 0]


@settings(deadline=None)
@given(start=st.floats(-3, 3), steps=st.lists(st.floats(-2.3, 2.3), min_size=1, max_size=60))
def test_unwrap_removes_all_jumps(start, steps):
    angle = start + np.cumsum([0, *steps])
    wrapped = np.angle(np.exp(1j * angle))
    run = raw(t=np.arange(len(angle)), phi=wrapped, x=wrapped)
    assert np.abs(unwrapped(run) - angle).max() < 1e-9 * (1 + np.abs(angle).max())
    assert np.array_equal(unwrap(run, ["phi"]).values[:, 1], wrapped)


@pytest.mark.parametrize("step", [2.4, 3.0, -3.0])
def test_unwrap_follows_a_fast_turn(step):
    angle = step * np.arange(40)
    run = raw(phi=np.angle(np.exp(1j * angle)))
    assert np.abs(unwrapped(run) - angle).max() < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_steps_further_than_pi_is_not_taken_for_turns(seed):
    t = np.arange(40_000) * 1e-3
    angle = 3.0 * t + 4.0 * np.sin(2.0 * t) + 0.55 * np.random.default_rng(seed).standard_normal(len(t))
    wrapped = np.angle(np.exp(1j * angle))
    assert np.abs(np.diff(angle)).max() > np.pi
    turns = (unwrapped(raw(t=t, phi=wrapped)) - angle) / (2.0 * np.pi)
    assert np.abs(turns - np.rint(turns[0])).max() < 1e-9


def test_what_runs_over_turns_in_long_steps_stays_as_it_was_recorded():
    """Degrees that nobody declared: unwrapped as radians they would be noise, of which nothing can be said."""
    degrees = 60.0 * np.sin(np.arange(400) * 0.08)
    assert np.pi < np.abs(np.diff(degrees)).max() < 2.0 * np.pi - 1.0
    assert np.array_equal(unwrapped(raw(t=np.arange(400) * 0.01, phi=degrees)), degrees)
    far = np.angle(np.exp(0.1j * np.arange(400)))
    far[200] = 500.0  # a wrapped angle with a sample that is far off
    assert np.abs(np.diff(np.delete(unwrapped(raw(t=np.arange(400) * 0.01, phi=far)), 200))).max() < 0.3


def test_an_angle_that_jumps_by_360_is_taken_for_degrees():
    degrees = np.mod(np.arange(40) * 25.0, 360)
    with pytest.raises(InputError, match=r"'phi' jumps by about 360 in run1\.csv \(2 times, .*radians .* pi/180"):
        unwrap(raw(phi=degrees), ["phi"])


@pytest.mark.parametrize("gap", [1, 10, 30])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_an_angle_goes_on_turning_through_a_gap(gap, noise):
    t = np.delete(np.arange(400) * 0.01, np.arange(200, 200 + gap))
    angle = 40.0 * t + 3.0 * np.sin(5.0 * t) + noise * np.random.default_rng(gap).standard_normal(len(t))
    wrapped = np.mod(angle, 2.0 * np.pi)
    wrapped[50] = np.nan
    found = unwrapped(raw(t=t, phi=wrapped)) - angle
    assert np.isnan(found[50])
    assert np.nanmax(np.abs(found)) < 1e-9


def test_noise_makes_no_turn_of_a_gap():
    t = np.delete(np.arange(400) * 0.01, np.arange(200, 230))
    angle = np.sin(t) + 0.3 * np.random.default_rng(1).standard_normal(len(t))
    assert np.array_equal(unwrapped(raw(t=t, phi=angle)), angle)
