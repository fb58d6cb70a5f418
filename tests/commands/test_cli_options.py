"""The command line: bad options, where results may go, simulate and export, and as a process."""

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_cases import LOG, STUDY
from logs import (
    OSCILLATOR_OPTIONS,
    oscillator,
    snapshot,
    write,
)

from odescope.study.toml import read_study


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ((), ["--coordinate NAME", "its columns are: t, x, u"]),
        (("--time", "t"), ["--coordinate NAME"]),
        (("--coordinate", "x"), ["--time NAME", "--sample-period SECONDS"]),
        (("--time", "t", "--sample-period", "0.02", "--coordinate", "x"), ["exactly one of time", "sample_period"]),
        (("--sample-period", "-1", "--coordinate", "x"), ["sample_period must be a positive number, got -1.0"]),
        (("--sample-period", "nan", "--coordinate", "x"), ["sample_period must be a positive number"]),
        (("--time", "t", "--coordinate", "x", "--coordinate", "x:angle"), ["--coordinate x is given twice"]),
        (("--time", "t", "--coordinate", "x", "--input", "u", "--input", "u:zero"), ["--input u is given twice"]),
        (("--time", "t", "--coordinate", "x", "--input", "x"), ["the name 'x' is used twice"]),
        (("--time", "t", "--coordinate", "x:angel"), ["cyclic, angle or order=N", "'angel' came"]),
        (("--time", "t", "--coordinate", "x:order=-1"), ["'order=-1' came"]),
        (("--time", "t", "--coordinate", "x", "--input", "u:zoh"), ["auto, linear, zero, band-limited", "'zoh' came"]),
        (("--time", "t", "--coordinate", "x", "--order", "0"), ["order must be a whole number from 1 to 8, got 0"]),
        (("--time", "t", "--coordinate", "x:order=9"), ["order must be a whole number from 1 to 8, got 9"]),
        (("--time", "t", "--coordinate", "t"), ["'t'", "which is the time"]),
        (("--time", "t", "--coordinate", "x pos"), ["'x pos' is not a plain name", "column = 'x pos'"]),
        (("--time", "t", "--coordinate", "x", "--input", "F (N)"), ["'F (N)' is not a plain name", "column = 'F (N)'"]),
        (("--time", "t", "--coordinate", "__import__('os')"), ["is not a plain name"]),
        (("--time", "t", "--coordinate", "lambda"), ["'lambda' is not a plain name"]),
        (("--time", "t", "--coordinate", "größe"), ["'größe' is not a plain name"]),
        (("--time", "t", "--coordinate", "sin"), ["'sin' is the name of a function"]),
        (("--time", "t", "--coordinate", "x", "--recording", "lap"), ["no column 'lap'", "there are: t, x, u"]),
    ],
)
def test_bad_options(run, options, parts):
    message = run.refused("identify", "run.csv", *options)
    for part in parts:
        assert part in message


def test_a_heading_that_is_nearly_one_is_named(odescope):
    write("units.csv", {"t": LOG["t"], "speed [rad/s]": LOG["x"], "voltage [V]": LOG["u"]})
    said = odescope.refused("identify", "units.csv", "--time", "t", "--coordinate", "sped [rad/s]")
    assert "there is no column 'sped [rad/s]'; did you mean 'speed [rad/s]'?" in said
    write("units.csv", {"time (ms)": 1e3 * LOG["t"], "U C (V)": LOG["x"], "U in (V)": LOG["u"]})
    given = ("--time", "time", "--coordinate", "U C:order=2", "--input", "U in")
    assert odescope("identify", "units.csv", *given, "--out", "found").code == 0
    found = json.loads(Path("found/model.json").read_text())
    assert (found["targets"], found["inputs"][0]["name"]) == (["U_C_ddot"], "U_in")
    assert found["provenance"]["columns"] == {"U_C": "U C (V)", "U_in": "U in (V)"}


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (("identify",), "Missing argument"),
        (("identify", "run.csv", "--tme", "t"), "No such option"),
        (("identify", "run.csv", "--order", "two"), "--order"),
        (("identfy", "run.csv"), "identify"),
        (("simulate", "model.json"), "Missing argument"),
        (("demo", "--level", "9"), "--level"),
        (("demo", "--seed", "-1"), "--seed"),
    ],
)
def test_a_wrong_command_line_ends_with_2_and_no_traceback(run, arguments, part):
    before = snapshot()
    ended = run(*arguments)
    assert (ended.code, ended.out) == (2, "")
    assert part in ended.err
    assert "Traceback" not in ended.err
    assert snapshot() == before


