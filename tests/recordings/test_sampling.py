import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.recordings.record import Record
from odescope.recordings.sampling import RawRun, split_gaps, uniform, unwrap

TIME = np.arange(40) * 0.01


def record(**columns):
    t = columns.pop("t", TIME)
    return Record(t, np.column_stack(list(columns.values())), tuple(columns), source="run1.csv")


def raw(t, values, labels=("x [m]", "phi")):
    values = np.asarray(values, dtype=float)
    rows = np.arange(1, len(t) + 1)
    return RawRun(np.asarray(t, dtype=float), values, ("x", "phi"), (None, "rad"), "run1.csv", rows, labels)


# gaps


def test_a_complete_run_is_one_record_with_its_values():
    values = np.column_stack([TIME, -TIME])
    for gaps in ("refuse", "split"):
        (run,) = split_gaps(raw(TIME, values), gaps)
        assert np.array_equal(run.values, values)
        assert run.units == (None, "rad")


def test_gaps_are_told_by_column_and_row():
    t, values = np.arange(600.0), np.zeros((600, 2))
    values[119:131, 1] = values[399, 1] = values[511:, 1] = np.nan
    values[4, 0] = np.nan
    message = (
        r"column 'x \[m\]' has 1 gap \(data row 5\) and column 'phi' has 3 gaps \(data rows 120-131, 400, 512-600\) "
        r"in run1\.csv, where row 1 is the first row of data; repair them there or set gaps = 'split' in \[data\]"
    )
    with pytest.raises(InputError, match=message):
        split_gaps(raw(t, values))


def test_gaps_of_time_are_told():
    t = np.r_[np.arange(20), np.arange(25, 60), np.nan]
    with pytest.raises(InputError, match=r"time has 1 gap \(data row 56\) and time has 1 gap \(after data row 20\)"):
        split_gaps(raw(t, np.zeros((56, 2))))


def test_split_at_missing_cells_and_jumps_of_time():
    t = np.r_[np.arange(30.0), np.arange(40.0, 90.0)]
    values = np.column_stack([t, t])
    values[60, 0] = values[62, 1] = t[75] = np.nan
    pieces = split_gaps(raw(t, values), "split")
    assert [(run.t[0], run.t[-1]) for run in pieces] == [(0, 29), (40, 69)]  # 73-84 and 86-89 are too short


@settings(deadline=None)
@given(missing=st.sets(st.integers(0, 199), max_size=12), jump=st.integers(1, 199))
def test_split_loses_only_missing_rows_and_short_pieces(missing, jump):
    t = np.arange(200.0)
    t[jump:] += 10
    values = np.column_stack([t, t])
    values[list(missing), 1] = np.nan
    edges = sorted({*(k for m in missing for k in (m, m + 1)), jump, 0, 200})
    expected = [range(a, b) for a, b in pairwise(edges) if a not in missing and b - a >= 16]
    pieces = split_gaps(raw(t, values), "split")
    assert [list(run.t) for run in pieces] == [list(t[list(rows)]) for rows in expected]


def test_split_that_leaves_nothing_is_refused():
    values = np.zeros((60, 2))
    values[::12] = np.nan
    with pytest.raises(InputError, match=r"nothing is left in run1\.csv .* longest of 5 pieces has 11 samples"):
        split_gaps(raw(np.arange(60), values), "split")


def test_infinite_values_and_time_running_back_are_no_gaps():
    values = np.zeros((40, 2))
    values[9, 0] = np.inf
    with pytest.raises(InputError, match=r"'x \[m\]' is not a finite number in data row 10"):
        split_gaps(raw(TIME, values), "split")
    t = np.r_[TIME[:20], np.nan, TIME[:19]]
    with pytest.raises(InputError, match="goes back at data row 22"):
        split_gaps(raw(t, np.zeros((40, 2))), "split")


# angles


@settings(deadline=None)
@given(start=st.floats(-3, 3), steps=st.lists(st.floats(-3, 3), min_size=1, max_size=60))
def test_unwrap_removes_all_jumps(start, steps):
    angle = start + np.cumsum([0, *steps])
    wrapped = np.angle(np.exp(1j * angle))
    run = record(t=np.arange(len(angle)), phi=wrapped, x=wrapped)
    assert np.abs(unwrap(run, ["phi"]).column("phi") - angle).max() < 1e-9 * (1 + np.abs(angle).max())
    assert np.array_equal(unwrap(run, ["phi"]).column("x"), wrapped)


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
