"""The page to try a model: under other inputs, from other starts, on other data, beside another model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from odescope.arrays import FloatArray
from odescope.errors import OdescopeError
from odescope.model.model import Model
from odescope.model.recorded import UNSAID, clocks, read_for
from odescope.model.simulation import Trajectory, simulate
from odescope.report.page import number
from odescope.report.units import quantity_units, shown
from odescope.validation.compare import compare
from odescope.validation.domain import outside_domain
from odescope.validation.validate import Validation
from odescope.workbench import charts
from odescope.workbench.excitation import SAID, Excitation, plain, sample_times, suggested
from odescope.workbench.frame import (
    Latest,
    Workbench,
    aside,
    button,
    complaint,
    panel,
    show_result,
    table,
    text,
)
from odescope.workbench.long_chart import LongChart, LongLine, LongPlot
from odescope.workbench.overview import Overview
from odescope.workbench.results import (
    UNKNOWN,
    Result,
    data_of,
    duration_of,
    measured_and_run,
    range_of,
    result_of,
    start_of,
)

LABELS = {
    "level": "level",
    "goal": "steps to",
    "begin": "begins at (s)",
    "amplitude": "amplitude",
    "frequency": "frequency (Hz)",
    "last_frequency": "last frequency (Hz)",
}
FIELD = "dense outlined debounce=300"
MADE = ""  # no log
STEPS = 200  # of a slider


async def try_page(bench: Workbench, name: str) -> None:
    """Make the page to try a result."""
    await show_result(bench, "try", name, _result)


def _result(bench: Workbench, name: str) -> None:
    """Offer to simulate a result, and to compare it.

    Raises:
        InputError: it lies outside of the folder, or cannot be read.
    """
    result = result_of(bench.folder, name)
    with panel("Simulate", "Under inputs and from a start of your own; beyond the data it extrapolates.", "first"):
        SimulationView(bench, result)
    with panel("Compare and validate", "Free runs and one-step predictions on a log that you choose."):
        CompareView(bench, result)


def _slider(label: str, low: float, high: float, value: float) -> ui.slider:
    """Make a slider between two numbers, with its value beside it."""
    with ui.element("div").classes("scrub"):
        text("span", label)
        made = ui.slider(min=low, max=high, value=value, step=(high - low) / STEPS)
        made.props["aria-label"] = label
        shown = text("span", number(value), "reading")
    made.on_value_change(lambda e: shown.set_text(number(e.value)))
    return made


def _labels(model: Model) -> dict[str, str]:
    """Return what is written beside every state and input: its name, and its unit where that is known."""
    units = quantity_units(model)
    return {name: f"{name} ({shown(unit)})" if shown(unit) else name for name, unit in units.items()}


class SimulationView:
    """A simulation that is run anew when anything of it changes."""

    def __init__(self, bench: Workbench, result: Result) -> None:
        """Make the controls."""
        self._bench, self._model, self._latest = bench, result.model, Latest()
        self._labels, self._seconds = _labels(self._model), plain(duration_of(result))
        self._made, self._fields = dict[str, Excitation](), list[ui.element]()
        with ui.element("div").classes("controls"):
            self._duration = ui.number("duration (s)", value=self._seconds, min=1e-6).props(FIELD)
            shown = {MADE: "made here", **{name: f"of {name}" for name in bench.folder.logs()}}
            self._log = ui.select(shown, value=MADE, label="inputs").props("dense outlined options-dense")
            self._log.set_visibility(bool(self._model.inputs))
        self._clocks = clocks(self._model)
        for one in self._model.inputs:
            if one.name not in self._clocks:
                self._fields.append(self._input(one.name))
        self._start = dict[str, ui.slider]()
        for state, value in start_of(result).items():
            label = f"{self._labels[state]} at the start"
            self._start[state] = _slider(label, *range_of(self._model, state), value)
        for control in (self._duration, self._log, *self._start.values()):
            control.on_value_change(self._run)
        self._log.on_value_change(self._show_fields)
        self._said, self._drawn = ui.element("div").props("role=status"), ui.element("div")
        self._chart: LongChart | None = None
        ui.timer(0.01, self._run, once=True)

    def _show_fields(self) -> None:
        """Show what says how inputs go that are made here, where they are."""
        for one in (self._duration, *self._fields):
            one.set_visibility(self._log.value == MADE)

    def _input(self, name: str) -> ui.element:
        """Make the fields of one input, those that its shape has a use for."""
        unit = shown(quantity_units(self._model)[name])
        own = self._made[name] = suggested(*self._model.domain.get(name, UNKNOWN), self._seconds)
        with ui.element("fieldset").classes("channel") as around:
            text("legend", self._labels[name])
            shape = ui.select(list(SAID), value=own.shape, label="shape").props("dense outlined options-dense")
            fields: dict[str, ui.number] = {}
            for key, label in LABELS.items():
                of_unit = f"{label} ({unit})" if unit and "(" not in label else label
                fields[key] = ui.number(of_unit, value=getattr(own, key)).props(FIELD)

        def show() -> None:
            for key, field in fields.items():
                field.set_visibility(key in SAID[self._made[name].shape])

        async def changed(event: ValueChangeEventArguments[Any], key: str) -> None:
            if event.value is not None:
                self._made[name] = replace(self._made[name], **{key: event.value})
                show()
                await self._run()

        show()
        for key, control in {"shape": shape, **fields}.items():
            control.on_value_change(lambda e, key=key: changed(e, key))
        return around

    async def _run(self) -> None:
        self._said.clear()
        try:
            found = await self._latest.of(self._simulated)
        except OdescopeError as error:
            with self._said:
                complaint(str(error))
            return
        if found is not None:
            self._said.clear()
            self._show(*found)

    def _simulated(self) -> tuple[FloatArray, dict[str, FloatArray], Trajectory]:
        """Return times, inputs and the run; called beside the server's thread."""
        names, start = [i.name for i in self._model.inputs], {n: float(s.value) for n, s in self._start.items()}
        if self._log.value != MADE:
            record = read_for(self._model, [self._bench.folder.inside(self._log.value)], UNSAID, names).runs[0]
            t = record.t - record.t[0]
            inputs = {name: record.column(name) for name in names}
        else:
            t = sample_times(float(self._duration.value or 0.0), list(self._made.values()))
            inputs = {name: t if name in self._clocks else self._made[name].values(t) for name in names}
        return t, inputs, simulate(self._model, t, inputs or None, start)

    def _show(self, t: FloatArray, inputs: dict[str, FloatArray], found: Trajectory) -> None:
        labels = self._labels
        run = {state: found.column(state) for state in self._model.states}
        plots = [
            LongPlot(labels[state], (LongLine("model", "model", Overview.of([found.t], [values])),))
            for state, values in run.items()
        ]
        plots += [
            LongPlot(labels[n], (LongLine("input", "recorded", Overview.of([t], [u])),)) for n, u in inputs.items()
        ]
        if self._chart is None:
            with self._drawn:
                self._chart = LongChart(plots, "time (s)", "the simulated states and the inputs over time")
        else:
            self._chart.show(plots)
        with self._said:
            for sentence in outside_domain(self._model, {n: [y] for n, y in (run | inputs).items()}):
                complaint(sentence)
            if found.ended:
                complaint(f"the run ended at {number(float(found.t[-1]))} s: {found.ended}")


