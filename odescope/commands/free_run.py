"""Free runs of a model file over a data file: the simulate command."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError, nearest
from odescope.export.model_file import read_model
from odescope.model.initial_state import initial_state
from odescope.model.model import Model
from odescope.model.simulation import Trajectory, simulate
from odescope.recordings.layout import Layout
from odescope.recordings.readers import column_names, read_records
from odescope.recordings.record import Record

TIME_NAMES = ("t", "time", "Time", "T", "TIME")


def free_runs(
    model_path: Path,
    data_path: Path,
    time: str | None,
    sample_period: float | None,
    recording: str | None,
    initial: list[str],
) -> tuple[str, list[str]]:
    """Return the simulated states, as sensors would read them, as CSV text, and notes on runs that ended early.

    Each recording starts from its own first sample: from the states given as NAME=VALUE, the rest fitted to the first
    stretch of the measured coordinates.

    Args:
        model_path: a model file.
        data_path: the recordings whose inputs drive it.
        time: column that holds the time in seconds; by default as identified, else t, time and the like.
        sample_period: in seconds, where no column holds the time.
        recording: column that splits the file into recordings.
        initial: NAME=VALUE of states at the first sample.

    Raises:
        InputError: a file cannot be read, a column is missing, or a given state is none of the model's.
    """
    model = read_model(model_path)
    given = _given_states(model, initial)
    columns = _columns(model, needed=len(given) < len(model.states))
    if sample_period is None and time is None:
        time = _time_column(model, data_path)
    layout = Layout(
        time=time,
        sample_period=sample_period,
        columns=columns,
        angles=frozenset(c.name for c in model.coordinates if c.angle and c.name in dict(columns)),
        held=frozenset(i.name for i in model.inputs if i.hold == "zero"),
        inputs=frozenset(i.name for i in model.inputs),
        recording=recording,
    )
    records = read_records([data_path], layout)
    out, notes = io.StringIO(), []
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow((*(() if recording is None else (recording,)), time or "t", *model.states))
    offsets = {c.name: c.offset for c in model.coordinates}
    read = np.array([offsets.get(s, 0.0) for s in model.states])  # what sensors read more than states
    for run in records:
        label = () if recording is None else (_label(run, data_path, recording),)
        result = _free_run(model, run, given, read)
        for t, row in zip(result.t.tolist(), (result.states + read).tolist(), strict=True):
            writer.writerow((*label, repr(t), *map(repr, row)))
        if result.ended:
            where = f" of recording {label[0]}" if label else ""
            notes.append(f"the free run{where} ended early, at {len(result.t)} of {len(run)} samples: {result.ended}")
    return out.getvalue(), notes


def _label(run: Record, data: Path, recording: str) -> str:
    """Return what the column `recording` says of a run: the reader leaves it in the run's source."""
    _, _, label = run.source.removeprefix(data.name).partition(f" ({recording} ")  # of a folder, the file is named
    return label.removesuffix(")")


def _free_run(model: Model, run: Record, given: dict[str, float], read: FloatArray) -> Trajectory:
    start: FloatArray
    if len(given) == len(model.states):
        start = np.array([given[s] for s in model.states]) - read
    else:
        start = initial_state(model, run)
        for name, value in given.items():
            k = model.states.index(name)
            start[k] = value - read[k]
    inputs = np.array([run.column(i.name) for i in model.inputs]).reshape(len(model.inputs), len(run)).T
    return simulate(model, run.t, np.ascontiguousarray(inputs), start)


def _given_states(model: Model, initial: list[str]) -> dict[str, float]:
    given: dict[str, float] = {}
    for text in initial:
        name, _, value = text.partition("=")
        name = name.strip()
        if name in given:
            raise InputError(f"--initial {name} is given twice")
        if name not in model.states:
            raise InputError(f"--initial {text}: {name!r} is no state of the model; {nearest(name, model.states)}")
        try:
            given[name] = float(value)
        except ValueError:
            raise InputError(f"--initial {text}: expected STATE=NUMBER, such as {name}=0.5") from None
        if not np.isfinite(given[name]):
            raise InputError(f"--initial {text}: the number must be finite")
    return given


def _columns(model: Model, needed: bool) -> tuple[tuple[str, str], ...]:
    """Return the columns to read: as they were named when the model was identified, else by the model's own names."""
    known = model.provenance.get("columns")
    place = known if isinstance(known, dict) else {}
    names = ([c.name for c in model.coordinates] if needed else []) + [i.name for i in model.inputs]
    if not names:  # an autonomous model with every state given still needs the sample times
        names = [model.coordinates[0].name]
    return tuple((name, column if isinstance(column := place.get(name), str) else name) for name in names)


def _time_column(model: Model, data: Path) -> str:
    known = model.provenance.get("time")
    there = column_names(data)
    for name in (known, *TIME_NAMES):
        if isinstance(name, str) and name in there:
            return name
    raise InputError(
        f"{data.name} has no column called t or time; name it with --time, or give --sample-period. Its columns are"
        f" {', '.join(there)}"
    )
