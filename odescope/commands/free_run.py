"""Free runs of a model file over a data file: the simulate command."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError, nearest
from odescope.export.model_file import read_model
from odescope.model.initial_state import initial_state
from odescope.model.model import Model
from odescope.model.simulation import Trajectory, simulate
from odescope.recordings.layout import Layout
from odescope.recordings.readers import column_names, read_records, read_times
from odescope.recordings.record import Record

NEAR = 0.75  # sample periods from the regular times: rows of the next piece are further away
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

    There is one row for each row of the data, whatever its time stamp.

    Each recording starts from its own first sample: from the states given as NAME=VALUE, the rest fitted to the first
    stretch of the measured coordinates. Angles that were identified from degrees are read and written in degrees.

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
    known = model.provenance.get("degrees")
    degrees = frozenset(c.name for c in model.coordinates if isinstance(known, list) and c.name in known)
    layout = Layout(
        time=time,
        sample_period=sample_period,
        columns=columns,
        angles=frozenset(c.name for c in model.coordinates if c.angle and c.name in dict(columns)),
        degrees=degrees & set(dict(columns)),
        held=frozenset(i.name for i in model.inputs if i.hold == "zero"),
        inputs=frozenset(i.name for i in model.inputs),
        recording=recording,
    )
    records, stamps = read_records([data_path], layout), read_times(data_path, layout)
    out, notes = io.StringIO(), []
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow((*(() if recording is None else (recording,)), time or "t", *model.states))
    sensors = _Sensors.of(model, degrees)
    for run in records:
        label = () if recording is None else (_label(run, data_path, recording),)
        result = _free_run(model, run, given, sensors)
        own, states = _at_the_rows(result, run, stamps.get(run.source, run.t))
        for t, row in zip(own.tolist(), sensors.read(states).tolist(), strict=True):
            writer.writerow((*label, repr(t), *map(repr, row)))
        if result.ended:
            where = f" of recording {label[0]}" if label else ""
            notes.append(f"the free run{where} ended early, at {len(result.t)} of {len(run)} samples: {result.ended}")
    return out.getvalue(), notes


def _at_the_rows(result: Trajectory, run: Record, stamps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the times (n,) of the rows that a record was made of, in the file's order, and the states (n, m) there.

    Args:
        result: a free run on the record's regular times.
        run: the record.
        stamps: times of the rows of its recording.
    """
    near = NEAR * run.sample_period
    last = result.t[-1] + (near if result.ended is None else 0.0)
    own = stamps[(stamps >= run.t[0] - near) & (stamps <= last)]
    if len(result.t) < 2 or np.array_equal(own, result.t):
        return result.t, result.states
    from scipy.interpolate import CubicSpline

    states: FloatArray = CubicSpline(result.t - run.t[0], result.states)(own - run.t[0])
    return own, states


def _label(run: Record, data: Path, recording: str) -> str:
    """Return what the column `recording` says of a run: the reader leaves it in the run's source."""
    _, _, label = run.source.removeprefix(data.name).partition(f" ({recording} ")  # of a folder, the file is named
    return label.removesuffix(")")


@dataclass(frozen=True, eq=False)
class _Sensors:
    """What sensors read of states (n,): so much more, in units of so many radians or of one."""

    offset: FloatArray
    unit: FloatArray

    @staticmethod
    def of(model: Model, degrees: frozenset[str]) -> _Sensors:
        offsets = {c.name: c.offset for c in model.coordinates}
        turned = {s for c in model.coordinates if c.name in degrees for s in c.states}
        return _Sensors(
            np.array([offsets.get(s, 0.0) for s in model.states]),
            np.array([np.pi / 180.0 if s in turned else 1.0 for s in model.states]),
        )

    def read(self, states: FloatArray) -> FloatArray:
        found: FloatArray = (states + self.offset) / self.unit
        return found

    def state(self, k: int, reading: float) -> float:
        return float(reading * self.unit[k] - self.offset[k])


def _free_run(model: Model, run: Record, given: dict[str, float], sensors: _Sensors) -> Trajectory:
    start: FloatArray
    start = np.empty(len(model.states)) if len(given) == len(model.states) else initial_state(model, run)
    for name, value in given.items():
        k = model.states.index(name)
        start[k] = sensors.state(k, value)
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
