"""The page of runs: how far each got, its candidates as they appear, its equations, and a button that ends it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from nicegui import run, ui

from odescope.errors import InputError
from odescope.events import Progress, standing
from odescope.report.data import Point
from odescope.report.event_lines import CandidatesLine, NoteLine
from odescope.report.result_names import NO_MODEL, REPORT_PAGE
from odescope.workbench import charts
from odescope.workbench.frame import (
    IDENTIFY,
    Listed,
    Workbench,
    address,
    button,
    complaint,
    link,
    panel,
    show_one,
    stored,
    text,
)
from odescope.workbench.jobs import Job, replacement

EVERY = 0.5  # seconds between two looks at the events
MARKS = {"running": "●", "done": "✓", "no model": "–", "stopped": "■", "failed": "✗"}


async def run_page(bench: Workbench, name: str) -> None:
    """Make the page of a run."""
    jobs = bench.jobs.all()
    replaced = {job.name: "replaced" for job in jobs if replacement(job, jobs) is not None}
    listed = Listed("Runs", [job.name for job in jobs], IDENTIFY, "study", replaced)
    await show_one(bench, "run", listed, name, RunView)


class RunView:
    """What is shown of one run, brought up to date while it runs."""

    def __init__(self, bench: Workbench, name: str) -> None:
        """Draw a run, and follow it.

        Raises:
            InputError: there is none of that name.
        """
        job = bench.jobs.find(name)
        if job is None:
            raise InputError(f"there is no run {name!r}")
        self._bench, self._name, self._known, self._offered = bench, name, -1, ""
        self._result = job.record.results
        self._state = text("p", "", "about").props("role=status")
        self._bar = ui.linear_progress(0.0, show_value=False, size="6px").props('aria-label="progress"')
        self._stages = text("p", "", "about")
        self._actions = ui.element("div").classes("actions")
        self._found = ui.element("div")
        self._show(job)
        if job.running:
            self._timer = ui.timer(EVERY, self._look)

    def _look(self) -> None:
        job = self._bench.jobs.find(self._name)
        if job is None:
            return
        if not job.running:
            self._timer.cancel()
        self._show(job)

    def _show(self, job: Job) -> None:
        progress = job.progress
        later = None if job.running else replacement(job, self._bench.jobs.all())
        instead = "" if later is None else f"; its result was replaced by the run of {_when(later)}"
        self._state.set_text(f"{MARKS[job.state]} {job.state}{_left(job)}{instead}")
        self._stages.set_text(" → ".join(job.stages))
        self._bar.set_visibility(job.running)
        if progress is None or not progress.total:
            self._bar.props("indeterminate")
        else:
            self._bar.props(remove="indeterminate")
            self._bar.set_value(progress.done / progress.total)
        news = len(job.lines) if job.running else -2
        if news == self._known:
            return
        self._known = news
        if job.state != self._offered:  # a button that is drawn anew loses the focus, and what was pressed just then
            self._offered = job.state
            self._show_actions(job, later)
        self._found.clear()
        with self._found:
            _equations(job)
            _candidates({line.target: line.points for line in job.lines if isinstance(line, CandidatesLine)})
            _notes([line.text for line in job.lines if isinstance(line, NoteLine)])

    def _show_actions(self, job: Job, later: Job | None) -> None:
        """Offer what can be done with a run.

        Args:
            job: the run.
            later: the one that replaced its result, None where it stands.
        """
        self._actions.clear()
        with self._actions:
            if job.running:
                button("Stop", self._stop, danger=True)
                return
            if later is not None:
                link("Open the run that replaced its result", address("run", later.name))
            elif job.state == "done":
                button("Look at the result", self._look_at_result, main=True)
                link("Open the report", stored(job.record.results, REPORT_PAGE), new_tab=True)
            elif NO_MODEL in job.files:
                link("Open what was found until then", stored(job.record.results, NO_MODEL), new_tab=True)
            link("Open the study", address("study", job.record.study))
            button("Remove from this list", self._forget)
            if job.state in ("failed", "no model"):
                ended = "" if job.end is None else job.end.message
                complaint(ended or self._bench.jobs.last_words(job) or "it ended without a word")

    def _look_at_result(self) -> None:
        """Go to the result, unless another run has replaced it since the page was drawn."""
        job = self._bench.jobs.find(self._name)
        if job is None or replacement(job, self._bench.jobs.all()) is None:
            ui.navigate.to(address("look", self._result))
        else:
            ui.navigate.to(address("run", self._name))

    async def _stop(self) -> None:
        await run.io_bound(self._bench.jobs.cancel, self._name)
        self._look()

    def _forget(self) -> None:
        self._bench.jobs.forget(self._name)
        ui.navigate.to("/run")


def _when(job: Job) -> str:
    return time.strftime("%Y-%m-%d, %H:%M:%S", time.localtime(job.record.started))


def _left(job: Job) -> str:
    """Return where a run stands, and how long it takes yet."""
    if not job.running:
        return ""
    p = job.progress
    if p is None:
        return f": {job.stages[-1]}" if job.stages else ": starting"
    return f": {standing(Progress(p.stage, p.part, p.done, p.total, p.seconds_left))}"


def _equations(job: Job) -> None:
    told = job.equations
    if told is None:
        return
    with panel("Equations", "as regression proposes them; the likelihood decides next" if told.draft else ""):
        for line in told.equations:
            text("pre", line, "formula")


def _candidates(found: Mapping[str, Sequence[Point]]) -> None:
    if found:
        with panel(
            "Candidates",
            "Each circle is a relation: its error on held-out data over its terms. What is chosen is filled.",
        ):
            charts.candidates(found)


def _notes(notes: list[str]) -> None:
    if notes:
        with panel("Notes"):
            for note in notes:
                text("p", note)
