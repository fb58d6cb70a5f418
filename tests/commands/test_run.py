"""A run of a study, from its options to the files of its results, as the command line and others call it."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from logs import blank_painters, oscillator, snapshot, write
from msgspec import structs

from odescope.commands import run as module
from odescope.commands.demo import run_demo
from odescope.commands.run import Reference, draw_again, results_at, run_study
from odescope.errors import InputError, NoModelError, Stopped
from odescope.events import Event, FilesWritten, Monitor, Note, Progress, StageBegan
from odescope.export.model_file import read_model
from odescope.likelihood.search import LikelihoodSearch
from odescope.pipeline.identification import DraftReady, EquationsReady
from odescope.report.assemble import observed
from odescope.selection.ranking import Ranking
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study
from odescope.study.toml import parse_study, read_study

STUDY = Study(
    data=Data(files=("logs/run.csv",), time="t"),
    coordinates={"x": Measured(order=2)},
    inputs={"u": Driven()},
    library=Candidates(terms=("1", "x", "x_dot", "u", "x_ddot")),
)
TERMS = {"x", "x_dot", "u", "x_ddot"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "painters", blank_painters)
    (tmp_path / "logs").mkdir()
    write(tmp_path / "logs/run.csv", oscillator())
    return tmp_path


def terms(model):
    return {t.text for t in model.relations[0].terms}


def test_a_run_tells_its_events_and_leaves_its_files(folder):
    events = list[Event]()
    run = run_study(STUDY, folder, folder / "out", monitor=Monitor(events.append))
    assert terms(run.result.model) == TERMS
    assert read_model(folder / "out/model.json").relations == run.result.model.relations
    kinds = [type(e) for e in events if not isinstance(e, Note)]
    assert kinds.index(DraftReady) < kinds.index(EquationsReady) < kinds.index(FilesWritten) == len(kinds) - 1
    assert events[-1].folder == folder / "out"
    assert {n.rstrip("/") for n in events[-1].names} == set(os.listdir(folder / "out"))
    assert [e.stage for e in events if isinstance(e, StageBegan)][-1] == "report"


def test_the_study_that_a_report_prints_runs_where_it_says(folder, monkeypatch):
    """Saved beside the data it reads them, wherever the study and the results are."""
    run = run_study(STUDY, folder, folder / "far/away/out")
    saved = folder / "logs/study.toml"
    saved.write_text(run.report.reproduce.study)
    again = run_study(read_study(saved), saved.parent, folder / "again", source=saved)
    assert again.result.model.relations == run.result.model.relations
    resolved = read_study(folder / "far/away/out/study.toml")
    third = run_study(resolved, folder / "far/away/out", folder / "third")
    assert third.result.model.relations == run.result.model.relations


def test_files_of_several_folders_are_named_from_the_one_that_holds_them_all(folder):
    (folder / "more").mkdir()
    write(folder / "more/run.csv", oscillator(seed=4))
    study = structs.replace(STUDY, data=Data(files=("logs/run.csv", "more/run.csv"), time="t"))
    run = run_study(study, folder, folder / "out")
    assert parse_study(run.report.reproduce.study).data.files == ("logs/run.csv", "more/run.csv")


def test_the_report_is_of_the_columns_that_the_model_is_of(folder):
    """Of columns that compete the one that drove the record comes first, and loses its draft to the last."""
    log = oscillator()
    other = np.random.default_rng(0).standard_normal(len(log["u"]))
    write(folder / "logs/run.csv", {**log, "other": other})
    study = structs.replace(STUDY, inputs={"u": Driven(column=("u", "other"))})
    run = run_study(study, folder, folder / "out")
    assert run.result.study.inputs["u"].column == "u"
    assert [i.column for i in run.report.observed.recorded.inputs] == ["u"]
    assert run.report.observed == observed(run.result)


@pytest.mark.parametrize("at", ["records", "regression", "likelihood", EquationsReady, "report"])
def test_a_run_that_is_stopped_leaves_nothing(folder, at):
    events, before = list[Event](), snapshot(folder)
    stop = lambda: any(e == StageBegan(at) if isinstance(at, str) else isinstance(e, at) for e in events)  # noqa: E731
    with pytest.raises(Stopped, match=r"^stopped before any result was written; with --seconds 60") as stopped:
        run_study(STUDY, folder, folder / "out", monitor=Monitor(events.append, stop))
    assert stopped.value.exit_code == 130
    assert snapshot(folder) == before
    assert not any(isinstance(e, FilesWritten) for e in events)


@pytest.mark.parametrize("end", [KeyboardInterrupt, Stopped])
def test_a_stop_says_how_much_is_kept(folder, monkeypatch, end):
    def interrupted(study, *, watch, store, **_):
        store.mkdir(parents=True)
        for done in (6, 7):
            watch(Progress("recordings", "chunk", done, 20, 12.0))
        watch(Progress("likelihood", "search", 1, 2))
        raise end

    monkeypatch.setattr(module, "identify", interrupted)
    with pytest.raises(Stopped, match="7 of 20 chunks are kept: the same command goes on from there"):
        run_study(STUDY, folder, folder / "out")


def test_what_cannot_be_done_is_refused_with_its_exit_code(folder):
    with pytest.raises(InputError, match=r"overwrite .*model\.json") as refused:
        run_study(STUDY, folder, folder / "out", source=folder / "out/model.json")
    assert refused.value.exit_code == 2
    few = structs.replace(STUDY, selection=Ranking(terms=1), likelihood=LikelihoodSearch(enabled=False))
    with pytest.raises(NoModelError) as unfound:
        run_study(few, folder, folder / "out")
    assert unfound.value.exit_code == 3
    assert os.listdir(folder / "out") == ["no_model.html"]


@pytest.mark.parametrize("files", ["logs", "logs/*.csv"])
def test_results_are_not_written_among_the_data(folder, files):
    library = Candidates(basis=("x", "x_dot", "u"), degree=1)
    study = structs.replace(STUDY, data=Data(files=(files,), time="t"), library=library)
    before = snapshot(folder)
    with pytest.raises(InputError, match="the next run would read results there as data; name another folder"):
        run_study(study, folder, folder / "logs")
    assert snapshot(folder) == before
    first = run_study(study, folder, folder / "logs/out")
    again = run_study(read_study(folder / "logs/out/study.toml"), folder / "logs/out", folder / "logs/out")
    assert again.result.model.relations == first.result.model.relations


def test_only_results_are_drawn_again(folder):
    with pytest.raises(InputError, match=r"run.csv is no folder of results: expected one that odescope identify"):
        results_at(folder / "logs/run.csv")
    (folder / "logs/report.json").touch()
    assert results_at(folder / "logs/report.json") == results_at(folder / "logs") == folder / "logs"


def test_a_reference_is_shown_beside_what_was_found(folder):
    seen = []
    log = oscillator(noise=0.0)
    speed = np.gradient(log["x"], log["t"])
    truth = {"x": log["x"], "x_dot": speed, "x_ddot": np.gradient(speed, log["t"])}
    reference = Reference(signals=lambda: truth, table=lambda model: seen.append(model) or ())
    run = run_study(STUDY, folder, folder / "out", reference=reference)
    assert seen == [run.result.model]
    roles = {line.role for panel in run.report.observed.derivatives.panels for line in panel.wide}
    assert "truth" in roles


def test_a_report_is_drawn_again(folder):
    run_study(STUDY, folder, folder / "out")
    page = (folder / "out/report.html").read_bytes()
    (folder / "out/report.html").unlink()
    events = list[Event]()
    draw_again(folder / "out", folder / "out", Monitor(events.append))
    assert (folder / "out/report.html").read_bytes() == page
    assert events == [StageBegan("report"), FilesWritten(folder / "out", ("report.html", "figures/"))]


def test_the_demo_is_a_run_like_any_other(folder, monkeypatch):
    asked = {}

    def ran(study, at, out, **given):
        asked.update(study=study, at=at, out=out, **given)

    monkeypatch.setattr(module, "run_study", ran)
    events = list[Event]()
    run_demo(folder / "demo", 0, 1, 0.01, Monitor(events.append))
    assert events[-1] == FilesWritten(folder / "demo", ("log.csv", "demo.toml"))
    assert (asked["at"], asked["out"], asked["source"]) == (folder / "demo", folder / "demo", folder / "demo/demo.toml")
    assert set(asked["reference"].signals()) == {"x", "phi", "x_dot", "phi_dot", "x_ddot", "phi_ddot"}


SCRIPT = """
import multiprocessing
import sys
from pathlib import Path

