"""What columns look like, as a drafted study has it."""

import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from drafts import T, drafted, motion
from logs import pendulum
from pyarrow import parquet

from odescope.errors import InputError
from odescope.study.draft import draft
from odescope.study.options import Measured
from odescope.study.toml import parse_study

RNG = np.random.default_rng(0)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("label", "turn", "said", "degrees"),
    [
        ("a", 2.0 * np.pi, "an angle, it wraps by 2 pi", False),
        ("a", 360.0, "an angle, it wraps by 360", True),
        ("a [deg]", None, "an angle, by its unit", True),
        ("a (rad)", None, "an angle, by its unit", False),
        ("theta", None, "an angle, by its name", False),
    ],
)
def test_angles(here, label, turn, said, degrees):
    angle = pendulum(1500)["Winkel [rad]"] if turn else 0.4 * motion(1)
    values = angle * turn / (2.0 * np.pi) if turn else angle
    study, text = drafted({"t": T, label: values})
    ((name, found),) = study.coordinates.items()
    assert (found.angle, found.order) == (True, 2)
    assert (name in study.degrees) is degrees
    assert f"# {said}" in text


@pytest.mark.parametrize("label", ["omega_deg", "v_mm"])
def test_a_velocity_whose_heading_ends_in_half_a_unit_is_neither_angle_nor_position(here, label):
    study, text = drafted({"t": T, label: 0.4 * motion(1)})
    (found,) = study.coordinates.values()
    assert not found.angle
    assert "by its unit" not in text


@pytest.mark.parametrize(
    ("label", "order"), [("level [m]", 1), ("tank_level2 (cm)", 1), ("lever [m]", 2), ("y [cm]", 2)]
)
def test_the_level_of_a_liquid_is_an_amount_in_metres_too(here, label, order):
    study, text = drafted({"t": T, label: 0.5 + 0.1 * motion(1)})
    (found,) = study.coordinates.values()
    assert found.order == order
    assert ("the level of a liquid" in text) is (order == 1)


def test_an_angle_that_goes_far_may_be_in_degrees(here):
    _, text = drafted({"t": T, "theta": 40.0 * np.sin(T * 2.0 * np.pi / 5.0)})
    assert 'in degrees? Then add unit = "deg"' in text


def test_what_says_nothing_of_its_own_is_left_out(here):
    x, row = motion(2), np.arange(1500.0)
    v = np.gradient(x, 0.01) + 0.02 * RNG.standard_normal(1500)
    columns = {"t": T, "x": x + 1e-3 * RNG.standard_normal(1500), "v_mm": 1000.0 * v, "gain": 2.0 + 0.0 * T}
    study, text = drafted({**columns, "copy": 3.0 - 2.0 * columns["x"], "row": row, "none": np.nan * T})
    assert list(study.coordinates) == ["x"]
    assert not study.inputs
    said = dict(re.findall(r"#   (\w+): (.*)", text))
    assert said == {
        "v_mm": "the rate of x, which is found from it",
        "gain": "constant, 2",
        "copy": "the same as x",
        "row": "counts samples",
        "none": "no numbers, or none",
    }


def test_inputs_are_told_by_their_name_or_as_they_are_held(here):
    switched = np.repeat(RNG.standard_normal(60), 25)
    relay = np.repeat(RNG.integers(0, 2, 30), 50)
    columns = {
        "t": T,
        "level [V]": motion(3),
        "pwm": motion(4),
        "w": switched,
        "relay": relay,
        "motor_angle": motion(5),
    }
    study, text = drafted(columns)
    assert list(study.coordinates) == ["level", "motor_angle"]
    assert {name: i.hold for name, i in study.inputs.items()} == {"pwm": "auto", "w": "zero", "relay": "zero"}
    assert study.coordinates["level"].order == 1
    assert "held between its samples, as a command is" in text