def test_help_tells_the_defaults(run):
    ended = run("identify", "--help")
    assert (ended.code, ended.err) == (0, "")
    plain = re.sub(r"[\s│]+", " ", ended.out)
    assert "the source's name, beside it" in plain


def test_data_options_do_not_go_with_a_study(run):
    Path("s.toml").write_text(STUDY)
    for option in (("--time", "t"), ("--order", "2"), ("--coordinate", "x")):
        assert "only --out" in run.refused("identify", "s.toml", *option)


def test_the_clock_of_a_run_goes_with_a_study_and_is_kept_in_it(run):
    Path("s.toml").write_text(STUDY)
    assert "--seconds -1.0: expected a positive number" in run.refused("identify", "s.toml", "--seconds", "-1")
    assert run("identify", "s.toml", "--seconds", "1000").code == 0
    assert read_study(Path("s", "study.toml")).likelihood.seconds == 1000.0


@pytest.mark.parametrize(
    ("library", "part"),
    [
        ("form = 'relations'\nkinetic = ['x_dot**2']", 'kinetic belongs to form = "lagrangian"'),
        ("form = 'reactions'", "needs [library] reactions"),
        ("form = 'reactions'\nreactions = ['-> x']", "order"),
        ("form = 'hamiltonian'", "unknown value 'hamiltonian' at `library.form`"),
        ("form = 'lagrangian'\npotential = ['x_dot']", "a potential is a function of positions"),
        ("ties = ['x = y']", "'y'"),
    ],
)
def test_a_form_that_cannot_be_ends_with_2(run, library, part):
    Path("form.toml").write_text(STUDY + f"[library]\n{library}\n")
    assert part in run.refused("identify", "form.toml")


def test_an_output_folder_that_cannot_be_written(run):
    Path("f").write_text("keep")
    Path("g/study.toml").mkdir(parents=True)
    for out, part in (
        ("f", "f is not a folder"),
        ("f/sub", "f is not a folder"),
        ("g", "its study.toml is a folder"),
        ("b" * 300, "File name too long"),
    ):
        message = run.refused("identify", "run.csv", *OSCILLATOR_OPTIONS, "--out", out)
        assert f"cannot write to {out}" in message
        assert part in message
        assert "cannot write to" in run.refused("demo", "--out", out)


def test_a_folder_without_permission_is_found_before_anything_is_computed(run):
    def denied(**_):
        raise PermissionError(13, "Permission denied")

    run.monkeypatch.setattr("odescope.commands.files.tempfile.TemporaryFile", denied)
    run.monkeypatch.setattr("odescope.commands.run.identify", None)  # never reached
    for command in (("identify", "run.csv", *OSCILLATOR_OPTIONS, "--out", "new"), ("demo", "--out", "new")):
        assert "cannot write to new: Permission denied" in run.refused(*command)


def test_a_full_disk_leaves_the_old_results(run):
    assert run("identify", "run.csv", *OSCILLATOR_OPTIONS).code == 0
    original = Path.write_text

    def full(path, text, **options):
        if path.name == "report.html":
            original(path, text[:100], **options)
            raise OSError(28, "No space left on device")
        return original(path, text, **options)

    write("run.csv", oscillator(seed=5))
    run.monkeypatch.setattr(Path, "write_text", full)
    before = snapshot()
    for out in ("run", "other"):
        ended = run("identify", "run.csv", *OSCILLATOR_OPTIONS, "--out", out)
        assert ended.code == 2
        assert ended.out.startswith("x_ddot = ")  # what was found is said, though it cannot be kept
        assert ended.err.endswith(f"odescope: cannot write to {out}: No space left on device\n")
        assert snapshot() == before


