"""Runs are processes that the folder knows: they go on without the server, are found again and can be ended."""

import os
import subprocess
import sys
import threading
import time

import msgspec
import numpy as np
import psutil
import pytest

pytest.importorskip("nicegui")

from odescope.errors import InputError
from odescope.events import FilesWritten, StageBegan
from odescope.report.event_lines import EndLine, EventFile, read_events
from odescope.workbench.folder import Folder
from odescope.workbench.jobs import EVENTS, HIDDEN, RECORD, Jobs, RunRecord, replacement

STUDY = '[data]\nfiles = ["a.csv"]\ntime = "t"\n[coordinates.c]\n'


@pytest.fixture
def place(tmp_path):
    t = 0.05 * np.arange(200)
    c = 2.0 * np.exp(-0.5 * t) + 0.005 * np.random.default_rng(0).standard_normal(200)
    rows = "".join(f"{a!r},{b!r}\n" for a, b in zip(t.tolist(), c.tolist(), strict=True))
    (tmp_path / "a.csv").write_text(f"t,c\n{rows}")
    (tmp_path / "a.toml").write_text(STUDY)
    return tmp_path


def sleeper(place, name="20260101-000000-a"):
    """A process that stands for a run of a server which is gone, and its name."""
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], start_new_session=True)
    own = place / HIDDEN / name
    own.mkdir(parents=True)
    record = RunRecord("a.toml", "a", process.pid, psutil.Process(process.pid).create_time())
    (own / RECORD).write_bytes(msgspec.json.encode(record))
    return process, name


def ended(jobs, name, seconds=180.0):
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if not (job := jobs.find(name)).running:
            return job
        time.sleep(0.1)
    raise AssertionError(f"{name} runs on")


def test_a_run_writes_what_the_command_line_writes(place):
    jobs = Jobs(Folder.of(place))
    job = jobs.start("a.toml")
    assert job.running
    with pytest.raises(InputError, match="a run writes to a already"):
        jobs.start("a.toml")
    over = ended(Jobs(Folder.of(place)), job.name)  # by another server
    assert over.state == "done"
    assert over.equations.equations[0].startswith("c_dot = -0.49")
    assert {"records", "signals", "likelihood", "report"} <= set(over.stages)
    written = {p.name for p in (place / "a").iterdir()}
    assert {"model.json", "candidates.csv", "study.toml", "report.html", "report.json"} <= written
    assert not [name for name in written if name.startswith(".")]
    jobs.forget(job.name)
    assert jobs.all() == ()
    assert (place / "a" / "model.json").exists()


@pytest.mark.slow
def test_a_script_beside_the_logs_is_not_run(place):
    (place / "select.py").write_text("open('ran', 'w').close()\nraise ImportError('my own script')\n")
    jobs = Jobs(Folder.of(place))
    job = ended(jobs, jobs.start("a.toml").name)
    jobs.forget(job.name)
    assert job.state == "done"
    assert not (place / "ran").exists()


def test_two_presses_begin_one_run(place):
    jobs, begun, refused = Jobs(Folder.of(place)), [], []

    def press():
        try:
            begun.append(jobs.start("a.toml"))
        except InputError as error:
            refused.append(str(error))

    presses = [threading.Thread(target=press) for _ in range(4)]
    for each in presses:
        each.start()
    for each in presses:
        each.join()
    for job in begun:
        jobs.cancel(job.name)
        jobs.forget(job.name)
    assert len(begun) == 1
    assert all("a run writes to a already" in said for said in refused)


def test_a_file_in_place_of_the_results_is_told(place):
    (place / "a").write_text("mine")
    with pytest.raises(InputError, match=r"cannot write to a: File exists"):
        Jobs(Folder.of(place)).start("a.toml")


def test_a_run_is_found_again_and_ended_within_a_second(place):
    process, name = sleeper(place)
    partial = place / "a" / ".odescope-0123456789abcdef"
    partial.mkdir(parents=True)
    (partial / "model.json").write_text("half")
    jobs = Jobs(Folder.of(place))
    assert jobs.find(name).state == "running"
    begun = time.monotonic()
    jobs.cancel(name)
    assert time.monotonic() - begun < 3.0  # a second, and time for a machine that does much else
    process.wait(5)
    job = jobs.find(name)
    assert (job.running, job.state) == (False, "stopped")
    assert not (place / "a").exists()
    jobs.cancel(name)
    assert jobs.find(name).end == job.end


def test_a_run_that_is_stopped_leaves_nothing_half_written(place):
    (place / "a.toml").write_text(STUDY.replace("[coordinates.c]", "[coordinates.c]\norder = 2"))
    jobs = Jobs(Folder.of(place))
    job = jobs.start("a.toml")
    until = time.monotonic() + 180.0
    while not jobs.find(job.name).stages and time.monotonic() < until:
        time.sleep(0.05)
    jobs.cancel(job.name)
    assert jobs.find(job.name).state == "stopped"
    assert sorted(p.name for p in place.iterdir()) == [".odescope", "a.csv", "a.toml"]