def test_a_command_is_seen_to_be_held_where_the_stamps_are_not_even(here):
    rng, count = np.random.default_rng(4), 4320
    power = np.repeat(rng.choice([0.0, 20.0, 60.0, 110.0, 160.0, 200.0], count // 90), 90)
    stamps = np.round(5.0 * np.arange(count) + np.append(0.0, rng.uniform(-0.3, 0.3, count - 1)), 2)
    heat = 20.0 * np.sin(2.0 * np.pi * stamps / 100.0)
    study, text = drafted({"time_s": stamps, "T_heater (degC)": 60.0 + heat, "P (W)": power})
    assert study.inputs["P"].hold == "zero"
    assert "held between its samples, as a command is" in text


def test_a_slow_sensor_is_no_command(here):
    study, text = drafted({"t": T, "x": np.repeat(motion(6)[::5], 5)})
    assert list(study.coordinates) == ["x"]
    assert "read more often than it is measured" in text


def test_a_coarse_encoder_is_no_command(here):
    study, _ = drafted({"t": T, "x": 0.05 * np.rint(motion(6) / 0.05)})
    assert list(study.coordinates) == ["x"]


def test_a_speed_without_its_position_is_one(here):
    study, text = drafted({"t": T, "omega [rad/s]": motion(6)})
    assert study.coordinates["omega"].order == 1
    assert "a speed, by its unit: it may have dry friction" in text


def test_recordings_are_told_apart(here):
    again = np.concatenate([T[:500]] * 3)
    run = np.repeat([1.0, 2.0, 3.0], 500)
    for label in ("segment", "series_of_mine"):
        study, text = drafted({"t": again, label: run, "x": motion(7)})
        assert study.data.recording == label
        assert "in 3 recordings" in text
    study, _ = drafted({"t": T, "segment": run, "x": motion(7)})
    assert study.data.recording == "segment"


def test_batches_of_a_few_samples_are_told_apart_where_time_goes_back(here):
    t = np.tile(2.0 * np.arange(12), 5)
    run = np.repeat(np.arange(1.0, 6.0), 12)
    amount = np.exp(-0.1 * t) * np.repeat([1.0, 0.5, 2.0, 1.5, 0.8], 12)
    study, text = drafted({"run": run, "time (min)": t, "A (mol/L)": amount + 0.01 * np.sin(7.0 * t)})
    assert study.data.recording == "run"
    assert "60 samples in 5 recordings" in text


def test_what_is_called_a_temperature_is_one_where_kelvins_are(here):
    for label, middle, warm in (("T_jacket", 330.0, True), ("T_jacket", 30.0, False), ("level", 330.0, False)):
        _, text = drafted({"t": T, "c": motion(8), label: middle + 10.0 * motion(9) / np.ptp(motion(9))})
        assert ("a temperature in kelvins" in text) == warm


def test_without_a_time_the_period_is_to_be_changed(here):
    study, text = drafted({"u": motion(8), "y": motion(9)})
    assert study.data.sample_period == 1.0
    assert "# CHANGE THIS: seconds" in text
    study, _ = drafted({"clock": T, "y": motion(9)})
    assert study.data.time == "clock"
    study, _ = drafted({"elapsed": T, "y": motion(9)})
    assert study.data.time == "elapsed"


def test_names_that_formulae_cannot_use_are_replaced(here):
    study, _ = drafted({"t": T, "lambda": motion(1), "Höhe (m)": motion(2), "höhe [mm]": motion(3), "!": motion(4)})
    assert list(study.coordinates) == ["column_1", "Hohe", "hohe", "column_4"]
    assert [c.column for c in study.coordinates.values()] == ["lambda", "Höhe (m)", "höhe [mm]", "!"]


def test_a_column_of_something_else_that_is_called_as_the_time_is_none(here):
    rows = [
        f"05.03.2024 08:{k // 60:02}:{k % 60:02},{x:.4f},{y:.1f}\n"
        for k, (x, y) in enumerate(zip(motion(3)[:600].tolist(), (60.0 + motion(5)[:600]).tolist(), strict=True))
    ]
    for heading in ("T (°C)", "T"):
        Path("log.csv").write_text(f"Datum,level (mm),{heading}\n" + "".join(rows))
        found = draft([Path("log.csv")], [Path("log.csv")], Path())
        assert parse_study(found.text).data.time == "Datum"


def test_forces_and_torques_drive_by_their_units(here):
    columns = {
        "t": T,
        "phi (deg)": 40.0 * motion(1),
        "M [Nm]": motion(2),
        "load (N m)": motion(3),
        "push (kN)": motion(4),
    }
    study, text = drafted(columns)
    assert list(study.coordinates) == ["phi"]
    assert list(study.inputs) == ["M", "load", "push"]
    assert text.count("# a force or torque, by its unit") == 3


def test_what_is_there_alone_is_explained_whatever_it_is_called(here):
    study, text = drafted({"time (ms)": 1000.0 * T, "Voltage (V)": np.sin(5.0 * T) + 0.01 * motion(1)})
    assert study.coordinates == {"Voltage": Measured(column="Voltage (V)", order=2, unit="V")}
    assert "# it swings by itself, as nothing of order 1 does" in text
    decay = np.exp(-0.3 * T) + 0.01 * RNG.standard_normal(len(T))
    assert drafted({"t": T, "voltage": decay})[0].coordinates["voltage"].order == 1
    switched = np.repeat(RNG.integers(0, 2, 30), 50)
    study, _ = drafted({"t": T, "U in (V)": switched, "voltage": motion(3)})
    assert (list(study.coordinates), list(study.inputs)) == (["voltage"], ["U_in"])


def stepped(seed, levels, rows=150):
    return np.repeat(np.random.default_rng(seed).choice(levels, 10), rows)


def test_a_command_is_one_in_any_unit_and_by_however_few_steps(here):
    """A rudder's angle, and doses of some tens: their steps are as alike as those of an encoder, and go anywhere."""
    noisy = RNG.normal(size=len(T))
    columns = {"t": T, "psi (deg)": 20.0 * motion(7), "rudder (deg)": stepped(1, np.linspace(-25.0, 25.0, 40))}
    study, text = drafted(
        columns | {"dose": stepped(2, [10.0, 20.0, 30.0, 40.0]), "spare": noisy, "T_ambient": motion(8)}
    )
    assert list(study.coordinates) == ["psi"]
    assert {name: i.hold for name, i in study.inputs.items()} == {
        "rudder": "zero", "dose": "zero", "spare": "auto", "T_ambient": "auto",
    }  # fmt: skip
    assert "noise from sample to sample" in text


def test_an_amount_that_another_is_made_from_is_no_rate(here):
    """What recovers is in proportion to who is ill, as a velocity is to itself."""
    ill = np.exp(-0.5 * ((T - 6.0) / 2.0) ** 2) + 0.05 * np.sin(2.0 * T)
    well = 0.3 * np.cumsum(ill) * 0.01
    made = {"t": T, "ill": ill, "well": well}
    assert list(drafted(made)[0].coordinates) == ["ill", "well"]
    assert list(drafted({"t": T, "a (mol/L)": ill, "b (mol/L)": well / 0.3})[0].coordinates) == ["a", "b"]
    assert list(drafted({"t": T, "speed": ill, "way": well})[0].coordinates) == ["way"]
    assert list(drafted({"t": T, "a (mm/s)": ill, "b (m)": well})[0].coordinates) == ["b"]
    assert list(drafted({"t": T, "a": ill, "b": well / 0.3})[0].coordinates) == ["b"]


@pytest.mark.parametrize("label", ["day", "hours", "minutes"])
def test_a_clock_whose_heading_is_no_more_than_a_unit_is_asked_about(here, label):
    _, text = drafted({label: T, "x": motion(9)})
    assert f"in seconds? Its heading says {label}: say which in time_unit" in text


@pytest.mark.parametrize("label", ["", "Unnamed: 0", "index"])
def test_a_column_that_counts_the_rows_is_no_time_in_seconds(here, label):
    study, text = drafted({label: np.arange(len(T)), "x": motion(1)})
    assert (study.data.time, study.data.sample_period, list(study.coordinates)) == (None, 1.0, ["x"])
    assert "CHANGE THIS" in text
    assert f"#   {label or 'the column without a name'}: it counts the rows" in text


def test_even_steps_alone_leave_the_unit_of_a_clock_open(here):
    study, text = drafted({"k": T, "x": motion(1)})
    assert study.data.time == "k"
    assert "in seconds? It grows in even steps" in text


@pytest.mark.parametrize(
    ("label", "unit"), [("TimeUS", "us"), ("timeMs", "ms"), ("tms", "ms"), ("LogTimestampNs", "ns")]
)
def test_units_of_time_may_be_joined_to_the_word(here, label, unit):
    study, _ = drafted({label: np.rint(T * {"us": 1e6, "ms": 1e3, "ns": 1e9}[unit]), "x": motion(1)})
    assert (study.data.time, study.data.time_unit) == (label, unit)


def test_dates_as_spreadsheets_count_them_are_days(here):
    study, text = drafted({"Date": 45322.5 + T / 86400.0, "x": motion(1)})
    assert (study.data.time, study.data.time_unit) == ("Date", "d")
    assert "as spreadsheets count them" in text
    _, text = drafted({"Date": T, "x": motion(1)})
    assert "in seconds? Its heading says a date" in text


def test_names_that_a_study_would_refuse_are_others(here):
    study, _ = drafted({"t": T, "sin": motion(1), "cos": motion(2), "tanh [V]": motion(3)})
    assert {c.column for c in (*study.coordinates.values(), *study.inputs.values())} == {"sin", "cos", "tanh [V]"}
    noise = np.random.default_rng(5).standard_normal(len(T))
    study, text = drafted({"t": T, "x [m]": motion(1), "x_dot [counts]": motion(2) + 0.01 * noise})
    assert study.coordinates["x"].column == "x [m]"
    assert "x_dot_2 = " in text


def test_a_label_with_a_line_break_is_told_on_one_line(here):
    parquet.write_table(pa.table({"t": T, "x": motion(1), "of two\nlines": 0.0 * T}), "log.parquet")
    text = draft([Path("log.parquet")], [Path("log.parquet")], Path()).text
    assert "#   of two lines: constant, 0" in text


def test_a_separator_at_the_ends_of_lines_makes_no_column(here):
    lines = [f"{t!r},{x!r}," for t, x in zip(T.tolist(), motion(1).tolist(), strict=True)]
    Path("log.csv").write_text("\n".join(["t,x,", *lines]) + "\n")
    assert "Left out" not in draft([Path("log.csv")], [Path("log.csv")], Path()).text
    lines[4] += "bumped"
    Path("log.csv").write_text("\n".join(["t,x,", *lines]) + "\n")
    assert (
        "#   the column without a name: has cells that are not numbers (line 6: 'bumped')"
        in draft([Path("log.csv")], [Path("log.csv")], Path()).text
    )


def drafted_with(path, cells):
    """The study of a log in which cells of x, or of another column, are replaced, and its text."""
    made = {"t": T, "x": motion(1), "u": stepped(3, [0.0, 1.0, 3.0]), "gain": 0.0 * T}
    columns = {label: [repr(v) for v in values.tolist()] for label, values in made.items()}
    for label, row, cell in cells:
        columns[label][row] = cell
    Path(path).write_text("\n".join([",".join(made), *map(",".join, zip(*columns.values(), strict=True))]) + "\n")
    found = draft([Path(path)], [Path(path)], Path())
    return parse_study(found.text), found.text


def test_a_column_of_numbers_with_faults_is_one_and_they_are_told(here):
    clean, _ = drafted_with("log.csv", [])
    study, text = drafted_with("log.csv", [("x", 100, "err"), ("x", 200, ""), ("x", 700, "1.2.3"), ("gain", 3, "off")])
    assert (study.coordinates, study.inputs, study.data) == (clean.coordinates, clean.inputs, clean.data)
    assert "# CHANGE THIS in the data: a run refuses such cells until they are corrected or emptied\n#   x: " in text
    assert "#   x: has cells that are not numbers (line 102: 'err', line 702: '1.2.3'); empty cells and NaN" in text
    assert "off" not in text  # what the study does without is not refused
    study, text = drafted_with("log.csv", [("t", 100, "err"), ("u", 50, "?")])
    assert (study.data.time, study.coordinates, study.inputs) == ("t", clean.coordinates, clean.inputs)
    assert "#   t: has cells that are not numbers (line 102: 'err')" in text
    assert "#   u: has cells that are not numbers (line 52: '?')" in text


def test_a_tenth_of_the_cells_may_be_faults(here):
    empty = [("x", row, "") for row in range(0, 1500, 2)]
    assert "x" in drafted_with("log.csv", [*empty, *(("x", row, "err") for row in range(1, 151, 2))])[0].coordinates
    with pytest.raises(InputError, match=r"x: has cells that are not numbers \(line 3: 'err'"):
        drafted_with("log.csv", [*empty, *(("x", row, "err") for row in range(1, 153, 2))])


def test_no_column_is_lost_to_the_name_of_another(here):
    made = {"t": T, "x_4": motion(1), "u": motion(2), "x (m)": motion(3), "x (mm)": motion(4)}
    study, _ = drafted(made)
    read = {c.column or name for name, c in (*study.coordinates.items(), *study.inputs.items())}
    assert read == set(made) - {"t"}
