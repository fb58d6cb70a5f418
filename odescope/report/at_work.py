"""The model at work on the last part of the longest recording, and its terms fitted without that part."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.tape import evaluate
from odescope.model.model import Model
from odescope.model.relation import Relation
from odescope.pipeline.evaluation import LastPart, free_run
from odescope.pipeline.identification import Identification
from odescope.report.data import AtWork, Chart, Panel, Role, StretchFit
from odescope.report.recorded import Clock, Trace, Truth, chart, labels, panel
from odescope.report.searches import columns_of
from odescope.selection.ranking import left_column

BEYOND = 1.0  # how far outside the record's own range, in spans of it, a free run is followed


@dataclass(frozen=True, eq=False)
class _Shown:
    """What the charts show: the models, by label and role, on the last part of the longest recording.

    Shapes: time (N,) on the clock of the recordings, columns (names, N) of the signals.
    """

    result: Identification
    models: tuple[tuple[str, Role, Model], ...]
    part: LastPart
    time: FloatArray
    columns: FloatArray
    clock: Clock

    def estimated(self, name: str) -> FloatArray:
        """Return a state, target or input as estimated from the record, (N,)."""
        row: FloatArray = self.columns[self.result.signals.row(name)]
        return row


def at_work(result: Identification, truth: Truth | None = None) -> AtWork:
    """Return predicted against estimated targets (Fig. 6) and the free run against the record (Fig. 7)."""
    signals, clock = result.signals, Clock.of(result.records)
    part = LastPart.of(signals, result.model)
    refitted = without_last(result, part.record)
    models: list[tuple[str, Role, Model]] = [("model", "model", result.model)]
    if refitted is not None:
        models.append(("its terms, fitted without this stretch", "refitted", refitted))
    time = clock.kept(result)[part.record][part.first :]
    shown = _Shown(result, tuple(models), part, time, signals.columns[part.record][:, part.first :], clock)
    scores = result.model.scores
    free = None if scores is None else scores.free_run
    free = free_run(result.model, signals) if free is None else free  # a draft has no scores
    targets, fits = _targets(shown, truth)
    return AtWork(
        targets=targets,
        free_run=_free_run(shown, float(time[0]) + free.valid_time),
        held_out=refitted is not None,
        begin=float(time[0]),
        end=float(time[-1]),
        fits=fits,
        valid_time=free.valid_time,
        duration=free.duration,
        ended=free.ended or "",
    )


def without_last(result: Identification, longest: int) -> Model | None:
    """Return the model's terms with coefficients regressed on all blocks but those of the last one's fold.

    None where the record is too short for blocks, or the library of the regression lacks a term, or the fit without
    them determines no model.
    """
    relations = []
    if not result.searches:
        return None
    for search, relation in zip(result.searches, result.model.relations, strict=True):
        problem, columns = search.problem, columns_of(search, relation)
        if len(problem.folds) < 2 or columns is None:
            return None
        last = max((b for b in problem.blocks if b.record == longest), key=lambda b: b.start)
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


def _targets(shown: _Shown, truth: Truth | None) -> tuple[Chart, tuple[StretchFit, ...]]:
    label, time = labels(shown.result), shown.time
    variables = np.array([shown.estimated(name) for name in shown.result.model.variables])
    found = [(text, role, predicted(model, variables)) for text, role, model in shown.models]
    middle, half = 0.5 * float(time[0] + time[-1]), 0.1 * float(time[-1] - time[0])
    panels, fits = list[Panel](), list[StretchFit]()
    for k, target in enumerate(shown.result.model.targets):
        estimated = shown.estimated(target)
        traces: list[Trace] = [("estimated", "estimated", [time], [estimated])]
        if truth is not None and target in truth:
            raw = shown.clock.raw()[0]
            inside = slice(*np.searchsorted(raw, (time[0], time[-1])).tolist())
            traces.append(("truth", "truth", [raw[inside]], [truth[target][inside]]))
        traces += [(text, role, *_within(time, values[k], estimated)) for text, role, values in found]
        panels.append(panel(label[target], traces, (middle - half, middle + half)))
        r2 = [_r2(estimated, values[k]) for _, _, values in found]
        fits.append(StretchFit(target=target, model=r2[0], refitted=r2[1] if len(r2) > 1 else None))
    return chart(shown.clock.label, panels), tuple(fits)


def _free_run(shown: _Shown, valid: float) -> Chart:
    label, time = labels(shown.result), shown.time
    runs = [(text, role, shown.part.run(model)) for text, role, model in shown.models]
    panels = []
    for state in shown.result.model.states:
        record = shown.estimated(state)
        traces: list[Trace] = [("record, filtered", "estimated", [time], [record])]
        traces += [(text, role, *_within(time, run.column(state), record)) for text, role, run in runs]
        panels.append(panel(label[state], traces, None))
    marks = [(valid, "end of valid time")] if valid < float(time[-1]) - 0.5 * shown.result.signals.period else []
    return chart(shown.clock.label, panels, marks=marks)


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
