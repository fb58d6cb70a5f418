"""Runs: processes that outlive the page and the server, known by what the folder says of them."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
import psutil

from odescope.errors import InputError, Stopped
from odescope.files import write_file
from odescope.json_text import encoded
from odescope.report.event_lines import (
    AnyLine,
    EndLine,
    EquationsLine,
    EventFile,
    FilesLine,
    ProgressLine,
    StageLine,
    read_events,
)
from odescope.report.place import default_place
from odescope.report.result_names import MODEL, NO_MODEL
from odescope.study.toml import read_study
from odescope.workbench.folder import Folder

HIDDEN = ".odescope"  # the folder of runs within that of the workbench
RECORD, EVENTS, ERRORS = "run.json", "events.jsonl", "errors.txt"
PATIENCE = 0.6  # seconds that a run has to stop by itself
SAME_START = 1.0  # seconds: a process that began so near to another of its number is that one
PARTIAL = ".odescope-*"  # what files are written to before they are complete
LAST_WORDS = 2000  # characters of a run that ended without saying why


class RunRecord(msgspec.Struct, frozen=True):
    """What the folder says of a run: its study and results by their names there, its process and when that began."""

    study: str
    results: str
    pid: int
    started: float


@dataclass(frozen=True)
class Job:
    """A run by its name, which is that of its folder, and how far it got."""

    name: str
    record: RunRecord
    running: bool
    lines: tuple[AnyLine, ...]

    @property
    def end(self) -> EndLine | None:
        """How it ended."""
        return next((line for line in reversed(self.lines) if isinstance(line, EndLine)), None)

    @property
    def state(self) -> str:
        """One word: "running", "done", "no model", "stopped" or "failed"."""
        if self.running:
            return "running"
        code = None if self.end is None else self.end.code
        return (
            {0: "done", 3: "no model", Stopped.exit_code: "stopped"}.get(code, "failed")
            if code is not None
            else "failed"
        )

    @property
    def files(self) -> frozenset[str]:
        """The files that it told it wrote."""
        return frozenset(name for line in self.lines if isinstance(line, FilesLine) for name in line.names)

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages that began, each once."""
        return tuple(dict.fromkeys(line.stage for line in self.lines if isinstance(line, StageLine)))

    @property
    def progress(self) -> ProgressLine | None:
        """How far the stage got that runs, if it says so."""
        found = next((line for line in reversed(self.lines) if isinstance(line, StageLine | ProgressLine)), None)
        return found if isinstance(found, ProgressLine) else None

    @property
    def equations(self) -> EquationsLine | None:
        """The equations that it told last."""
        return next((line for line in reversed(self.lines) if isinstance(line, EquationsLine)), None)