def over(place, name, *files, results="a", code=0):
    """What the folder says of a run that is over."""
    own = place / HIDDEN / name
    own.mkdir(parents=True)
    record = RunRecord(f"{results}.toml", results, os.getpid(), psutil.Process().create_time() - 3600.0)
    (own / RECORD).write_bytes(msgspec.json.encode(record))
    events = EventFile.begun(own / EVENTS)
    if files:
        events.tell(FilesWritten(place / results, files))
    events.end(code, "")


def test_a_run_whose_files_a_later_one_replaced_says_so(place):
    over(place, "1", "no_model.html", code=3)
    over(place, "2", "model.json", "report.html")
    over(place, "3", "model.json", "report.html", results="b")
    over(place, "4", "model.json", "report.html")
    over(place, "5", "no_model.html", code=3)
    over(place, "6", code=130)
    jobs = Jobs(Folder.of(place))
    replaced = {job.name: replacement(job, jobs.all()) for job in jobs.all()}
    assert {name: one and one.name for name, one in replaced.items()} == {
        "1": "5", "2": "4", "3": None, "4": None, "5": None, "6": None
    }  # fmt: skip
    over(place, "7", "model.json")
    assert replacement(jobs.find("5"), jobs.all()).name == "7"
    jobs.forget("7")
    assert replacement(jobs.find("5"), jobs.all()) is None


def test_another_process_with_the_number_is_no_run(place):
    own = place / HIDDEN / "x"
    own.mkdir(parents=True)
    record = RunRecord("a.toml", "a", os.getpid(), psutil.Process().create_time() - 3600.0)
    (own / RECORD).write_bytes(msgspec.json.encode(record))
    jobs = Jobs(Folder.of(place))
    assert jobs.find("x").state == "failed"
    jobs.cancel("x")  # and this process goes on


@pytest.mark.parametrize("record", [b"", b"[]", b'{"study": "a.toml", "results": "../../b", "pid": 1, "started": 0.0}'])
def test_what_is_no_record_of_a_run_is_passed_over(place, record):
    own = place / HIDDEN / "x"
    own.mkdir(parents=True)
    (own / RECORD).write_bytes(record)
    jobs = Jobs(Folder.of(place))
    assert jobs.all() == ()
    assert jobs.find("../x") is None
    jobs.cancel("x")


@pytest.mark.parametrize("study", ["b.toml", "../a.toml", "/a.toml"])
def test_a_study_that_is_not_there_is_not_run(place, study):
    with pytest.raises(InputError):
        Jobs(Folder.of(place)).start(study)
    assert not (place / HIDDEN).exists()


def test_results_go_beside_a_folder_of_logs_not_into_it(place):
    (place / "logs").mkdir()
    (place / "a.csv").rename(place / "logs/a.csv")
    (place / "logs.toml").write_text(STUDY.replace("a.csv", "logs"))
    jobs = Jobs(Folder.of(place))
    job = jobs.start("logs.toml")
    assert job.record.results == "logs-results"
    jobs.cancel(job.name)


def test_lines_are_read_as_they_come(tmp_path):
    path = tmp_path / EVENTS
    assert read_events(path, 0) == ((), 0)
    file = EventFile.begun(path)
    with path.open("ab") as stream:
        stream.write(b'{"event": "note", "at": 1.0, "text": "one"}\n{"event": "unheard of"}\nno json\n{"event": "no')
    lines, offset = read_events(path, 0)
    assert [line.text for line in lines] == ["one"]
    with path.open("ab") as stream:
        stream.write(b'te", "at": 2.0, "text": "two"}\n')
    file.end(3, "nothing")
    lines, _ = read_events(path, offset)
    assert lines[0].text == "two"
    assert isinstance(lines[1], EndLine)
    assert (lines[1].code, lines[1].message) == (3, "nothing")


def test_a_run_is_known_by_all_that_it_told_however_often_it_is_asked_for(place):
    process, name = sleeper(place)
    jobs, file = Jobs(Folder.of(place)), EventFile(place / HIDDEN / name / EVENTS)
    told = []
    for stage in ("records", "signals", "regression"):
        file.tell(StageBegan(stage))
        told.append(stage)
        assert jobs.find(name).stages == jobs.find(name).stages == tuple(told)
    process.kill()
    process.wait(5)
    jobs.forget(name)
    process, _ = sleeper(place, name)
    assert jobs.find(name).stages == ()
    process.kill()
    process.wait(5)
