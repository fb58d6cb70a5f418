"""Several files on a command line, their columns by either spelling, and the options of their study."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from logs import OSCILLATOR_OPTIONS, oscillator, pendulum, write

from odescope.commands.arguments import DataArguments, resolve, results_folder, study_of
from odescope.errors import InputError
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study
from odescope.study.toml import read_study

HEADED = ("--time", "time", "--coordinate", "x", "--input", "u", "--order", "2")


@pytest.fixture
def logs(odescope):
    for k in (1, 2):
        log = oscillator(800, seed=k)
        write(f"run{k}.csv", log)
    return odescope


def is_oscillator(folder, tolerance=0.01):
    model = json.loads(Path(folder, "model.json").read_text())
    found = {(t["factor"], t["term"]): t["coefficient"] for t in model["relations"][0]["terms"]}
    true = {("x_ddot", "1"): 1.0, (None, "x"): 4.0, (None, "x_dot"): 0.3, (None, "u"): -1.0}
    assert found.keys() == true.keys()
    assert all(abs(found[k] / true[k] - 1) < tolerance for k in true)
    return model


@pytest.mark.parametrize(
    ("sources", "folder"),
    [
        (("run1.csv", "run2.csv"), "run1-and-1-more"),
        (("run*.csv",), "run"),
        (("logs",), "logs-results"),
    ],
)
def test_several_files_patterns_and_folders_are_one_study(logs, sources, folder):
    Path("logs").mkdir()
    for name in ("run1.csv", "run2.csv"):
        Path("logs", name).write_text(Path(name).read_text())
    ended = logs("identify", *sources, *OSCILLATOR_OPTIONS, "--basis", "x,x_dot, u", "--degree", "2")
    assert ended.code == 0, ended.err
    model = is_oscillator(folder)
    assert model["provenance"]["recordings"] == 2
    study = read_study(Path(folder, "study.toml"))
    assert (study.library.basis, study.library.degree) == (("x", "x_dot", "u"), 2)
    assert {Path(f).name for f in study.data.files} == {Path(s).name for s in sources}


def test_units_in_headings_are_found_by_either_spelling_and_told(odescope):
    log = oscillator(1000)
    write("run.csv", {"time (ms)": 1000.0 * log["t"], "x (m)": log["x"], "u [V]": log["u"]})
    spelled = ("--time", "time (ms)", "--coordinate", "x (m)", "--input", "u [V]", "--order", "2")
    for options in (HEADED, spelled):
        ended = odescope("identify", "run.csv", *options, "--basis", "x,x_dot,u", "--out", "out")
        assert ended.code == 0, ended.err
        assert "note: time was recorded in ms: in files and notes it is in seconds" in ended.err
        model = is_oscillator("out")
        assert model["coordinates"][0]["unit"] == "m"
        assert model["inputs"][0]["unit"] == "V"
        assert model["provenance"]["time_unit"] == "ms"
    ended = odescope("simulate", "out/model.json", "run.csv", "--out", "run_out.csv")
    assert ended.code == 0, ended.err
    rows = Path("run_out.csv").read_text().splitlines()
    assert rows[0] == "time (ms),x,x_dot"
    assert [row.split(",")[0] for row in rows[1:4]] == ["0.0", "20.0", "40.0"]
    ended = odescope("filter", "out/model.json", "run.csv", "--out", "states.csv")
    assert Path("states.csv").read_text().splitlines()[3].startswith("40.0,")
    # Another file with plain headings, in seconds: the model finds its columns there, too.
    write("plain.csv", {"time": log["t"], "x": log["x"], "u": log["u"]})
    ended = odescope("validate", "out/model.json", "plain.csv")
    assert ended.code == 0, ended.err
    assert "free run" in ended.out


@pytest.mark.slow
def test_an_angle_headed_in_degrees_is_taken_for_one(odescope):
    import numpy as np

    log = pendulum(1200)
    degrees = np.rad2deg(log["Winkel [rad]"])
    write("run.csv", {"Time (s)": log["Time (s)"], "phi [deg]": degrees, "F": log["F;N"]})
    options = ("--time", "Time", "--coordinate", "phi:angle", "--input", "F", "--order", "2")
    ended = odescope("identify", "run.csv", *options, "--basis", "sin(phi),phi_dot,F", "--degree", "1")
    assert ended.code == 0, ended.err
    assert "note: phi was recorded in degrees: here it is in radians" in ended.err
    model = json.loads(Path("run/model.json").read_text())
    found = {t["term"]: -t["coefficient"] for t in model["relations"][0]["terms"] if t["factor"] is None}
    assert found == pytest.approx({"sin(phi)": -9.81, "phi_dot": -0.2, "F": 1.0}, rel=0.01)


def test_arguments_make_the_study_that_they_say(logs):
    os.rename("run2.csv", "other.csv")
    given = DataArguments(
        time="t",
        coordinates=("x:cyclic",),
        inputs=("u:zero",),
        gaps="split",
        delays=("u=0.02",),
        basis=("x_dot", "u, abs(x_dot)"),
        degree=2,
        time_unit="min",
    )
    study = study_of([Path("run1.csv"), Path("other.csv")], given)
    assert study.data.time_unit == "min"
    assert study.data.files == ("run1.csv", "other.csv")
    assert study.data.gaps == "split"
    assert study.coordinates == {"x": Measured(cyclic=True)}
    assert study.inputs == {"u": Driven(hold="zero", delay=0.02)}
    assert study.library == Candidates(basis=("x_dot", "u", "abs(x_dot)"), degree=2)


def test_the_unit_of_the_time_is_one_of_those_of_studies_and_goes_with_a_column(odescope):
    log = oscillator(1000)
    write("run.csv", {"t_min": log["t"] / 60.0, "x": log["x"], "u": log["u"]})
    options = ("--coordinate", "x", "--input", "u", "--order", "2", "--basis", "x,x_dot,u", "--degree", "1")
    ended = odescope("identify", "run.csv", "--time", "t_min", "--time-unit", "min", *options)
    assert ended.code == 0, ended.err
    assert "note: time was recorded in min: in files and notes it is in seconds" in ended.err
    assert "taken for no unit of time" not in ended.err
    assert is_oscillator("run")["provenance"]["time_unit"] == "min"
    ended = odescope("identify", "run.csv", "--time", "t_min", "--time-unit", "minutes", *options)
    assert ended.code == 2
    assert "time_unit must be one of 's', 'ms', " in ended.err
    ended = odescope("identify", "run.csv", "--sample-period", "0.02", "--time-unit", "min", *options)
    assert ended.code == 2
    assert "time_unit = 'min' goes with time, the column that holds the time" in ended.err


def test_a_degree_without_a_basis_is_that_of_the_default_library(logs):
    assert study_of([Path("run1.csv")], DataArguments(time="t", coordinates=("x",), degree=2)).library == Candidates(
        degree=2
    )


def test_a_basis_may_name_the_time(tmp_path):
    run = tmp_path / "run.csv"
    run.write_text("t,x,u\n0.0,1.0,0.0\n")
    given = DataArguments(time="t", coordinates=("x",), inputs=("u",), basis=("x,sin(1.3*t)",))
    assert study_of([run], given).library.basis == ("x", "sin(1.3*t)")
    with pytest.raises(InputError, match="names the time, t: name the column that holds it"):
        study_of([run], replace(given, time=None, sample_period=0.01))


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (("--gaps", "jump"), "--gaps jump: expected one of bridge, split, refuse"),
        (("--delay", "x=0.1"), "--delay x=0.1: 'x' is no --input; there are: u"),
        (("--delay", "u"), "--delay u: expected INPUT=SECONDS, such as u=0.02"),
        (("--delay", "u=soon"), "expected INPUT=SECONDS, such as u=0.02, or u=estimate"),
        (("--delay", "u=inf"), 'delay must be a number of seconds, "auto" or "estimate", got inf'),
        (("--basis", "x", "--degree", "13"), "--degree 13: expected a whole number from 1 to 12"),
        (("--basis", "x,sin(x"), "cannot read the term 'sin(x'"),
    ],
)
def test_options_that_cannot_be(logs, options, part):
    assert part in logs.refused("identify", "run1.csv", *OSCILLATOR_OPTIONS, *options)


def test_headings_that_cannot_be_told_apart(odescope):
    log = oscillator(300)
    write("run.csv", {"time": log["t"], "x (m)": log["x"], "x (mm)": 1000.0 * log["x"], "u": log["u"]})
    assert "'x' may be 'x (m)' or 'x (mm)' in run.csv" in odescope.refused("identify", "run.csv", *HEADED)
    both = ("--coordinate", "x (m)", "--coordinate", "x (mm)")
    assert "--coordinate x is given twice" in odescope.refused("identify", "run.csv", "--time", "time", *both)


def test_a_study_is_identified_alone(logs):
    Path("s.toml").write_text('[data]\nfiles = ["run1.csv"]\ntime = "t"\n[coordinates.x]\n')
    message = logs.refused("identify", "s.toml", "run1.csv")
    assert "s.toml is a study: it is identified alone" in message
    with pytest.raises(InputError, match="it is identified alone"):
        resolve([Path("run1.csv"), Path("s.toml")], DataArguments())


@pytest.mark.parametrize(
    ("sources", "folder"),
    [
        (["deep/run.1.csv"], "deep/run.1"),
        (["run.csv.gz"], "run"),
        (["a/b.csv", "c.csv", "d.csv"], "a/b-and-2-more"),
        (["logs/"], "logs-results"),
        (["run*.csv"], "run"),
        (["*.csv"], "results"),
    ],
)
def test_where_results_go(tmp_path, monkeypatch, sources, folder):
    monkeypatch.chdir(tmp_path)
    Path("logs").mkdir()
    study = Study(data=Data(files=tuple(sources), time="t"), coordinates={"x": Measured()})
    assert results_folder([Path(s) for s in sources], study, Path()) == Path(folder)


@pytest.mark.parametrize(
    ("source", "files", "folder"),
    [
        ("logs.toml", "logs", "logs-results"),
        ("logs.toml", "logs/*.csv", "logs-results"),
        ("logs.toml", "logs/run?.csv", "logs"),
        ("logs.toml", "logs/p*", "logs-results"),  # path.csv
        ("study.toml", "logs", "study"),
        ("logs/study.toml", "logs", "logs/study"),  # the files of a folder within one of data are none of it
    ],
)
def test_results_of_a_study_do_not_become_its_data(tmp_path, monkeypatch, source, files, folder):
    monkeypatch.chdir(tmp_path)
    Path("logs").mkdir()
    study = Study(data=Data(files=(files,), time="t"), coordinates={"x": Measured()})
    assert results_folder([Path(source)], study, Path()) == Path(folder)
