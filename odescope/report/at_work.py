"""The model at work on the last stretch of the longest recording, and its terms fitted without that stretch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.tape import evaluate
from odescope.model.model import Model
from odescope.model.relation import Relation
from odescope.model.simulation import simulate
from odescope.pipeline.identification import Identification
from odescope.report.data import AtWork, Chart, Panel, Role, Score
from odescope.report.recorded import Clock, Trace, Truth, chart, labels, panel
from odescope.report.searches import columns_of
from odescope.selection.ranking import left_column

PART = 5  # the stretch is this part of the recording, as it is for the score of the free run
BEYOND = 1.0  # how far outside the record's own range, in spans of it, a free run is followed


def at_work(result: Identification, truth: Truth | None = None) -> AtWork:
    """Return predicted against estimated targets (Fig. 6) and the free run against the record (Fig. 7)."""
    signals, clock = result.signals, Clock.of(result.records)
    longest = clock.longest
    columns = signals.columns[longest]
    first = columns.shape[1] - max(columns.shape[1] // PART, 2)
    time, stretch = clock.kept(result)[longest][first:], columns[:, first:]
    refitted = without_last(result, longest)
    models: list[tuple[str, Role, Model]] = [("model", "model", result.model)]
    if refitted is not None:
        models.append(("its terms, fitted without this stretch", "refitted", refitted))
    free: dict[str, object] = dict(result.model.scores["free_run"])  # type: ignore[arg-type]
    targets, scores = _targets(result, models, time, stretch, truth, clock)
    valid = float(free["valid_time"])  # type: ignore[arg-type]
    return AtWork(
        targets=targets,
        free_run=_free_run(result, models, time, stretch, float(time[0]) + valid, clock),
        held_out=refitted is not None,
        begin=float(time[0]),
        end=float(time[-1]),
        scores=scores,
        valid_time=valid,
        duration=float(free["duration"]),  # type: ignore[arg-type]
        ended=str(free["ended"] or ""),
    )


def without_last(result: Identification, longest: int) -> Model | None:
    """Return the model's terms with coefficients regressed on all blocks but those of the last one's fold.

    None where the record is too short for blocks, or the fit without them determines no model.
    """
    relations = []
    for search, relation in zip(result.searches, result.model.relations, strict=True):
        problem = search.problem
        if len(problem.folds) < 2:
            return None
        last = max((b for b in problem.blocks if b.record == longest), key=lambda b: b.start)
        columns = columns_of(search, relation)
        xi = problem.training[last.fold].solve(tuple(sorted(columns)), left_column(problem, columns))
        terms = tuple(
            replace(t, coefficient=float(xi[j]), std_error=None) for t, j in zip(relation.terms, columns, strict=True)
        )
        relations.append(Relation(terms))
    return replace(result.model, relations=tuple(relations))


def predicted(model: Model, variables: FloatArray) -> FloatArray:
    """Return the targets (T, N) that a model gives at states and inputs (variables, N); NaN at a pole."""
    count, values = len(model.targets), evaluate(model.tape, variables)
    matrix = np.moveaxis(values[: count * count].reshape(count, count, -1), -1, 0)
    right = values[count * count :].T[..., None]
    sound = np.abs(np.linalg.det(matrix)) > 0.0
    found = np.full((variables.shape[1], count), np.nan)
    found[sound] = np.linalg.solve(matrix[sound], right[sound])[..., 0]
    return found.T


def _targets(
    result: Identification,
    models: list[tuple[str, Role, Model]],
    time: FloatArray,
    stretch: FloatArray,
    truth: Truth | None,
    clock: Clock,
) -> tuple[Chart, tuple[Score, ...]]:
    signals, label = result.signals, labels(result)
    variables = stretch[[signals.row(name) for name in result.model.variables]]
    found = [(text, role, predicted(model, variables)) for text, role, model in models]
    middle, half = 0.5 * float(time[0] + time[-1]), 0.1 * float(time[-1] - time[0])
    panels, scores = list[Panel](), list[Score]()
    for k, target in enumerate(result.model.targets):
        estimated = stretch[signals.row(target)]
        traces: list[Trace] = [("estimated", "estimated", [time], [estimated])]
        if truth is not None and target in truth:
            raw = clock.raw()[0]
            inside = slice(*np.searchsorted(raw, (time[0], time[-1])).tolist())
            traces.append(("truth", "truth", [raw[inside]], [truth[target][inside]]))
        traces += [(text, role, *_within(time, values[k], estimated)) for text, role, values in found]
        panels.append(panel(label[target], traces, (middle - half, middle + half)))
        fits = [_r2(estimated, values[k]) for _, _, values in found]
        scores.append(Score(target=target, model=fits[0], refitted=fits[1] if len(fits) > 1 else None))
    return chart(clock.label, panels), tuple(scores)


def _free_run(
    result: Identification,
    models: list[tuple[str, Role, Model]],
    time: FloatArray,
    stretch: FloatArray,
    valid: float,
    clock: Clock,
) -> Chart:
    signals, states, label = result.signals, result.model.states, labels(result)
    variables = stretch[[signals.row(name) for name in result.model.variables]]
    inputs, initial = variables[len(states) :].T, variables[: len(states), 0]
    t = np.arange(len(time), dtype=np.float64) * np.float64(signals.period)
    runs = [
        (text, role, simulate(model, t, np.ascontiguousarray(inputs), np.ascontiguousarray(initial)))
        for text, role, model in models
    ]
    panels = []
    for state in states:
        record = stretch[signals.row(state)]
        traces: list[Trace] = [("record, filtered", "estimated", [time], [record])]
        traces += [(text, role, *_within(time, run.column(state), record)) for text, role, run in runs]
        panels.append(panel(label[state], traces, None))
    marks = [(valid, "end of valid time")] if valid < float(time[-1]) - 0.5 * signals.period else []
    return chart(clock.label, panels, marks=marks)


def _within(time: FloatArray, values: FloatArray, record: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the pieces of a line that stay near the record's own range: what runs away would flatten the rest."""
    span = BEYOND * max(float(np.ptp(record)), 1e-300)
    low, high = float(record.min()) - span, float(record.max()) + span
    near = np.flatnonzero((values >= low) & (values <= high))
    pieces = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
    return [time[p] for p in pieces], [values[p] for p in pieces]


def _r2(estimated: FloatArray, values: FloatArray) -> float | None:
    power = float(np.sum((estimated - estimated.mean()) ** 2))
    missed = float(np.sum((estimated - values) ** 2))
    return 1.0 - missed / power if power > 0.0 and np.isfinite(missed) else None
