import numpy as np
import pytest

from odescope.errors import InputError
from odescope.recordings.checks import check_channels
from odescope.recordings.coordinate import (
    Coordinate,
    Input,
    check_name,
    following_states,
    state_chain,
    state_names,
)
from odescope.recordings.record import Record, Records

TIME = np.arange(40) * 0.01


def record(**columns):
    t = columns.pop("t", TIME)
    return Record(t, np.column_stack(list(columns.values())), tuple(columns), source="run1.csv")


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


def test_every_state_is_followed_by_its_derivative():
    """Along the chain of a coordinate as many steps as its order lead to its target; the numbers say the same."""
    coordinates = [Coordinate("c"), Coordinate("q", order=2), Coordinate("w", order=3)]
    chain, names = state_chain(coordinates), state_names(coordinates)
    assert tuple(chain) == names == ("c", "q", "w", "q_dot", "w_dot", "w_ddot")
    for c in coordinates:
        at = c.name
        for _ in range(c.order):
            at = chain[at]
        assert at == c.target
    targets = [c.target for c in coordinates]
    for follower, name in zip(following_states(coordinates).tolist(), chain.values(), strict=True):
        assert name == (names[follower] if follower >= 0 else targets[-1 - follower])


@pytest.mark.parametrize("order", [0, 9, -1, 1.5, True])
def test_coordinate_refuses_other_orders(order):
    with pytest.raises(InputError, match="'x': order must be a whole number from 1 to 8"):
        Coordinate("x", order=order)


def test_input_refuses_other_holds():
    with pytest.raises(InputError, match="hold must be one of 'linear', 'zero', 'band-limited', got 'cubic'"):
        Input("u", hold="cubic")


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
        (
            [Coordinate("x", unit="mm", angle=True)],
            [],
            "'x' is said to be an angle, and to be in mm: a length is no angle",
        ),
        ([Coordinate("x", unit="mrad", angle=True)], [], "to be in mrad: angles are in radians here, or in degrees"),
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
