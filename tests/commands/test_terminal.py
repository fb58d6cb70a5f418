"""What a run tells, as it is shown on a terminal; and what a shell completes."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from found_models import cart, enzyme
from logs import OSCILLATOR_OPTIONS, oscillator, write

from odescope.commands import cli
from odescope.commands.terminal import found, remark, shown
from odescope.errors import NoModelError
from odescope.events import FilesWritten, Note, Progress, StageBegan, span, standing
from odescope.pipeline.identification import EquationsReady, NothingFound

ROOT = Path(cli.__file__).parents[2]


@pytest.mark.parametrize(
    ("event", "line"),
    [
        (StageBegan("signals"), "signals"),
        (Progress("recordings", "chunk", 3, 20), "recordings: 3 of 20 chunks"),
        (Progress("recordings", "chunk", 3, 20, 75.4), "recordings: 3 of 20 chunks, 1 min 15 s left"),
        (Progress("likelihood", "search", 1, 2, 0.2), "likelihood: 1 of 2 searches, 0 s left"),
        (Progress("likelihood", "search with process noise", 0, 1), "likelihood: search with process noise"),
        (Note("something"), ""),
    ],
)
def test_where_a_run_stands_is_one_line(event, line):
    assert standing(event) == line


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(-1.0, "0 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (3599.6, "1 h 0 min"), (90_061.0, "25 h 1 min")],
)
def test_a_span_is_said_in_its_two_largest_units(seconds, text):
    assert span(seconds) == text


@pytest.mark.parametrize(
    ("model", "heading", "first", "last"),
    [
        (cart(), "equations of motion", "kinetic energy T", "  0.055*phi_ddot + 0.18*x_ddot*cos(phi) = -1.8*sin(phi)"),
        (enzyme(), "rates of change", "reactions", "  C_dot = -0.4*C + 0.98*E*S"),
    ],
)
def test_mechanisms_stand_before_the_equations(model, heading, first, last):
    lines = found(EquationsReady(SimpleNamespace(model=model))).splitlines()
    assert (lines[0], lines[-1]) == (first, last)
    assert lines[-1 - len(model.targets)] == heading
    assert any(" +- " in line for line in lines[: lines.index(heading)])


def test_a_model_without_mechanisms_is_its_equations_alone():
    model = replace(cart(), mechanisms=())
    lines = found(EquationsReady(SimpleNamespace(model=model))).splitlines()
    assert [line.partition(" = ")[0] for line in lines] == ["x_ddot", "phi_ddot"]


def test_what_stays_is_on_standard_error_alone(capsys):
    with shown() as tell:
        for event in (
            StageBegan("signals"),
            Note("a gap was bridged"),
            Note("mind the gap", warns=True),
            FilesWritten(Path("out"), ("model.json", "figures/")),
        ):
            tell(event)
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "note: a gap was bridged\nwarning: mind the gap\nwrote out/: model.json, figures/\n"
    assert remark(StageBegan("signals")) == ""


def test_advice_that_has_been_a_warning_is_not_said_again(capsys):
    with shown() as tell:
        tell(Note("give order = 2", warns=True))
        tell(NothingFound(NoModelError("selection", "none"), None, ("give order = 2", "record longer")))
    assert capsys.readouterr().err == "warning: give order = 2\nadvice: record longer\n"


def read_all(terminal):
    parts = []
    try:
        while part := os.read(terminal, 4096):
            parts.append(part)
    except OSError:  # Linux says so when the other end is closed
        pass
    return b"".join(parts)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_on_a_terminal_the_equations_alone_go_to_standard_output(tmp_path):
    """The line that says where a run stands must not take standard output for the terminal."""
    import pty

    write(tmp_path / "run.csv", oscillator())
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "odescope", "identify", "run.csv", *OSCILLATOR_OPTIONS]
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment(TERM="xterm"), stdout=subprocess.PIPE, stderr=theirs
    ) as child:
        os.close(theirs)
        shown = read_all(ours)
        out = child.stdout.read().decode()
    os.close(ours)
    assert child.returncode == 0
    assert out.startswith("x_ddot = ")
    assert out.count("\n") == 1
    assert b"likelihood" in shown
    assert b"x_ddot = " not in shown
    assert b"wrote run/: model.json" in shown


# completion


def environment(**more):
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, **more}


def odescope(*arguments, **more):
    code = "import sys; sys.argv[0] = 'odescope'; from odescope.commands.cli import entry; entry()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment(**more), capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_shown_and_completes_commands_and_options(shell):
    done = odescope("--show-completion", shell, _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    assert (done.returncode, done.stderr) == (0, "")
    assert "_ODESCOPE_COMPLETE=" in done.stdout.replace(" ", "")
    words = {"COMP_WORDS": "odescope id", "COMP_CWORD": "1", "_TYPER_COMPLETE_ARGS": "odescope id"}
    asked = odescope(_ODESCOPE_COMPLETE=f"complete_{shell}", _TYPER_COMPLETE_FISH_ACTION="get-args", **words)
    assert "identify" in asked.stdout
    assert "simulate" not in asked.stdout


def test_completion_is_installed_for_a_shell(tmp_path):
    done = odescope(
        "--install-completion", "bash", HOME=str(tmp_path), _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1"
    )
    assert done.returncode == 0, done.stderr
    assert "_ODESCOPE_COMPLETE" in (tmp_path / ".bash_completions/odescope.sh").read_text()
    assert "odescope.sh" in (tmp_path / ".bashrc").read_text()
