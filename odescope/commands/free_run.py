"""Free runs of a model file over a data file: the simulate command."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.commands.model_data import Sensors, TimeCells, label_of, named_numbers, units_told
from odescope.errors import InputError
from odescope.export.model_file import read_model
from odescope.model.gate import counting_for
from odescope.model.initial_state import initial_state
from odescope.model.model import Model
from odescope.model.recorded import (
    ROWS,
    TimeColumns,
    lacking_columns,
    layout_for,
    model_columns,
    read_for,
    recording_column,
)
from odescope.model.simulation import Trajectory, simulate
from odescope.recordings.readers import read_times
from odescope.recordings.record import Record, Records, within
from odescope.validation.agreement import agreement, turned

NEAR = 0.75  # sample periods from the regular times: rows of the next piece are further away


@dataclass(frozen=True)
class FreeRuns:
    """Simulated states, as sensors would read them, as CSV text, and notes on runs that ended early.

    `lines` say what the columns are in, and how every coordinate agrees with what was measured.
    """

    text: str
    notes: tuple[str, ...]
    lines: tuple[str, ...]


def free_runs(
    model_path: Path,
    data_path: Path,
    time: str | None,
    sample_period: float | None,
    recording: str | None,
    initial: list[str],
) -> FreeRuns:
    """Return the free runs of a model under recorded inputs, and how they agree with what was measured.

    There is one row for each row of the data within what was recorded of coordinates and inputs, whatever its time
    stamp. Angles that were identified from degrees are read and written in degrees.

    Each recording, and each piece of one that gaps cut, starts from its own first sample: from the states given as
    NAME=VALUE, the rest fitted to the first stretch of the measured coordinates.

    Args:
        model_path: a model file.
        data_path: the recordings whose inputs drive it.
        time: column that holds the time in seconds; by default as identified, else t, time and the like.
        sample_period: in seconds, where no column holds the time.
        recording: column that splits the file into recordings; by default as identified, where it is there.
        initial: NAME=VALUE of states at the first sample.

    Raises:
        InputError: a file cannot be read, a column is missing, a given state is none of the model's, or neither
            coordinates nor options say where a run begins.
    """
    model, columns = read_model(model_path), TimeColumns(time, sample_period, recording)
    recording = recording_column(model, data_path, columns)
    columns = replace(columns, recording=recording)
    given = named_numbers("--initial", initial, model.states, "state")
    records, measured, told = _recordings(model, data_path, columns, given)
    out, runs = io.StringIO(), list[Trajectory]()
    writer = csv.writer(out, lineterminator="\n")
    time_cells = TimeCells.of(model, data_path, columns)
    writer.writerow((*(() if recording is None else (recording,)), time_cells.label, *model.states))
    sensors = Sensors.of(model)
    stamps = read_times(
        data_path, layout_for(model, [data_path], columns, [n for n in model_columns(model) if n in records.names])
    )
    notes = [*_starts(records, given), *_rows_left_out(records, stamps)]
    for run in records:
        label = () if recording is None else (label_of(run, [data_path], recording),)
        result = _free_run(model, run, given, sensors)
        runs.append(result)
        own, states = _at_the_rows(result, run, stamps.get(run.source, run.t))
        for t, row in zip(time_cells.written(own), sensors.read(states).tolist(), strict=True):
            writer.writerow((*label, t, *map(repr, row)))
        if result.ended:
            where = f" of recording {label[0]}" if label else ""
            notes.append(f"the free run{where} ended early, at {len(result.t)} of {len(run)} samples: {result.ended}")
    fits = () if measured is None else _fits(model, records, runs, measured)
    return FreeRuns(out.getvalue(), tuple(notes), (*fits, *told, *units_told(model, time_cells)))


def _starts(records: Records, given: Mapping[str, float]) -> Iterator[str]:
    """Yield what is to be said of runs that start within a recording, or several from one given state."""
    pieces = Counter(run.source for run in records)
    for source, count in pieces.items():
        if count > 1:
            yield (
                f"gaps cut the record{within(source)} into {count} pieces: behind each gap the run starts anew, from a"
                " state at the first sample there"
            )
    if given and len(records) > 1:
        yield (
            f"what --initial says of {', '.join(given)} is taken for the state at the first sample of every recording"
            f" and piece, {len(records)} in all; to start each from its own, run them one by one"
        )


def _rows_left_out(records: Records, stamps: Mapping[str, FloatArray]) -> Iterator[str]:
    """Yield how many rows have no states, as the record that a run covers does not reach them."""
    for source, t in stamps.items():
        within_runs = np.zeros(len(t), dtype=np.bool_)
        for run in records:
            if run.source == source:
                within_runs |= _near(t, run, run.t[-1])
        if not within_runs.all():
            yield (
                f"{np.count_nonzero(~within_runs)} of {len(t)} rows{within(source)} have no states: they lie before,"
                " behind or between what was recorded of coordinates and inputs"
            )


def _near(t: FloatArray, run: Record, last: float) -> BoolArray:
    """Return which times (n,) belong to a record up to some time."""
    near = NEAR * run.sample_period
    found: BoolArray = (t >= run.t[0] - near) & (t <= last + near)
    return found


def _recordings(
    model: Model, data: Path, columns: TimeColumns, given: dict[str, float]
) -> tuple[Records, Records | None, tuple[str, ...]]:
    """Return the recordings to run on, those with the coordinates if the file holds them, and what does not count."""
    coordinates, inputs = [c.name for c in model.coordinates], [i.name for i in model.inputs]
    lacking = lacking_columns(coordinates, model, [data])
    if len(given) < len(model.states):
        if lacking:
            asked = " ".join(f"--initial {s}=..." for s in model.states if s not in given)
            raise InputError(
                f"no column {', '.join(map(repr, lacking))} in {data.name}, to which the state at the first sample"
                f" would be fitted; name the column so, or give that state, {asked}"
            )
        counting, told = counting_for(model, read_for(model, [data], columns, coordinates + inputs))
        return counting, counting, told
    there = [n for n in coordinates if model_columns(model)[n] not in lacking]
    # Gaps in the coordinates are none of the run's business: inputs are read by themselves. An autonomous model with
    # every state given needs the times alone.
    driving = inputs or there[:1]
    records = read_for(model, [data], columns, driving) if driving else _times_alone(model, data, columns)
    if lacking:
        return records, None, ()
    return records, *counting_for(model, read_for(model, [data], columns, coordinates))


def _times_alone(model: Model, data: Path, columns: TimeColumns) -> Records:
    """Return recordings that hold nothing but the times of their rows, as the file has them."""
    layout = layout_for(model, [data], columns, [])
    if layout.time is None:
        return read_for(model, [data], columns, [])
    times = {source: np.unique(t) for source, t in read_times(data, layout).items()}
    return Records(tuple(Record(t, np.zeros((len(t), 1)), (ROWS,), source=source) for source, t in times.items()))


def _fits(model: Model, records: Records, runs: list[Trajectory], measured: Records) -> Iterator[str]:
    """Yield how the runs agree with every coordinate, where both are known."""
    offset = Sensors.of(model).offset
    for c in model.coordinates:
        pairs, k = list[tuple[FloatArray, FloatArray]](), model.states.index(c.name)
        for record, run in zip(records, runs, strict=True):
            for piece in measured:
                there = (piece.t >= run.t[0]) & (piece.t <= run.t[-1]) & (piece.counted(c.name) > 0.0)
                if piece.source == record.source and there.any():
                    seen = piece.column(c.name)[there]
                    simulated = np.interp(piece.t[there], run.t, run.states[:, k]) + offset[k]
                    pairs.append((seen, turned(simulated, seen) if c.angle else simulated))
        if pairs:
            yield f"{c.name}: {agreement(pairs).told(c.unit)}"


def _at_the_rows(result: Trajectory, run: Record, stamps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the times (n,) of the rows that a record was made of, in the file's order, and the states (n, m) there.

    Args:
        result: a free run on the record's regular times.
        run: the record.
        stamps: times of the rows of its recording.
    """
    own = stamps[_near(stamps, run, result.t[-1])]
    own = own if result.ended is None else own[own <= result.t[-1]]
    if len(result.t) < 2 or np.array_equal(own, result.t):
        return result.t, result.states
    from scipy.interpolate import CubicSpline

    states: FloatArray = CubicSpline(result.t - run.t[0], result.states)(own - run.t[0])
    return own, states


def _free_run(model: Model, run: Record, given: dict[str, float], sensors: Sensors) -> Trajectory:
    start: FloatArray
    start = np.empty(len(model.states)) if len(given) == len(model.states) else initial_state(model, run)
    for name, value in given.items():
        k = model.states.index(name)
        start[k] = sensors.state(k, value)
    inputs = np.array([run.column(i.name) for i in model.inputs]).reshape(len(model.inputs), len(run)).T
    return simulate(model, run.t, np.ascontiguousarray(inputs), start)
