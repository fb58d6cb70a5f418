"""A study from a look at a data file: what the command says, and that it runs."""

import re
from pathlib import Path

import numpy as np
import pytest
from drafts import T, motion
from logs import oscillator, write

from odescope.study.options import Driven, Measured
from odescope.study.toml import parse_study, read_study


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
def test_a_column_of_dates_is_the_time(odescope, name, said):
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


def test_times_that_cannot_be_read_are_told_with_what_can(odescope):
    rows = [f"31/01/2024 08:{k // 60:02}:{k % 60:02},{x:.4f}\n" for k, x in enumerate(motion(3)[:600].tolist())]
    Path("log.csv").write_text("Time,x (mm)\n" + "".join(rows))
    assert odescope("init", "log.csv").code == 0
    (told,) = [line for line in Path("log.toml").read_text().splitlines() if line.startswith("#   Time: ")]
    assert "'31/01/2024 08:00:00'" in told
    assert "dates are read as 2024-01-31 12:00:00.5" in told


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


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,phi,phi\n0,1,2\n1,2,3\n", "log.csv has 2 columns named 'phi'; rename all but one"),
        ("t,phi\n0,1\n1\n2,3\n", "line 3 of log.csv has 1 cell where the header has 2"),
    ],
)
def test_of_a_file_that_cannot_be_read_only_that_is_said(odescope, text, said):
    Path("log.csv").write_text(text)
    assert odescope.refused("init", "log.csv") == f"odescope: {said}\n"


@pytest.mark.parametrize("order", [slice(None, None, -1), np.random.default_rng(0).permutation(len(T))])
def test_rows_in_another_order_than_that_of_the_time_are_told(odescope, order):
    write("log.csv", {"t": T[order], "x": motion(1)[order]})
    assert "'t' of log.csv seems to hold the time, and its rows are not in the order of it" in odescope.refused(
        "init", "log.csv"
    )
    write("log.csv", {"T": 20.0 + 60.0 * np.exp(-T / T[-1]), "x": motion(1)})  # a temperature that falls
    assert odescope("init", "log.csv").code == 0


def test_a_column_without_a_name_is_told_so(odescope):
    write("log.csv", {"": np.arange(len(T)), "t": T, "x": motion(1)})
    ended = odescope("init", "log.csv")
    assert "left out, see its last lines: the column without a name)" in ended.err
    assert "#   the column without a name: counts samples" in Path("log.toml").read_text()


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


def test_cells_that_are_no_numbers_are_told_where_a_column_is_left_out(odescope):
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


def test_of_several_files_all_that_have_what_the_first_has_are_looked_at(odescope):
    for name in ("a.csv", "b.csv"):
        write(name, {"t": T, "x": motion(1)})
    assert odescope("init", "a.csv", "b.csv", "--out", "both.toml").code == 0
    assert "# 3000 samples in 2 recordings" in Path("both.toml").read_text()
    write("b.csv", {"t": T, "y": motion(1)})
    write("c.csv", {"t": T, "x": np.nan * T})
    assert odescope("init", "a.csv", "b.csv", "c.csv", "--out", "other.toml").code == 0
    assert "# a.csv: 1500 samples in 1 recording" in Path("other.toml").read_text()


def test_what_experiments_were_run_at_drives_and_what_is_sampled_unevenly_is_told_so(odescope):
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


def test_a_study_never_takes_the_place_of_its_log(odescope):
    write("run.csv", {"t": T, "x": motion(1)})
    before = Path("run.csv").read_bytes()
    for out in ("run.csv", "other.csv", "study"):
        ended = odescope("init", "run.csv", "--out", out, "--force")
        assert (ended.code, "ends in .toml" in ended.err) == (2, True)
    assert Path("run.csv").read_bytes() == before
    assert sorted(p.name for p in Path().iterdir()) == ["run.csv"]


def test_milliseconds_since_1970_are_seen_to_be_such(odescope):
    write("run.csv", {"t": np.round(1.7e12 + 1000.0 * T), "x": motion(1)})
    assert odescope("init", "run.csv").code == 0
    assert parse_study(Path("run.toml").read_text()).data.time_unit == "ms"


def test_a_log_of_one_row_is_refused_in_one_line(odescope):
    Path("run.csv").write_text("t,x\n0.0,1.0\n")
    ended = odescope("init", "run.csv")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
