import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.records import (
    Coordinate,
    Input,
    RawRun,
    Record,
    Records,
    check_channels,
    check_name,
    split_gaps,
    uniform,
    unwrap,
)

TIME = np.arange(40) * 0.01


def record(**columns):
    t = columns.pop("t", TIME)
    return Record(t, np.column_stack(list(columns.values())), tuple(columns), source="run1.csv")


def raw(t, values, labels=("x [m]", "phi")):
    values = np.asarray(values, dtype=float)
    rows = np.arange(1, len(t) + 1)
    return RawRun(np.asarray(t, dtype=float), values, ("x", "phi"), (None, "rad"), "run1.csv", rows, labels)


# names


@pytest.mark.parametrize("name", ["x", "_x1", "x_dot", "a" * 64])
def test_plain_names_pass(name):
    check_name(name, "column")


@pytest.mark.parametrize("name", ["", "2x", "x y", "x-y", "lambda", "None", "φ", "x.y", "__import__('os')", "a" * 65])
def test_other_names_are_refused(name):
    with pytest.raises(InputError, match=r"^column .* is not a plain name: expected"):
        check_name(name, "column")


def test_an_enormous_name_is_not_echoed_in_full():
    with pytest.raises(InputError, match=r"'aaaaaaaaaaaaaaaaaaaa'\.\.\. \(100000 characters\)") as caught:
        check_name("a" * 100_000, "column")
    assert len(str(caught.value)) < 300


# Record and Records


def test_record_columns_periods_and_units():
    run = Record(TIME, np.column_stack([TIME, -TIME]), ("x", "u"), ("m", None))
    assert np.array_equal(run.column("u"), -TIME)
    assert run.sample_period == pytest.approx(0.01)
    assert run.duration == pytest.approx(0.39)
    assert (len(run), run.units) == (40, ("m", None))


def test_record_neither_follows_nor_allows_writes():
    t, values = TIME.copy(), np.column_stack([TIME])
    run = Record(t, values, ("x",))
    values[3], t[3] = 99.0, 99.0
    assert run.values[3, 0] == run.t[3] == TIME[3]
    with pytest.raises(ValueError, match="read-only"):
        run.column("x")[0] = 1.0


@pytest.mark.parametrize(
    ("t", "values", "names", "message"),
    [
        (TIME, np.zeros((39, 1)), ("x",), r"t \(40,\), values \(39, 1\)"),
        (TIME, np.zeros((40, 2)), ("x",), r"1 names"),
        (TIME, np.zeros(40), ("x",), "2-d array of real numbers, got 1-d"),
        (TIME, np.zeros((40, 1)) * 1j, ("x",), "real numbers, got 2-d complex"),
        (TIME[:1], np.zeros((1, 1)), ("x",), "at least 2 samples, got 1"),
        (TIME, np.where(np.arange(40) == 7, np.nan, 0.0)[:, None], ("x",), "'x' is not a finite number in data row 8"),
        (np.where(np.arange(40) == 7, np.inf, TIME), np.zeros((40, 1)), ("x",), "'time' is not a finite .* row 8"),
        (np.r_[TIME[:20], TIME[:20]], np.zeros((40, 1)), ("x",), r'goes back at data row 21 .*recording = "\.\.\."'),
        (
            np.r_[TIME[:20], TIME[19:39]],
            np.zeros((40, 1)),
            ("x",),
            r"time repeats at data row 21 \(0\.19, then 0\.19\)",
        ),
        (TIME, np.zeros((40, 2)), ("x", "x"), "'x' is used twice"),
        (TIME, np.zeros((40, 1)), ("x y",), "'x y' is not a plain name"),
    ],
)
def test_record_refuses(t, values, names, message):
    with pytest.raises(InputError, match=message):
        Record(t, values, names)


def test_a_missing_column_names_the_nearest():
    with pytest.raises(InputError, match=r"no column 'position' in run1\.csv; did you mean 'positions'\?"):
        record(positions=TIME, u=TIME).column("position")


def test_records_of_one_several_or_themselves():
    run = record(x=TIME, u=TIME)
    both = Records.of(iter([run, run]))
    assert (len(Records.of(run)), len(both), both.samples, both.names) == (1, 2, 80, ("x", "u"))
    assert list(both) == [run, run]
    assert Records.of(both) is both


def test_records_refuses_none_and_different_columns():
    with pytest.raises(InputError, match="no recording"):
        Records.of([])
    with pytest.raises(InputError, match=r"run1\.csv has x, but one has x \[m\]"):
        Records.of([record(x=TIME), Record(TIME, TIME[:, None], ("x",), ("m",))])


# Coordinate and Input


def test_names_of_derivatives():
    phi = Coordinate("phi", order=2, angle=True)
    assert (phi.states, phi.target, phi.derivative(3)) == (("phi", "phi_dot"), "phi_ddot", "phi_dddot")
    assert (Coordinate("c").states, Coordinate("c").target) == (("c",), "c_dot")


@pytest.mark.parametrize("order", [0, 9, -1, 1.5, True])
def test_coordinate_refuses_other_orders(order):
    with pytest.raises(InputError, match="'x': order must be a whole number from 1 to 8"):
        Coordinate("x", order=order)


def test_input_refuses_other_holds():
    with pytest.raises(InputError, match="hold must be 'linear' or 'zero', got 'cubic'"):
        Input("u", hold="cubic")


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


# sampling


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


# channels


@pytest.mark.parametrize(
    ("coordinates", "inputs", "message"),
    [
        ([], [], "no coordinate"),
        ([Coordinate("still")], [], "coordinate 'still' is constant in every recording; leave it out"),
        ([Coordinate("x")], [Input("still")], "input 'still' is constant"),
        ([Coordinate("x"), Coordinate("x")], [], "'x' is used twice"),
        ([Coordinate("x", order=2)], [Input("x_dot")], "'x_dot' is used twice: by coordinate 'x' and by input 'x_dot'"),
        ([Coordinate("x")], [Input("x_dot")], "'x_dot' is used twice"),  # the target is a name as well
        ([Coordinate("x", unit="Deg", angle=True)], [], "'x' has the unit 'Deg', but angles are in radians"),
        ([Coordinate("wheel", angle=True)], [], "looks like degrees"),
        ([Coordinate("vast")], [], r"'vast' has values as large as 1e\+40"),
        ([Coordinate("y")], [], "no column 'y'"),
    ],
)
def test_channels_that_cannot_take_part(coordinates, inputs, message):
    sine = np.sin(10 * TIME)
    run = record(x=sine, still=0 * sine + 0.1, x_dot=sine, wheel=np.mod(np.arange(40) * 31.0, 360), vast=1e40 * sine)
    with pytest.raises(InputError, match=message):
        check_channels(Records.of(run), coordinates, inputs)


def test_channels_that_vary_pass():
    runs = [record(x=np.sin(TIME + k), level=np.full(40, float(k)), rest=TIME * (k == 0)) for k in range(2)]
    check_channels(Records.of(runs), [Coordinate("x", unit="deg"), Coordinate("rest", 2)], [Input("level")])


def test_the_unit_of_the_record_counts_too():
    run = Record(TIME, np.sin(TIME)[:, None], ("phi",), ("°",))
    with pytest.raises(InputError, match="unit '°'"):
        check_channels(Records.of(run), [Coordinate("phi", angle=True)], [])
