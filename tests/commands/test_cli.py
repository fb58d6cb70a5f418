import csv
import gzip
import json
import os
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from cli_cases import LOG, STUDY
from logs import (
    OSCILLATOR_OPTIONS,
    michaelis_menten,
    oscillator,
    pendulum,
    snapshot,
    write,
)
from pyarrow import parquet
from scipy.io import savemat

RESULTS = ["candidates.csv", "figures", "model.json", "path", "path.csv", "report.html", "report.json", "study.toml"]


def coefficients(folder, relation=0):
    """Return what model.json says: product of factor and term -> coefficient."""
    model = json.loads(Path(folder, "model.json").read_text())
    return {(t["factor"], t["term"]): t["coefficient"] for t in model["relations"][relation]["terms"]}


def is_oscillator(folder, tolerance=0.01):
    found = coefficients(folder)
    true = {("x_ddot", "1"): 1.0, (None, "x"): 4.0, (None, "x_dot"): 0.3, (None, "u"): -1.0}
    assert found.keys() == true.keys()
    assert all(abs(found[k] / true[k] - 1) < tolerance for k in true)


def test_the_equations_alone_are_on_standard_output_and_the_rest_on_standard_error(run):
    ended = run("identify", "run.csv", *OSCILLATOR_OPTIONS)
    assert ended.code == 0
    assert re.fullmatch(r"x_ddot = [-+.*\w ]+\n", ended.out)
    assert {"u", "x", "x_dot"} == set(re.findall(r"\*(\w+)", ended.out))
    assert "wrote run/" in ended.err
    assert "x_ddot =" not in ended.err
    assert sorted(os.listdir("run")) == RESULTS
    is_oscillator("run")


def test_an_input_held_between_samples(odescope):
    write("run.csv", oscillator(3000, held=True))
    assert odescope("identify", "run.csv", *OSCILLATOR_OPTIONS[:-4], "--input", "u:zero", "--order", "2").code == 0
    is_oscillator("run", 0.03)
    assert json.loads(Path("run/model.json").read_text())["inputs"] == [{"name": "u", "hold": "zero", "unit": None}]


def test_results_go_beside_the_source_under_its_name_less_its_endings(run):
    Path("deep").mkdir()
    for name in ("run.1.csv", "run.2.csv"):
        write(f"deep/{name}", LOG)
        assert run("identify", f"deep/{name}", *OSCILLATOR_OPTIONS).code == 0
    assert sorted(p.name for p in Path("deep").iterdir()) == ["run.1", "run.1.csv", "run.2", "run.2.csv"]
    assert not Path("run").exists()


def test_missing_parents_of_the_output_are_made_and_other_files_in_it_stay(run):
    assert run("identify", "run.csv", *OSCILLATOR_OPTIONS, "--out", "a/b/c").code == 0
    Path("a/b/c/notes.txt").write_text("mine")
    Path("a/b/c/model.json").write_text("old")
    assert run("identify", "run.csv", *OSCILLATOR_OPTIONS, "--out", "a/b/c").code == 0
    assert sorted(os.listdir("a/b/c")) == sorted([*RESULTS, "notes.txt"])
    assert os.listdir("a/b") == ["c"]
    is_oscillator("a/b/c")


def test_a_study_elsewhere_and_its_resolved_form_give_the_same_bytes(odescope):
    Path("data of mine/a b").mkdir(parents=True)
    Path("studies/deep").mkdir(parents=True)
    Path("third").mkdir()
    write("data of mine/a b/my run 1.csv", LOG)
    study = STUDY.replace("run.csv", "../../data of mine/a b/my run 1.csv").replace('"t"', '"t"\njitter = 0.1')
    Path("studies/deep/my study.toml").write_text(study)
    assert odescope("identify", "studies/deep/my study.toml").code == 0
    first = snapshot("studies/deep/my study")
    odescope.monkeypatch.chdir("third")
    assert odescope("identify", "../studies/deep/my study/study.toml", "--out", "again").code == 0
    for name in ("model.json", "candidates.csv"):
        assert Path("again", name).read_bytes() == first[f"studies/deep/my study/{name}"]
    assert odescope("identify", "again/study.toml", "--out", "again").code == 0  # over itself: the same bytes
    assert Path("again/model.json").read_bytes() == first["studies/deep/my study/model.json"]


