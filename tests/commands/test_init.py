"""A study from a look at a data file: what it says, and that it runs."""

import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from logs import oscillator, pendulum, smooth, write
from pyarrow import parquet

from odescope.study.draft import draft
from odescope.study.options import Driven, Measured
from odescope.study.toml import parse_study, read_study

RNG = np.random.default_rng(0)
T = 0.01 * np.arange(1500)


def drafted(columns, name="log.csv"):
    write(name, {label: np.asarray(values, dtype=float) for label, values in columns.items()})
    found = draft([Path(name)], [Path(name)], Path())
    return parse_study(found.text), found.text


def motion(seed, size=1.0):
    return smooth(np.random.default_rng(seed), len(T), 0.01, 1.5, size)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_what_is_written_runs_as_it_is(odescope):
    log = oscillator(1200)
    Path("deep").mkdir()
    write("deep/run.csv", {"time (ms)": 1000.0 * log["t"], "x (mm)": log["x"], "u [V]": log["u"], "ok": 0.0 * log["t"]})
    ended = odescope("init", "deep/run.csv")
    assert (ended.code, ended.out) == (0, "")
    assert ended.err.startswith(
        "wrote deep/run.toml (coordinates: 1, inputs: 1; left out, see its last lines: ok): read it, then run odescope"
    )
    text = Path("deep/run.toml").read_text()
    assert text.count("\n") < 40
    commented = [line for line in text.splitlines() if line.strip() and line[0] != "[" and not line.startswith("files")]
    assert all("#" in line for line in commented)
    study = parse_study(text)
    assert study.data.files == ("run.csv",)
    assert (study.data.time, study.data.time_unit) == ("time (ms)", "ms")
    assert study.coordinates == {"x": Measured(column="x (mm)", order=2, unit="mm")}
    assert study.inputs == {"u": Driven(column="u [V]", unit="V")}
    assert "#   ok: constant, 0" in text
    ended = odescope("identify", "deep/run.toml")
    assert ended.code == 0, ended.err
    found = {b: float(a) for a, b in re.findall(r"([\d.]+)\*(\w+)", ended.out)}
    assert found == pytest.approx({"x": 4.0, "x_dot": 0.3, "u": 1.0}, rel=0.01)


def test_a_study_that_is_there_is_only_replaced_by_force(odescope):
    write("run.csv", oscillator(300))
    Path("run.toml").write_text("mine")
    assert "run.toml exists: name another with --out, or" in odescope.refused("init", "run.csv")
    assert odescope("init", "run.csv", "--out", "new/study.toml").code == 0
    assert parse_study(Path("new/study.toml").read_text()).data.files == ("../run.csv",)
    assert odescope("init", "run.csv", "--force").code == 0
    assert "x = { order = 2 }" in Path("run.toml").read_text()


@pytest.mark.parametrize(("name", "said"), [("Datum/Zeit", "Datum/Zeit"), ("logged", "logged"), ("Uhrzeit", "Uhrzeit")])
def test_a_column_of_dates_is_the_time(here, odescope, name, said):
    rows = [f"{k // 60:02}:{k % 60:02};{x:.4f};0\n" for k, x in enumerate(motion(3)[:1000].tolist())]
    date = "08:" if name == "Uhrzeit" else "31.01.2024 08:"
    text = f"Größe;{name};x (mm);Datum\n" + "".join(f"1;{date}{row[:-3]};31.01.2024\n" for row in rows)
    Path("log.csv").write_bytes(text.replace(".", ",").replace(date.replace(".", ","), date).encode("cp1252"))
    assert odescope("init", "log.csv").code == 0
    written = Path("log.toml").read_text()
    assert parse_study(written).data.time == said
    assert "one every 1 s, 999 s in all" in written
    assert ('date = "Datum"' in written) == (name == "Uhrzeit")  # elsewhere the time holds the day
    assert ("Datum: dates" in written) == (name != "Uhrzeit")


def test_times_that_cannot_be_read_are_told_with_what_can(here, odescope):
    rows = [f"31/01/2024 08:{k // 60:02}:{k % 60:02},{x:.4f}\n" for k, x in enumerate(motion(3)[:600].tolist())]
    Path("log.csv").write_text("Time,x (mm)\n" + "".join(rows))
    assert odescope("init", "log.csv").code == 0
    (told,) = [line for line in Path("log.toml").read_text().splitlines() if line.startswith("#   Time: ")]
    assert "'31/01/2024 08:00:00'" in told
    assert "dates are read as 2024-01-31 12:00:00.5" in told


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
    assert "where friction is dry, name sign(omega) in [library] basis" in text


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


@pytest.mark.parametrize(
    ("columns", "part"),
    [
        ({"t": T}, "holds no numbers beside the time"),
        (
            {"t": T, "u": np.sign(motion(1))},
            "no column of log.csv looks like a coordinate (u: held between its samples, as a command is)",
        ),
    ],
)
def test_a_log_without_coordinates_is_refused(odescope, columns, part):
    write("log.csv", columns)
    assert part in odescope.refused("init", "log.csv")
    assert "no such file" in odescope.refused("init", "missing.csv")


