"""Labels with units in them: the plain name, the unit, and which column is meant."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.recordings.coordinate import check_name
from odescope.recordings.headings import (
    UNITS_OF_TIME,
    Heading,
    doubtful_time_unit,
    find_label,
    in_seconds,
    plain_name,
    time_unit,
    told_in_seconds,
)
from odescope.recordings.layout import Layout
from odescope.recordings.readers import read_records, records_from


@pytest.mark.parametrize(
    ("label", "name", "unit"),
    [
        ("x", "x", None),
        ("x (m)", "x", "m"),
        ("u [V]", "u", "V"),
        ("Motor angle [deg]", "Motor_angle", "deg"),
        ("F[Nm]", "F", "Nm"),
        ("acc (m/s^2)", "acc", "m/s^2"),
        ("acc [m s⁻²]", "acc", "m s⁻²"),
        ("k (1/s)", "k", "1/s"),
        ("flow {L/min}", "flow", "L/min"),
        ("T (°C)", "T", "°C"),
        ("φ [°]", "phi", "°"),
        ("Höhe (mm)", "Hohe", "mm"),
        ("2nd", "_2nd", None),
        ("_x", "_x", None),
        ("x ()", "x", None),
        ("x (filtered)", "x_filtered", None),  # no unit: two columns may differ in nothing else
        ("joint 1 [rad]", "joint_1", "rad"),
        ("theta_deg", "theta", "deg"),
        ("motor speed rpm", "motor_speed", "rpm"),
        ("pos_x_mm", "pos_x", "mm"),
        ("p1.kPa", "p1", "kPa"),
        ("x_cm", "x_cm", None),  # of its centre of mass, perhaps
        ("T_C", "T_C", None),
        ("x_bar", "x_bar", None),
        ("deg", "deg", None),
        ("_deg", "_deg", None),
        ("x_Deg", "x_Deg", None),
    ],
)
def test_a_label_is_a_name_and_a_unit(label, name, unit):
    assert Heading.of(label) == Heading(label, name, unit)


@given(st.text(max_size=30))
def test_a_plain_name_is_one_wherever_it_is_not_empty(text):
    name = plain_name(text)
    if name and name.isidentifier():
        assert plain_name(name) == name
    assert name == "" or (name.isascii() and name.isidentifier())


def test_names_that_formulae_can_use():
    for label in ("x (m)", "Motor angle [deg]", "2nd", "φ"):
        check_name(Heading.of(label).name, "column")


@pytest.mark.parametrize(
    ("label", "unit"),
    [
        ("t", None),
        ("time (ms)", "ms"),
        ("Time [s]", "s"),
        ("t_ms", "ms"),
        ("timestamp/us", "us"),
        ("time µs", "us"),
        ("milliseconds", "ms"),
        ("t (min)", "min"),
        ("t/min", "min"),
        ("Zeit / h", "h"),
        ("n/min", None),
        ("time [days]", "d"),
        ("t_min", None),  # the least of t
        ("t_h", None),
        ("time (samples)", None),
    ],
)
def test_the_unit_of_time_in_a_label(label, unit):
    assert time_unit(label) == unit


@pytest.mark.parametrize(
    ("label", "word"),
    [
        ("t", None),
        ("time (ms)", None),
        ("t_ms", None),
        ("minutes", "minutes"),
        ("time_of_day", None),
        ("time_hours", "hours"),
        ("t_min", "min"),
        ("Time, days", "days"),
        ("time (samples)", "samples"),
        ("time [kyr]", "kyr"),
        ("t ()", None),
    ],
)
def test_what_may_be_the_unit_of_time_and_is_not_taken_for_it(label, word):
    assert doubtful_time_unit(label) == word


def test_a_column_is_meant_by_its_label_or_by_its_plain_name():
    labels = ["time (ms)", "x (m)", "x [mm]", "u [V]", "Angle"]
    assert find_label("x (m)", labels, "run.csv") == "x (m)"
    assert find_label("u", labels, "run.csv") == find_label("u (V)", labels, "run.csv") == "u [V]"
    assert find_label("angle", labels, "run.csv") is None
    assert find_label("", labels, "run.csv") is None
    with pytest.raises(InputError, match=r"'x' may be 'x \(m\)' or 'x \[mm\]' in run.csv: name the column as"):
        find_label("x", labels, "run.csv")


@pytest.mark.parametrize("unit", UNITS_OF_TIME)
def test_times_come_in_seconds(unit, tmp_path):
    """A second is so many of the unit, by numpy's own clock."""
    one = np.timedelta64(3600, "s") / np.timedelta64(1, {"min": "m", "d": "D"}.get(unit, unit))
    stamps = np.arange(40.0)
    values = np.sin(stamps)
    layout = Layout("clock", columns=(("x", "x"),), time_unit=unit)
    table = {"clock": stamps, "x": values}
    pd.DataFrame(table).to_csv(tmp_path / "run.csv", index=False)
    for records in (records_from(table, layout), read_records(str(tmp_path / "run.csv"), layout)):
        assert records.runs[0].t == pytest.approx(stamps * 3600.0 / one, rel=1e-12)
    factor, over = in_seconds(unit)
    if unit == "ms":
        assert 1001.0 * factor / over == 1.001  # the nearest number, which a product with 0.001 is not


def test_rates_of_slow_logs_are_told_in_the_unit_of_the_log():
    assert told_in_seconds("ms") == "time was recorded in ms: in files and notes it is in seconds"
    assert told_in_seconds("h").endswith(
        "in files and notes it is in seconds (a coefficient times 3600 for each 1/s in its unit is one per h)"
    )


def test_dates_have_no_unit():
    dates = pd.to_datetime("2026-11-22") + pd.to_timedelta(np.arange(40) * 10, unit="ms")
    layout = Layout("t", columns=(("x", "x"),), time_unit="ms")
    (run,) = records_from(pd.DataFrame({"t": dates, "x": np.sin(np.arange(40.0))}), layout)
    assert run.sample_period == pytest.approx(0.01, rel=1e-4)


def test_what_is_no_unit_of_time_is_refused():
    with pytest.raises(InputError, match=r"time_unit must be one of 's', 'ms', .*, got 'day'"):
        Layout("t", columns=(("x", "x"),), time_unit="day")