multiprocessing.set_start_method(sys.argv[1])
print("top level", flush=True)

from odescope.commands.run import run_study
from odescope.study.toml import read_study

run = run_study(read_study(Path("study.toml")), Path(), Path("out"))
print(sorted(t.text for t in run.result.model.relations[0].terms))
"""


@pytest.mark.parametrize(
    "method",
    ["spawn", *(pytest.param(m, marks=pytest.mark.slow) for m in ("fork", "forkserver") if sys.platform != "win32")],
)
def test_a_script_without_a_guard_runs_once(tmp_path, method):
    """Figures are drawn in processes of their own, which must not run the user's script again."""
    write(tmp_path / "run.csv", oscillator())
    (tmp_path / "study.toml").write_text(
        "[data]\nfiles = ['run.csv']\ntime = 't'\n[coordinates.x]\norder = 2\n[inputs.u]\n"
        "[library]\nterms = ['1', 'x', 'x_dot', 'u', 'x_ddot']\n"
    )
    (tmp_path / "script.py").write_text(SCRIPT)
    root = str(Path(module.__file__).parents[2])
    path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "script.py", method], cwd=tmp_path, env={**os.environ, "PYTHONPATH": path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stderr == ""
    assert done.stdout == f"top level\n{sorted(TERMS)}\n"
    assert (tmp_path / "out/report.html").stat().st_size > 10_000
    assert len(list((tmp_path / "out/figures").glob("*.png"))) > 3


def test_a_run_without_a_model_leaves_a_page_of_what_was_found_and_the_results_of_others(folder):
    run_study(STUDY, folder, folder / "out")
    before = snapshot(folder / "out")
    hopeless, events = structs.replace(STUDY, library=Candidates(terms=("x**3", "x*u", "x_ddot"))), list[Event]()
    with pytest.raises(NoModelError) as e:
        run_study(hopeless, folder, folder / "out", title="<b>log</b>", monitor=Monitor(events.append))
    after = snapshot(folder / "out")
    assert {Path(name).name for name in after if name not in before} == {"no_model.html"}
    assert all(after[name] == content for name, content in before.items())
    page = (folder / "out/no_model.html").read_text(encoding="utf-8")
    assert str(e.value).split(":")[0] in page
    for part in ("What to try", "x**3", "<svg", "[coordinates.x]", "&lt;b&gt;log"):
        assert part in page
    assert "<b>log" not in page
    assert events[-1].names == ("no_model.html",)
    run_study(STUDY, folder, folder / "out")
    assert not (folder / "out/no_model.html").exists()