def test_a_day_and_a_clock_in_two_columns_are_one_time(odescope):
    t, x, u = oscillator(600).values()
    stamps = [np.datetime64("2024-01-31T23:59:55", "us") + np.timedelta64(round(1e6 * v), "us") for v in t.tolist()]
    apart = [str(s).split("T") for s in stamps]
    rows = [f"{d},{c},{a!r},{b!r}" for (d, c), a, b in zip(apart, x.tolist(), u.tolist(), strict=True)]
    Path("apart.csv").write_text("\n".join(["Date,Time,x,u", *rows]) + "\n")
    assert odescope("init", "apart.csv").code == 0
    text = Path("apart.toml").read_text()
    data = read_study(Path("apart.toml")).data
    assert (data.time, data.date, data.recording) == ("Time", "Date", None)
    Path("apart.toml").write_text(f"{text}\n[likelihood]\nenabled = false\n")
    assert odescope("identify", "apart.toml").code == 0
    assert odescope("simulate", "apart", "apart.csv", "--out", "run.csv").code == 0
    written = [line.partition(",")[0] for line in Path("run.csv").read_text().splitlines()]
    assert written[0] == "Time"
    assert [np.datetime64(cell, "us") for cell in written[1:]] == stamps


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


def test_cells_that_are_no_numbers_are_told_where_a_column_is_left_out(here, odescope):
    cells = [repr(x) for x in motion(1)[:99].tolist()]
    cells[7] = "fail"
    rows = [f"{t!r},{x},{t * t!r}\n" for t, x in zip(T[:99].tolist(), cells, strict=True)]
    Path("log.csv").write_text("t,x,u\n" + "".join(rows))
    assert odescope("init", "log.csv").code == 0
    assert "#   x: has cells that are not numbers (line 9: 'fail')" in Path("log.toml").read_text()
    Path("ragged.csv").write_text("t,x\n0.0,1.0\n0.1,2.0,3.0\n")
    assert "line 3 of ragged.csv has 3 cells where the header has 2" in odescope.refused("init", "ragged.csv")
    Path("twice.csv").write_text("t,x,x\n0.0,1.0,2.0\n0.1,2.0,3.0\n")
    assert "twice.csv has 2 columns named 'x'" in odescope.refused("init", "twice.csv")
    Path("bare.csv").write_text("0.0,1.0\n0.1,2.0\n0.2,2.5\n")
    assert "the first line of bare.csv holds numbers" in odescope.refused("init", "bare.csv")


def test_of_several_files_all_that_have_what_the_first_has_are_looked_at(here, odescope):
    for name in ("a.csv", "b.csv"):
        write(name, {"t": T, "x": motion(1)})
    assert odescope("init", "a.csv", "b.csv", "--out", "both.toml").code == 0
    assert "# 3000 samples in 2 recordings" in Path("both.toml").read_text()
    write("b.csv", {"t": T, "y": motion(1)})
    write("c.csv", {"t": T, "x": np.nan * T})
    assert odescope("init", "a.csv", "b.csv", "c.csv", "--out", "other.toml").code == 0
    assert "# a.csv: 1500 samples in 1 recording" in Path("other.toml").read_text()


def test_what_experiments_were_run_at_drives_and_what_is_sampled_unevenly_is_told_so(here, odescope):
    """Five tubes at a temperature each: one file shows it constant, and a grid has points that nobody sampled."""
    t = np.round(np.geomspace(0.1, 20.0, 25), 2)
    for k, level in enumerate((30.0, 40.0, 55.0)):
        write(f"{k}.csv", {"t": t, "S": np.exp(-0.1 * t), "X": np.exp(-0.2 * t), "T [°C]": level + 0.0 * t})
    assert odescope("init", "0.csv", "1.csv", "2.csv", "--out", "all.toml").code == 0
    text = Path("all.toml").read_text()
    study = parse_study(text)
    assert (list(study.coordinates), list(study.inputs)) == (["S", "X"], ["T"])
    assert study.inputs["T"].hold == "zero"
    assert {c.order for c in study.coordinates.values()} == {1}  # S and X are amounts, as s and x are positions
    assert re.search(r"75 samples in 3 recordings, one every [\d.]+ s on average", text)


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
    assert f"#   {label}: it counts the rows" in text


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


def test_no_column_is_lost_to_the_name_of_another(here):
    made = {"t": T, "x_4": motion(1), "u": motion(2), "x (m)": motion(3), "x (mm)": motion(4)}
    study, _ = drafted(made)
    read = {c.column or name for name, c in (*study.coordinates.items(), *study.inputs.items())}
    assert read == set(made) - {"t"}