def test_the_same_log_in_any_kind_of_file_gives_the_same_model(run):
    text = Path("run.csv").read_text()
    Path("semicolon.csv").write_text("\ufeff" + text.replace(",", ";").replace(".", ","), "utf-8", newline="\r\n")
    Path("tabs.tsv").write_text(text.replace(",", "\t"))
    parquet.write_table(pa.table(LOG), "table.parquet")
    savemat("variables.mat", LOG)
    Path("zipped.csv.gz").write_bytes(gzip.compress(text.encode()))
    assert run("identify", "run.csv", *OSCILLATOR_OPTIONS).code == 0
    for kind in ("semicolon.csv", "tabs.tsv", "table.parquet", "variables.mat", "zipped.csv.gz"):
        assert run("identify", kind, *OSCILLATOR_OPTIONS).code == 0
        assert Path(kind.split(".")[0], "model.json").read_bytes() == Path("run/model.json").read_bytes()


PERIOD = ("--sample-period", "0.02")


def test_a_sample_period_in_place_of_the_column_of_time(run):
    assert run("identify", "run.csv", *OSCILLATOR_OPTIONS, "--out", "timed").code == 0
    assert run("identify", "run.csv", *PERIOD, *OSCILLATOR_OPTIONS[2:], "--out", "counted").code == 0
    timed, counted = coefficients("timed"), coefficients("counted")
    assert timed.keys() == counted.keys()
    assert np.allclose([timed[k] for k in timed], [counted[k] for k in timed], rtol=1e-9, atol=0)
    rows = np.genfromtxt("run.csv", delimiter=",", names=True)
    write("untimed.csv", {name: rows[name] for name in rows.dtype.names if name != "t"})
    known, told = (run("validate", "counted/model.json", "--data", "untimed.csv", *more) for more in ((), PERIOD))
    assert (known.code, known.out) == (0, told.out)
    assert "no column called t or time" in run("validate", "timed/model.json", "--data", "untimed.csv").err


def test_recordings_in_one_file_or_in_several_are_the_same_recordings(odescope):
    starts = (0.05, 0.5, 1.2)
    runs = [michaelis_menten(s) for s in starts]
    for k, log in enumerate(runs):
        write(f"run{k}.csv", log)
    joined = {name: np.concatenate([log[name] for log in runs]) for name in ("t", "x")}
    write("all.csv", {"lap": np.repeat([7, 3, 5], len(runs[0]["t"])), **joined})
    files = ", ".join(f'"run{k}.csv"' for k in range(3))
    Path("s.toml").write_text(f'[data]\nfiles = [{files}]\ntime = "t"\n[coordinates.x]\n')
    assert odescope("identify", "s.toml").code == 0
    assert odescope("identify", "all.csv", "--time", "t", "--coordinate", "x", "--recording", "lap").code == 0
    apart, together = (json.loads(Path(f"{folder}/model.json").read_text()) for folder in ("s", "all"))
    assert together["provenance"].pop("recording") == "lap"
    assert apart == together
    found = coefficients("s")  # (0.3 + x) x' = 0.18 - 0.9 x, divided by 0.3
    true = {("x_dot", "1"): 1.0, ("x_dot", "x"): 1 / 0.3, (None, "1"): -0.6, (None, "x"): 3.0}
    assert found.keys() == true.keys()
    assert all(abs(found[k] / true[k] - 1) < 0.05 for k in true)
    again = odescope("simulate", "s/model.json", "all.csv", "--recording", "lap")
    rows = list(csv.DictReader(again.out.splitlines()))
    assert [r["lap"] for r in rows[:: len(runs[0]["t"])]] == ["7", "3", "5"]
    error = np.array([float(r["x"]) for r in rows]) - joined["x"]
    assert np.sqrt(np.mean(error**2)) < 1.2e-3  # the noise is 1e-3
    # A model that was identified from laps finds those of another log by itself.
    assert odescope("simulate", "all/model.json", "all.csv").out == again.out
    states = list(csv.DictReader(odescope("filter", "all/model.json", "all.csv").out.splitlines()))
    assert [r["lap"] for r in states[:: len(runs[0]["t"])]] == ["7", "3", "5"]
    assert odescope("validate", "all/model.json", "all.csv").code == 0
    assert "time goes back" in odescope.refused("validate", "s/model.json", "all.csv")