class CompareView:
    """Models beside each other on the data of a log: how well they predict, and their free runs."""

    def __init__(self, bench: Workbench, result: Result) -> None:
        """Make the controls."""
        self._bench, self._result = bench, result
        others = [name for name in bench.folder.results() if name != result.name]
        with ui.element("div").classes("controls"):
            shown = {"": "its own data", **{name: name for name in bench.folder.logs()}}
            self._log = ui.select(shown, value="", label="on").props("dense outlined options-dense")
            beside = {"": "none", **{name: name for name in others}}
            self._other = ui.select(beside, value="", label="beside").props("dense outlined options-dense")
        with ui.element("div").classes("actions"):
            button("Compare" if others else "Validate", self._run, main=True)
        self._shown = ui.element("div").props("role=status")

    async def _run(self) -> None:
        self._shown.clear()
        with self._shown:
            text("p", "running …", "about")
        try:
            found = await aside(self._compared)
        except OdescopeError as error:
            self._shown.clear()
            with self._shown:
                complaint(str(error))
            return
        self._shown.clear()
        with self._shown:
            _show_validation(*found)

    def _compared(self) -> tuple[Validation, dict[str, Model]]:
        folder, own = self._bench.folder, self._result
        models = {own.name: own.model}
        if self._other.value:
            models[self._other.value] = result_of(folder, self._other.value).model
        files, columns = ((folder.inside(self._log.value),), UNSAID) if self._log.value else data_of(folder, own)
        return compare(models, files, columns), models


def _show_validation(found: Validation, models: dict[str, Model]) -> None:
    """Show the table of a validation, and the free runs over the first recording."""
    rows = [
        (
            r.model,
            r.prediction,
            r.coordinate,
            "–" if r.fit is None else f"{number(r.fit, 4)} %",
            f"{number(r.rmse, 4)} {r.unit or ''}",
            "" if r.valid_time is None else f"{number(r.valid_time, 4)} of {number(r.duration, 4)}",
        )
        for r in found.rows
        if r.recording == "all"
    ]
    heads = ("model", "prediction", "coordinate", "fit", "RMSE", "valid time (s)")
    table("How well they predict", heads, rows, (3, 4, 5))
    for note in found.notes:
        text("p", note)
    first = {of.model: of for of in found.runs if of.number == 1}
    plots = []
    for c in next(iter(models.values())).coordinates:
        lines = list[charts.Options]()
        for k, (name, of) in enumerate(first.items()):
            measured, predicted = measured_and_run(models[name], c.name, of.record, of.run)
            t = of.record.t - of.record.t[0]
            if not lines:
                lines.append(charts.line("measured", *_thinned(t, measured), "recorded"))
            lines.append(charts.coloured(name, *_thinned(t, predicted), k))
        plots.append(charts.Plot(f"{c.name} ({c.unit})" if c.unit else c.name, tuple(lines)))
    chart = charts.stacked(plots, "time from the start (s)")
    charts.chart(chart, "free runs of the models beside what was measured", charts.height(len(plots)))


def _thinned(t: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    there = np.isfinite(y)
    line = Overview.of([t[there]], [y[there]])
    return line.window(*line.span, 1200)