def test_nothing_is_written_over_what_it_is_made_from(run):
    Path("study.toml").write_text(STUDY + "# a comment of mine\n")
    assert "would overwrite study.toml" in run.refused("identify", "study.toml", "--out", ".")
    write("candidates.csv", LOG)
    message = run.refused("identify", "candidates.csv", *OSCILLATOR_OPTIONS, "--out", ".")
    assert "would overwrite candidates.csv" in message
    assert run("identify", "run.csv", *OSCILLATOR_OPTIONS).code == 0
    model = "run/model.json"
    assert "would overwrite run.csv" in run.refused("simulate", model, "run.csv", "--out", "./run.csv")
    assert "would overwrite" in run.refused("simulate", model, "run.csv", "--out", model)
    assert "would overwrite" in run.refused("export", model, "--out", "run/../run/model.json")


def test_control_c_says_so_and_leaves_nothing(run):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    run.monkeypatch.setattr("odescope.commands.run.identify", stopped)
    assert "stopped" in run.refused("identify", "run.csv", *OSCILLATOR_OPTIONS, "--out", "new", code=130)


def test_an_error_of_the_system_is_a_message(run):
    def lost(*_, **__):
        raise OSError(5, "Input/output error", "run.csv")

    run.monkeypatch.setattr("odescope.commands.run.identify", lost)
    assert "Input/output error: run.csv" in run.refused("identify", "run.csv", *OSCILLATOR_OPTIONS)


def test_simulate_and_export_write_to_a_file_what_they_else_print(run):
    assert run("identify", "run.csv", *OSCILLATOR_OPTIONS).code == 0
    for command in (("simulate", "run/model.json", "run.csv"), ("export", "run/model.json", "--to", "python")):
        printed = run(*command)
        assert printed.code == 0
        stored = run(*command, "--out", "new/deep/file")
        told = "wrote new/deep/file\n" if command[0] == "export" else ""
        assert (stored.code, stored.err) == (0, told)
        # What there is to say of a free run goes wherever the table does not.
        assert printed.err == (stored.out if command[0] == "simulate" else "")
        assert stored.out.startswith("x: fit 99.") if command[0] == "simulate" else stored.out == ""
        assert Path("new/deep/file").read_text() == printed.out
        assert os.listdir("new/deep") == ["file"]
        assert "it is a folder" in run.refused(*command, "--out", "new")
        assert "run.csv is not a folder" in run.refused(*command, "--out", "run.csv/file")
    rows = list(csv.reader(run("simulate", "run/model.json", "run.csv").out.splitlines()))
    assert rows[0] == ["t", "x", "x_dot"]
    simulated = np.array(rows[1:], dtype=float)
    assert np.allclose(simulated[:, 0], LOG["t"], rtol=0, atol=1e-9)
    assert np.std(simulated[:, 1] - LOG["x"]) < 3e-3  # noise 1e-3, over 30 s of free run


def test_export_text_and_latex(run):
    assert run("identify", "run.csv", *OSCILLATOR_OPTIONS).code == 0
    explicit = json.loads(Path("run/model.json").read_text())["explicit"]
    equation, *errors = run("export", "run/model.json").out.splitlines()
    assert equation == f"x_ddot = {explicit['x_ddot']}"
    assert [line.split()[:3] for line in errors] == [["#", "x_ddot", term] for term in ("x", "x_dot", "u")]
    assert all(" +- " in line for line in errors)
    assert run("export", "run/model.json", "--to", "latex").out.startswith(r"\ddot{x} = ")
    assert run("export", "run").out == run("export", "run/model.json").out
    assert "latex, mathml, " in run.refused("export", "run/model.json", "--to", "pythn")
    for name, part in (("gone.json", "No such file"), (".", "No such file"), ("run.csv", "not a model")):
        assert part in run.refused("export", name)
        assert part in run.refused("simulate", name, "run.csv")


def process(*arguments, **options):
    command = [sys.executable, "-m", "odescope", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def test_a_reader_that_has_seen_enough_is_no_error(run):
    assert run("identify", "run.csv", *OSCILLATOR_OPTIONS).code == 0
    with process("simulate", "run/model.json", "run.csv") as child:
        child.stdout.close()  # the CSV is larger than a pipe holds
        told = child.stderr.read()
        assert told.startswith("x: fit 99.")
        assert told.count("\n") == 1
        assert child.wait() == 0


def test_the_module_runs_as_a_process(run):
    with process("identify", "run.csv", "--time", "t", "--coordinate", "y") as child:
        out, err = child.communicate()
    assert (child.returncode, out) == (2, "")
    assert err == "odescope: no column 'y' in run.csv; there are: t, x, u\n"