class Jobs:
    """The runs of a folder."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        self._own: dict[str, subprocess.Popen[bytes]] = {}
        self._starting = threading.Lock()  # two presses of a button are two threads
        # The lines that a run told, and the byte after them.
        self._read: dict[str, tuple[tuple[AnyLine, ...], int]] = {}

    def start(self, study: str) -> Job:
        """Begin to identify a study of the folder, to the results that the command line would write.

        Raises:
            InputError: the study is not there or cannot be read, or its results are being written by a run already.
        """
        path = self._folder.inside(study)
        if not path.is_file():
            raise InputError(f"there is no study {study!r}")
        results = default_place(path.with_suffix(""), read_study(path).data.files, path.parent)
        self._folder.check(results)
        with self._starting:
            return self._start(path, study, results)

    def _start(self, path: Path, study: str, results: Path) -> Job:
        name = self._folder.name(results)
        if any(job.running and job.record.results == name for job in self.all()):
            raise InputError(f"a run writes to {name} already: stop it, or wait for it")
        try:
            results.mkdir(exist_ok=True)  # what is not complete is then written within it, where a stop can remove it
            place = self._place_for(path.stem)
        except OSError as error:
            raise InputError(f"cannot write to {name}: {error.strerror or error}") from error
        command = [sys.executable, "-P", "-m", "odescope", "identify", str(path), "--out", str(results)]
        command += ["--events", str(place / EVENTS)]
        with (place / ERRORS).open("wb") as errors:
            process = subprocess.Popen(
                command,
                cwd=self._folder.root,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,  # an interrupt of the server's terminal is none of the run's
            )
        self._own[place.name] = process
        record = RunRecord(study, name, process.pid, _began(process.pid))
        write_file(place / RECORD, encoded(record).decode())
        return Job(place.name, record, True, ())

    def all(self) -> tuple[Job, ...]:
        """Return the runs, the last first."""
        place = self._folder.root / HIDDEN
        names = sorted((p.name for p in place.iterdir() if p.is_dir()), reverse=True) if place.is_dir() else []
        return tuple(job for name in names if (job := self.find(name)) is not None)

    def find(self, name: str) -> Job | None:
        """Return a run by its name, None where there is none."""
        try:
            place = self._folder.inside(f"{HIDDEN}/{name}")
            record = msgspec.json.decode((place / RECORD).read_bytes(), type=RunRecord)
            self._folder.inside(record.results)
        except (OSError, msgspec.MsgspecError, InputError):
            return None
        running = self._process(name, record) is not None
        return Job(name, record, running, self._lines(name))

    def last_words(self, job: Job) -> str:
        """Return what a run said last that ended without a message."""
        try:
            said = (self._folder.root / HIDDEN / job.name / ERRORS).read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""
        return said[-LAST_WORDS:].strip()

    def cancel(self, name: str) -> None:
        """End a run: it is asked to stop, and ended with all its processes where it does not within a second."""
        job = self.find(name)
        process = None if job is None else self._process(name, job.record)
        if job is None or process is None:
            return
        family = _family(process)
        with suppress(psutil.Error, OSError):
            process.send_signal(signal.SIGINT) if os.name == "posix" else process.terminate()
        if self._ended(name, process, PATIENCE):
            family = [child for child in family if child.is_running()]
        for one in [*family, process]:
            with suppress(psutil.Error):
                one.kill()
        self._ended(name, process, PATIENCE)
        self._tidy(job)

    def forget(self, name: str) -> None:
        """Remove what the folder says of a run that is over; its results stay."""
        job = self.find(name)
        if job is not None and not job.running:
            shutil.rmtree(self._folder.root / HIDDEN / name, ignore_errors=True)
            self._read.pop(name, None)
            own = self._own.pop(name, None)
            if own is not None:
                with suppress(subprocess.TimeoutExpired):  # its last threads may take a moment more than itself
                    own.wait(PATIENCE)
            self._remove_empty(job)

    def _lines(self, name: str) -> tuple[AnyLine, ...]:
        """Return what a run told until now; pages ask twice a second, so only what is new is read."""
        known, offset = self._read.get(name, ((), 0))
        new, offset = read_events(self._folder.root / HIDDEN / name / EVENTS, offset)
        self._read[name] = (known + new, offset)
        return known + new

    def _tidy(self, job: Job) -> None:
        """Remove what a run that was ended has left, and say in its events that it is over."""
        results = self._folder.root / job.record.results
        for partial in results.glob(PARTIAL):
            shutil.rmtree(partial, ignore_errors=True)
        self._remove_empty(job)
        found = self.find(job.name)
        if found is not None and found.end is None:
            EventFile(self._folder.root / HIDDEN / job.name / EVENTS).end(Stopped.exit_code, "stopped")

    def _remove_empty(self, job: Job) -> None:
        """Remove the folder of results, if nothing was written there at all."""
        with suppress(OSError):
            (self._folder.root / job.record.results).rmdir()

    def _place_for(self, stem: str) -> Path:
        """Return a new folder for a run, named by when it began and its study."""
        plain = re.sub(r"[^\w-]+", "-", stem, flags=re.ASCII).strip("-") or "study"
        base = f"{time.strftime('%Y%m%d-%H%M%S')}-{plain}"
        for number in range(1, 100):
            place = self._folder.root / HIDDEN / (base if number == 1 else f"{base}-{number}")
            with suppress(FileExistsError):
                place.mkdir(parents=True)
                return place
        raise InputError("a hundred runs in one second: wait a little")

    def _process(self, name: str, record: RunRecord) -> psutil.Process | None:
        """Return the process of a run while it runs; another that has its number by now began at another time."""
        own = self._own.get(name)
        if own is not None and own.poll() is not None:
            return None
        try:
            process = psutil.Process(record.pid)
            alive = process.status() != psutil.STATUS_ZOMBIE
            return process if alive and abs(process.create_time() - record.started) < SAME_START else None
        except (psutil.Error, ValueError):
            return None

    def _ended(self, name: str, process: psutil.Process, seconds: float) -> bool:
        """Wait for the end of a process; tell whether it came."""
        own = self._own.get(name)
        try:
            if own is not None:
                own.wait(seconds)
            else:
                process.wait(seconds)
        except (subprocess.TimeoutExpired, psutil.TimeoutExpired):
            return False
        except psutil.Error:
            pass
        return True


def replacement(job: Job, jobs: Sequence[Job]) -> Job | None:
    """Return the last run after another whose files took the place of that one's, None where these still stand.

    A result takes the place of another, and of what was left without a model; the latter of its like alone.

    Args:
        job: that may have been replaced.
        jobs: all there are, the last first.
    """
    for one in jobs:
        if one.name == job.name:
            break
        if one.record.results == job.record.results and (
            (MODEL in one.files and job.files) or (NO_MODEL in one.files and NO_MODEL in job.files)
        ):
            return one
    return None


def _began(pid: int) -> float:
    try:
        return float(psutil.Process(pid).create_time())
    except psutil.Error:  # it has ended already
        return time.time()


def _family(process: psutil.Process) -> list[psutil.Process]:
    try:
        found: list[psutil.Process] = process.children(recursive=True)
    except psutil.Error:
        return []
    return found
