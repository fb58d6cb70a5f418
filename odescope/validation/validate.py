"""Models on data that they have not seen: free runs from the start, from many starts, and one-step predictions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError, check_kind
from odescope.model.driven_record import DrivenRecord
from odescope.model.gate import counting_for
from odescope.model.model import Model
from odescope.model.recorded import records_for
from odescope.model.simulation import Trajectory
from odescope.observer.estimate import StateEstimates, estimate_states
from odescope.observer.noise import measurement_noise
from odescope.recordings.record import Record, Recorded, Records
from odescope.validation.agreement import Agreement, Pair, agreement
from odescope.validation.domain import outside_domain
from odescope.validation.free_runs import FreeRunOf, beside, run_freely

STARTS = 20  # runs in all, spread over the recordings by their lengths
LEAST_STARTS = 2  # of a recording that is long enough
SHORTEST = 64  # samples of such a run
FREE, MANY, STEP = "free run", "many starts", "one step"
ALL = "all"  # recordings together


@dataclass(frozen=True)
class ValidationRow:
    """How one model predicts one coordinate, in one recording or in all of them together.

    `prediction` is "free run" from the first sample, "many starts" for free runs one after another, "one step" for
    what the observer says of a sample from all earlier ones. `fit` is in per cent, `rmse` in `unit`, both None where a
    run ended early. `valid_time` and `duration` are in seconds, of many starts their medians.
    """

    model: str
    recording: str
    prediction: str
    coordinate: str
    fit: float | None
    rmse: float | None
    unit: str | None
    valid_time: float | None
    duration: float | None


@dataclass(frozen=True, eq=False)
class Validation:
    """Rows for a dataframe, the free runs that they come from, and what to be careful of."""

    rows: tuple[ValidationRow, ...]
    runs: tuple[FreeRunOf, ...]
    notes: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """The table of all recordings together, line by line."""
        return table_lines([row for row in self.rows if row.recording == ALL])

    def __repr__(self) -> str:
        return "\n".join([*self.lines, *self.notes])


def validate(
    models: Model | Mapping[str, Model],
    data: Recorded,
    noise: Mapping[str, float] | None = None,
) -> Validation:
    """Return how well models predict recordings.

    Every run starts from a state that is fitted to its own first stretch (`initial_state`). Outliers, late reads and
    saturated samples do not count, as when a model is identified, and the notes say which these are.

    Args:
        models: one, or several by name.
        data: with the coordinates and inputs of all models: uniformly sampled records, or dataframes, dicts of columns
            and paths of files, whose columns are called as those that the first model was identified from.
        noise: standard deviation of a sample, by coordinate, for one-step predictions; by default as each model was
            identified. A model that does not say so has no one-step predictions.

    Raises:
        InputError: no model, a column is missing, or a name in `noise` is no coordinate.
    """
    named = dict(models) if isinstance(models, Mapping) else {"model": models}
    if not named:
        raise InputError("no model: expected at least one")
    for model in named.values():
        check_kind(model, Model, "what is validated")
    records = records_for(next(iter(named.values())), data)
    parts = list[Validation]()
    for name, model in named.items():
        counting, notes = counting_for(model, records)
        found = _validated(name, model, counting, noise)
        parts.append(replace(found, notes=(*notes, *found.notes)))
    return together(parts)


def together(parts: Sequence[Validation]) -> Validation:
    """Return several validations as one."""
    return Validation(
        rows=tuple(row for part in parts for row in part.rows),
        runs=tuple(run for part in parts for run in part.runs),
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )


def _validated(name: str, model: Model, records: Records, noise: Mapping[str, float] | None) -> Validation:
    known, unknown = dict[str, float](), ""
    try:
        known = measurement_noise(model, noise)
    except InputError as error:
        if noise:
            raise
        unknown = f"{name}: no one-step predictions: {error}"
    driven = [DrivenRecord.of(model, record) for record in records]
    free = [(whole.compared(model), run_freely(model, whole)) for whole in driven]
    pieces = [list(_many(model, whole, records)) for whole in driven]
    rows = [*_rows(name, model, FREE, [[run] for run in free], known), *_rows(name, model, MANY, pieces, known)]
    notes = [
        f"{name}: the free run of {_label(number, record)} ended early: {run.ended}"
        for number, (record, run) in enumerate(free, 1)
        if run.ended
    ]
    columns = {c: [r.column(c) for r in records] for c in (*_measured(model), *(i.name for i in model.inputs))}
    if unknown:
        notes.append(unknown)
    else:
        estimates = estimate_states(model, records, noise)
        rows += _one_step(name, model, records, estimates)
        rates = [s for s in model.states if s not in columns]
        columns |= {s: [run.column(s)[run.settling :] for run in estimates.runs] for s in rates}
    notes += [f"{name}: {sentence}" for sentence in outside_domain(model, columns)]
    runs = tuple(FreeRunOf(name, number, *run) for number, run in enumerate(free, 1))
    return Validation(tuple(rows), runs, tuple(notes))


def _measured(model: Model) -> tuple[str, ...]:
    return tuple(c.name for c in model.coordinates)


def _many(model: Model, whole: DrivenRecord, records: Records) -> Iterator[tuple[Record, Trajectory]]:
    """Yield free runs over the pieces of a record, but for those without a sample of what the record has samples of."""
    record = whole.compared(model)
    there = [counted for c in model.coordinates if (counted := record.counted(c.name)).any()]
    share = max(LEAST_STARTS, round(STARTS * len(record) / records.samples))
    count = max(1, min(share, len(record) // SHORTEST))
    edges = np.linspace(0, len(record), count + 1).astype(np.int64).tolist()
    for first, stop in pairwise(edges):
        if all(counted[first:stop].any() for counted in there):
            yield record.part(first, stop), run_freely(model, whole.part(first, stop))


def _label(number: int, record: Record) -> str:
    """Return what a recording is called: where it came from, or its number."""
    return record.source or f"recording {number}"


def _rows(
    name: str,
    model: Model,
    prediction: str,
    runs: list[list[tuple[Record, Trajectory]]],
    noise: Mapping[str, float],
) -> Iterator[ValidationRow]:
    """Yield the rows of free runs, given those of every recording, and the noise of what is known of it.

    A recording that holds no sample of a coordinate has no row of it.
    """
    for c in model.coordinates:
        every, times = list[Pair | None](), list[tuple[float, float]]()
        for number, everything in enumerate(runs, 1):
            own = [(record, run) for record, run in everything if record.counted(c.name).any()]
            if not own:
                continue
            pieces, spans = list[Pair](), list[tuple[float, float]]()
            for record, run in own:
                pair, valid = beside(c, FreeRunOf(name, number, record, run), noise.get(c.name, 0.0))
                pieces.append(pair)
                spans.append((valid, record.duration))
            whole = all(run.ended is None for _, run in own)
            measured, predicted = (np.concatenate(part) for part in zip(*pieces, strict=True))
            joined = (measured, predicted) if whole else None
            if len(runs) > 1:
                yield _row(name, _label(number, own[0][0]), prediction, c.name, c.unit, _agreed([joined]), spans)
            every.append(joined)
            times += spans
        yield _row(name, ALL, prediction, c.name, c.unit, _agreed(every), times)


def _agreed(pairs: list[Pair | None]) -> Agreement | None:
    """Return the agreement of some recordings together, None where there is none or a run of one ended early."""
    whole = [pair for pair in pairs if pair is not None]
    return agreement(whole) if whole and len(whole) == len(pairs) else None


def _row(
    name: str,
    recording: str,
    prediction: str,
    coordinate: str,
    unit: str | None,
    agreed: Agreement | None,
    spans: list[tuple[float, float]],
) -> ValidationRow:
    valid, duration = (float(np.median(part)) for part in zip(*spans, strict=True)) if spans else (None, None)
    fit, rmse = (None, None) if agreed is None else (agreed.fit, agreed.rmse)
    return ValidationRow(name, recording, prediction, coordinate, fit, rmse, unit, valid, duration)


def _one_step(name: str, model: Model, records: Records, estimates: StateEstimates) -> Iterator[ValidationRow]:
    """Yield the rows of one-step predictions, whose errors are the innovations of the observer."""
    for k, c in enumerate(model.coordinates):
        every = list[Pair | None]()
        for number, (record, run) in enumerate(zip(records, estimates.runs, strict=True), 1):
            off: FloatArray = run.innovations[run.settling :, k]
            there = np.isfinite(off)
            measured = record.column(c.name)[run.settling : len(run.t)][there]
            pair = None if run.ended or not len(measured) else (measured, measured - off[there])
            if len(records) > 1:
                yield _row(name, _label(number, record), STEP, c.name, c.unit, _agreed([pair]), [])
            every.append(pair)
        yield _row(name, ALL, STEP, c.name, c.unit, _agreed(every), [])


def table_lines(rows: Iterable[ValidationRow]) -> list[str]:
    """Return rows as the lines of a table."""
    cells = [("model", "prediction", "coordinate", "fit, %", "RMSE", "valid time, s")]
    for row in rows:
        fit = "-" if row.fit is None else f"{row.fit:.4g}"
        rmse = "-" if row.rmse is None else f"{row.rmse:.4g}{f' {row.unit}' if row.unit else ''}"
        valid = "" if row.valid_time is None else f"{row.valid_time:.4g} of {row.duration:.4g}"
        cells.append((row.model, row.prediction, row.coordinate, fit, rmse, valid))
    widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]
