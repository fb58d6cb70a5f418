"""A result of the folder: its model and report, and what running its models over its data gives."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.export.model_file import read_model
from odescope.model.model import Model
from odescope.model.recorded import UNSAID, TimeColumns, read_for
from odescope.model.simulation import Trajectory
from odescope.recordings.record import Record, Records
from odescope.report.assemble import read_report
from odescope.report.data import Report
from odescope.report.recorded import stays_near
from odescope.report.result_names import MODEL, PATH, PATH_MODEL, REPORT
from odescope.study.toml import parse_study
from odescope.validation.agreement import turned
from odescope.validation.free_runs import FreeRunOf
from odescope.workbench.folder import Folder
from odescope.workbench.long_chart import LongLine, LongPlot
from odescope.workbench.overview import Overview

DURATION = 10.0  # seconds
BEYOND = 0.5  # of the range of the data
UNKNOWN = (-1.0, 1.0)  # what stands for the range of data that nothing says


@dataclass(frozen=True, eq=False)
class Result:
    """A folder of results.

    Attributes:
        name: of it, in the folder of the workbench.
        place: where it is.
        model: the model.
        report: None where there is no report.json, as of what Python has saved.
        path: the models from many terms to few, by how many terms they have, the longest first.
    """

    name: str
    place: Path
    model: Model
    report: Report | None
    path: dict[int, Path]


def result_of(folder: Folder, name: str) -> Result:
    """Return a result of the folder.

    Raises:
        InputError: it lies outside, or its files cannot be read.
    """
    place = folder.inside(name)
    folder.check(place / MODEL)
    model = read_model(place / MODEL)
    report = read_report(place / REPORT) if (place / REPORT).is_file() else None
    named = re.compile(rf"(\d+){re.escape(PATH_MODEL)}")
    there = [p for p in (place / PATH).iterdir() if named.fullmatch(p.name)] if (place / PATH).is_dir() else []
    for path in there:
        folder.check(path)
    by_terms = {int(path.name.removesuffix(PATH_MODEL)): path for path in there}
    return Result(name, place, model, report, {terms: by_terms[terms] for terms in sorted(by_terms, reverse=True)})


def data_of(folder: Folder, result: Result) -> tuple[tuple[Path, ...], TimeColumns]:
    """Return the files that a result was made from, and where the time is in them.

    Raises:
        InputError: its study is not there, or names files outside of the folder.
    """
    path = result.place / "study.toml"
    folder.check(path)
    try:
        study = parse_study(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{result.name} has no study: what it was made from is not known") from error
    own = study.data
    return folder.files_of(study, result.place), TimeColumns(own.time, own.sample_period, own.recording)


def duration_of(result: Result) -> float:
    """Return how long the longest free run over the data of a result is, in seconds; `DURATION` where none is known."""
    scores = result.model.scores
    runs = [run.duration for run in scores.free_runs] if scores is not None else []
    if not runs and result.report is not None:
        runs = [run.duration for run in result.report.observed.recorded.runs]
    return max((seconds for seconds in runs if 0.0 < seconds < np.inf), default=DURATION)


def range_of(model: Model, name: str) -> tuple[float, float]:
    """Return between which values a state is chosen to begin from: the range of the data and half of it beyond."""
    low, high = model.domain.get(name, UNKNOWN)
    more = BEYOND * max(high - low, 1e-12)
    return low - more, high + more


def start_of(result: Result) -> dict[str, float]:
    """Return a state to begin from: what the report shows first of each coordinate, and rest.

    Of what it does not show, and of what is beyond `range_of`, it is the middle of the data.
    """
    model, first = result.model, dict[str, float]()
    runs = () if result.report is None else result.report.at_work.free_runs.runs
    for c, panel in zip(model.coordinates, runs[0].panels if runs else (), strict=False):
        shown = next((y for line in panel.wide if line.role == "recorded" for y in line.y if y is not None), None)
        if shown is not None:
            first[c.name] = shown - c.offset
    measured = {c.name for c in model.coordinates}
    for state in model.states:
        low, high = range_of(model, state)
        there = first.get(state, 0.0 if state not in measured else np.inf)
        first[state] = there if low <= there <= high else 0.5 * (low + high)
    return first


def recorded_for(model: Model, files: tuple[Path, ...], columns: TimeColumns = UNSAID) -> Records:
    """Return recordings with all that a model needs.

    Args:
        model: whose coordinates and inputs are read.
        files: data.
        columns: where the time is.
    """
    names = [c.name for c in model.coordinates] + [i.name for i in model.inputs]
    return read_for(model, files, columns, names)


def run_plots(model: Model, of: FreeRunOf) -> tuple[LongPlot, ...]:
    """Return a free run beside what was measured, a panel a coordinate, and below it what is left."""
    found = list[LongPlot]()
    t = of.record.t - of.record.t[0]
    for c in model.coordinates:
        measured, predicted = measured_and_run(model, c.name, of.record, of.run)
        unit = f" ({c.unit})" if c.unit else ""
        near = np.where(stays_near(predicted, [measured]), predicted, np.nan)
        found.append(
            LongPlot(
                f"{c.name}{unit}",
                (
                    LongLine("measured", "recorded", Overview.of([t], [measured])),
                    LongLine("free run", "model", Overview.of([t], [near])),
                ),
            )
        )
        rest = Overview.of([t], [measured - near])
        found.append(LongPlot(f"residual{unit}", (LongLine("measured − free run", "estimated", rest),)))
    return tuple(found)


def measured_and_run(model: Model, name: str, record: Record, run: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return what was measured of a coordinate (N,), and what a free run says, NaN from where it ended.

    Args:
        model: that was run.
        name: of the coordinate.
        record: that it was run over.
        run: the run.
    """
    coordinate = next(c for c in model.coordinates if c.name == name)
    measured = record.column(name)
    own = run.column(name) + coordinate.offset
    own = turned(own, measured[: len(own)]) if coordinate.angle else own
    return measured, np.concatenate([own, np.full(len(measured) - len(own), np.nan)])


def at_time(plots: tuple[LongPlot, ...], t: float) -> list[tuple[str, float]]:
    """Return what every line of some panels says at a time, by label and name."""
    found = []
    for plot in plots:
        for one in plot.lines:
            xs, ys = one.values.ts[0], one.values.ys[0]
            k = int(np.clip(np.searchsorted(xs, t), 0, len(xs) - 1))
            found.append((f"{plot.label}, {one.name}", float(ys[k])))
    return found