PENDULUM = """[data]
files = ["pend.csv"]
time = "Time (s)"
[coordinates.theta]
column = "Winkel [rad]"
order = 2
angle = true
unit = "rad"
[inputs.u]
column = "F;N"
unit = "N"
"""


def test_wrapped_angles_gaps_units_and_columns_of_any_name(odescope):
    log = pendulum()
    assert (np.abs(np.diff(log["Winkel [rad]"])) > 3).sum() > 5  # it does wrap
    log["Winkel [rad]"][700:720] = np.nan
    kept = np.r_[0:1300, 1310:2000]
    log = {name: column[kept] for name, column in log.items()}
    write("pend.csv", log)
    Path("s.toml").write_text(PENDULUM.replace("[data]", '[data]\ngaps = "refuse"'))
    message = odescope.refused("identify", "s.toml")
    for part in ("'Winkel [rad]' has 1 gap (data rows 701-720)", "after data row 1300", "gaps = 'bridge'"):
        assert part in message
    Path("s.toml").write_text(PENDULUM)
    ended = odescope("identify", "s.toml")
    assert ended.code == 0
    assert "30 samples of theta, of 2000, are missing (1.50 %), in 2 gaps" in ended.err
    found = coefficients("s")
    true = {("theta_ddot", "1"): 1.0, (None, "sin(theta)"): 9.81, (None, "theta_dot"): 0.2, (None, "u"): -1.0}
    assert found.keys() == true.keys()
    assert all(abs(found[k] / true[k] - 1) < 0.03 for k in true)
    model = json.loads(Path("s/model.json").read_text())
    assert model["coordinates"] == [{"name": "theta", "order": 2, "angle": True, "cyclic": False, "unit": "rad"}]
    assert model["inputs"] == [{"name": "u", "hold": "linear", "unit": "N"}]
    assert model["provenance"]["columns"] == {"theta": "Winkel [rad]", "u": "F;N"}
    assert model["provenance"]["recordings"] == 1
    Path("s.toml").write_text(PENDULUM.replace("[data]", '[data]\ngaps = "split"'))
    assert odescope("identify", "s.toml").code == 0
    assert json.loads(Path("s/model.json").read_text())["provenance"]["recordings"] == 3


def cells(column, rows, value):
    def change(log):
        log[column] = log[column].astype(object)
        log[column][list(rows)] = value
        return log

    return change


def less(*rows):
    return lambda log: {name: np.delete(c, rows) for name, c in log.items()}


def replaced(**columns):
    return lambda log: {**log, **{name: make(log) for name, make in columns.items()}}


BAD_DATA = {
    "not numbers": (cells("x", [4, 7], "abc"), ["column 'x'", "line 6: \"'abc'\"", "line 9", "not numbers"]),
    "empty column": (replaced(x=lambda g: np.nan * g["x"]), ["0 of 1500 cells of 'x' hold numbers", "run.csv"]),
    "time goes back": (
        replaced(t=lambda g: g["t"] % 20.0),
        ["time goes back at data row 1001 (19.98, then", "recording"],
    ),
    "time repeats": (replaced(t=lambda g: np.floor(np.sqrt(g["t"]))), ["time repeats at data row 2", "sample_period"]),
    "time stands still": (replaced(t=lambda g: 0 * g["t"] + 5), ["time is 5 in every row in run.csv", "sample_period"]),
    "fewer samples than candidates": (
        less(*range(30, 1500)),
        ["samples cannot decide between 42 candidate terms for x_ddot"],
    ),
    "one sample": (less(*range(1, 1500)), ["1 of 1 cells of 'x'", "run.csv"]),
    "no sample": (less(*range(1500)), ["run.csv holds column names but no rows"]),
    "constant coordinate": (replaced(x=lambda g: 0 * g["x"] + 3.7), ["coordinate 'x' is constant"]),
    "constant input": (replaced(u=lambda g: 0 * g["u"]), ["input 'u' is constant"]),
    "infinite": (cells("x", [5], np.inf), ["'x' is not a finite number in data row 6"]),
    "huge": (replaced(x=lambda g: 1e40 * g["x"]), ["'x' has values as large as", "larger unit"]),
    "no such column": (lambda g: {"t": g["t"], "xx": g["x"], "u": g["u"]}, ["no column 'x'", "did you mean 'xx'?"]),
    "no column near": (lambda g: {"t": g["t"], "pos": g["x"], "u": g["u"]}, ["no column 'x'", "there are: t, pos, u"]),
}


