"""The page of a result: equations, free runs, residuals, the path of models, spectra, candidates, correlations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from odescope.errors import InputError
from odescope.export.model_file import read_model
from odescope.model.model import Model
from odescope.model.scores import PathScore
from odescope.report.data import Periodogram, Report
from odescope.report.page import number, sections_html
from odescope.report.result_names import MODEL, NO_MODEL, REPORT_PAGE
from odescope.validation.free_runs import FreeRunOf, free_runs
from odescope.workbench import charts
from odescope.workbench.frame import (
    Latest,
    Workbench,
    address,
    aside,
    complaint,
    link,
    markup,
    panel,
    show_result,
    stored,
    text,
)
from odescope.workbench.long_chart import LongChart
from odescope.workbench.results import Result, at_time, data_of, recorded_for, result_of, run_plots

SECTIONS = (("coefficients", "Coefficients"), ("candidates", "Candidates and evidence"), ("work", "Model at work"))
Runs = tuple[FreeRunOf, ...]
LEAST_POINTS = 3  # of a picture: what fewer say is said in words
STEPS = 1000  # of the slider over time


async def look_page(bench: Workbench, name: str) -> None:
    """Make the page of a result."""
    await show_result(bench, "look", name, _result)


async def _result(bench: Workbench, name: str) -> None:
    """Show a result, or that there was no model.

    Raises:
        InputError: it lies outside of the folder, or cannot be read.
    """
    place = bench.folder.inside(name)
    if not (place / MODEL).is_file() and (place / NO_MODEL).is_file():
        text("p", "The data supported no model.")
        link("Open what was found until then", stored(name, NO_MODEL), new_tab=True)
        return
    result = result_of(bench.folder, name)
    _links(result)
    await _shown(bench, result)


def _links(result: Result) -> None:
    with ui.element("div").classes("actions"):
        if (result.place / REPORT_PAGE).is_file():
            link("Open the report", stored(result.name, REPORT_PAGE), new_tab=True)
        link("Try it", address("try", result.name))
        link("Take it away", address("take", result.name))


async def _shown(bench: Workbench, result: Result) -> None:
    """Show all parts of a result; what is computed comes last."""
    parts = {} if result.report is None else await aside(sections_html, result.report)
    if parts:
        ui.add_css(f".report {{ {parts['style']} }}")
        markup(parts["answer"], "report")
    else:
        markup(result.model._repr_html_(), "report")
    runs = ui.element("div")
    for name, label in SECTIONS:
        if parts.get(name):
            with ui.expansion(label).classes("options").props("dense"):
                if name == "candidates" and result.report is not None and result.report.searches:
                    charts.candidates({s.target: s.points for s in result.report.searches})
                markup(parts[name], "report")
    if result.report is not None:
        _spectra(result.report)
        _correlations(result.report)
    await ui.context.client.connected(timeout=30)
    with runs:
        await _runs(bench, result)


def _spectra(report: Report) -> None:
    spectra = report.observed.spectra
    if not spectra:
        return
    with ui.expansion("Spectra and cutoffs").classes("options").props("dense"):
        text("p", "Left of the cutoff is what was kept of each channel, right of it what was taken for noise.", "about")
        for one in spectra:
            charts.chart(_spectrum(one), f"power spectrum of {one.channel} with its cutoff", 280)


def _spectrum(one: Periodogram) -> charts.Options:
    return charts.spectrum(
        one.channel,
        f"power ({one.unit}²/Hz)" if one.unit else "power (1/Hz)",
        charts.line(one.channel, one.power.x, one.power.y, "recorded"),
        {f"cutoff {number(one.cutoff, 3)} Hz": one.cutoff},
        {"noise floor": one.floor},
    )


def _correlations(report: Report) -> None:
    with ui.expansion("Correlation of candidate terms").classes("options").props("dense"):
        for s in report.searches:
            text("h3", f"For {s.target}")
            own = s.correlations
            pixels = 200 + max(16 * len(own.terms), 120)
            charts.chart(charts.matrix(own.terms, own.percent), f"correlations between terms for {s.target}", pixels)


async def _runs(bench: Workbench, result: Result) -> None:
    """Show free runs of the model, and of those on its path."""
    with panel(
        "Free run against the record",
        "From a state fitted to the first stretch; after that it sees nothing but the inputs.",
    ):
        waiting = text("p", "running …", "about")
        try:
            files, columns = data_of(bench.folder, result)
            records = await aside(recorded_for, result.model, files, columns)
            found = await aside(free_runs, result.model, records)
        except InputError as error:
            waiting.delete()
            complaint(f"the model is not run here: {error}")
            return
        waiting.delete()
        RunsView(result, found, lambda model: free_runs(model, records))


class RunsView:
    """Free runs on the page: which recording, which model of the path, and what the lines say at one time."""

    def __init__(self, result: Result, runs: Runs, run_model: Callable[[Model], Runs]) -> None:
        """Draw the first run.

        Args:
            result: whose model it is.
            runs: of its model.
            run_model: returns those of another model over the same recordings.
        """
        self._result, self._model, self._runs, self._run_model, self._at = result, result.model, runs, run_model, 0
        self._steps, self._latest = self._path_steps(), Latest()
        if len(self._steps) > 1:
            self._path_controls()
        if len(runs) > 1:
            shown = {k: f"recording {of.number}: {of.record.source}" for k, of in enumerate(runs)}
            ui.select(shown, value=0, label="recording", on_change=self._other).props("dense outlined")
        self._plots = run_plots(self._model, runs[0])
        self._chart = LongChart(self._plots, "time from the start (s)", "free run and residuals over time")
        with ui.element("div").classes("scrub"):
            text("span", "at")
            slider = ui.slider(min=0, max=STEPS, value=0, on_change=lambda e: self._scrub(e.value))
            slider.props('aria-label="time at which the lines are read"')
            self._reading = ui.element("div").classes("reading").props("role=status")
        self._scrub(0)

    def _path_steps(self) -> list[PathScore]:
        scores = self._result.model.scores
        return [] if scores is None else [s for s in scores.path if s.terms in self._result.path]

    def _path_controls(self) -> None:
        steps = self._steps
        text("h3", "From many terms to few")
        if len(steps) >= LEAST_POINTS:
            groups = [
                charts.Group("model on the path", [(s.terms, s.error) for s in steps if not s.chosen], 1, False),
                charts.Group("chosen", [(s.terms, s.error) for s in steps if s.chosen], 0, True),
            ]
            spots = charts.spots(groups, "terms", "free-run error, held out (std)")
            charts.chart(spots, "error over number of terms", 240)
        with ui.element("div").classes("scrub"):
            text("span", "terms")
            chosen = next((k for k, s in enumerate(steps) if s.chosen), 0)
            slider = ui.slider(min=0, max=len(steps) - 1, value=chosen, step=1, on_change=lambda e: self._take(e.value))
            slider.props('snap markers aria-label="model on the path, from many terms to few"')
            self._taken = text("span", _said_of(steps[chosen]), "reading").props("role=status")
        self._equations = ui.element("div")

    async def _take(self, number_: float) -> None:
        """Show the model at a place of the path."""
        step = self._steps[int(number_)]
        found = await self._latest.of(self._on_path, step)
        if found is None:
            return
        self._model, self._runs = model, _ = found
        self._taken.set_text(_said_of(step))
        self._equations.clear()
        with self._equations:
            if not step.chosen:
                markup(replace(model, scores=None)._repr_html_(), "report")
        self._redraw()

    def _on_path(self, step: PathScore) -> tuple[Model, Runs]:
        """Return the model of a place of the path, and its free runs; called beside the server's thread."""
        model = self._result.model if step.chosen else read_model(self._result.path[step.terms])
        return model, self._run_model(model)

    def _other(self, event: ValueChangeEventArguments[Any]) -> None:
        self._at = int(event.value)
        self._redraw()

    def _redraw(self) -> None:
        self._plots = run_plots(self._model, self._runs[self._at])
        self._chart.show(self._plots)

    def _scrub(self, step: float) -> None:
        first, last = self._plots[0].lines[0].values.span
        t = first + step / STEPS * (last - first)
        self._reading.clear()
        with self._reading:
            text("span", f"{number(t)} s")
            for name, value in at_time(self._plots, t):
                text("span", f"{name} {number(value)}")
        self._chart.mark(t)


def _said_of(step: PathScore) -> str:
    """Return what a place of the path is, and how far its free runs go wrong."""
    dropped = f", without {step.dropped}" if step.dropped else ""
    said = "the result itself" if step.chosen else f"{step.terms} terms{dropped}"
    return f"{said}; error {number(step.error, 3)} standard deviations of what was measured"