@pytest.mark.parametrize("case", BAD_DATA)
def test_bad_data_end_with_one_line_and_no_folder(odescope, case):
    change, parts = BAD_DATA[case]
    write("run.csv", change({name: c.copy() for name, c in LOG.items()}))
    message = odescope.refused("identify", "run.csv", *OSCILLATOR_OPTIONS, "--out", "new/results")
    for part in parts:
        assert part in message


def test_an_angle_in_degrees_is_told_by_its_jumps(odescope):
    log = pendulum()
    write("pend.csv", {**log, "Winkel [rad]": np.rad2deg(log["Winkel [rad]"])})
    Path("s.toml").write_text(PENDULUM)
    message = odescope.refused("identify", "s.toml")
    assert "angle 'theta' jumps by about 360" in message
    assert "degrees" in message
    assert 'unit = "deg" in [coordinates.theta]' in message
    assert "pi/180" in message


@pytest.mark.parametrize(
    ("name", "content", "parts"),
    [
        ("gone.csv", None, ["no such file: gone.csv"]),
        ("empty.csv", "", ["empty.csv is empty"]),
        ("log.xlsx", "t,x,u\n1,2,3\n", ["log.xlsx is of no known kind", ".csv", ".parquet", ".mat"]),
        ("log.parquet", "t,x,u\n1,2,3\n", ["log.parquet cannot be read"]),
        ("log.mat", "t,x,u\n1,2,3\n", ["log.mat cannot be read as a MATLAB file"]),
        ("log.csv.gz", "t,x,u\n1,2,3\n", ["log.csv.gz cannot be read"]),
        ("units.csv", "t,x,u\ns,m,N\n0,1,2\n", ["line 2: 's'", "delete that line"]),
        ("bare.csv", "0.0,1.0,2.0\n0.1,2.0,3.0\n", ["no column 't' in bare.csv", "holds numbers"]),
        ("ragged.csv", "t,x,u\n0,1,2\n1,2\n", ["line 3 of ragged.csv has 2 cells where the header has 3"]),
        ("twice.csv", "t,x,x,u\n0,1,1,2\n", ["2 columns named 'x'"]),
    ],
)
def test_bad_files(odescope, name, content, parts):
    if content is not None:
        Path(name).write_text(content)
    message = odescope.refused("identify", name, *OSCILLATOR_OPTIONS)
    for part in parts:
        assert part in message


@pytest.mark.parametrize("source", ["/", "..", "a" * 300 + ".csv", "a" * 300 + ".toml"])
def test_a_source_that_is_no_file_is_an_error_and_no_traceback(run, source):
    assert "odescope: " in run.refused("identify", source, *(() if source.endswith("toml") else OSCILLATOR_OPTIONS))


def test_data_that_support_no_model_end_with_3_and_the_stage(odescope):
    noise = np.random.default_rng(0).standard_normal(1500)
    write("run.csv", {**LOG, "x": noise})
    message = odescope.refused("identify", "run.csv", *OSCILLATOR_OPTIONS, code=3)
    assert "no model: the signals stage came out empty" in message
    write("run.csv", LOG)
    Path("s.toml").write_text(STUDY + "[selection]\nterms = 1\n[likelihood]\nenabled = false\n")
    ended = odescope("identify", "s.toml")
    assert (ended.code, ended.out) == (3, "")
    advice, wrote, message = ended.err.splitlines()
    assert advice.startswith("advice: below the cutoff")
    assert wrote == "wrote s/: no_model.html"
    assert message.startswith("odescope: no model: the selection stage came out empty")
    assert "with more than 1 terms" in message
    assert os.listdir("s") == ["no_model.html"]
