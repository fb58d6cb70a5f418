"""The recordings that a model is run on: their columns in a file, and what to say where these are missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError, nearest
from odescope.model.model import Model
from odescope.recordings.layout import Layout
from odescope.recordings.readers import column_names, find_files, read_records
from odescope.recordings.record import Record, Records

TIME_NAMES = ("t", "time", "Time", "T", "TIME")


@dataclass(frozen=True)
class TimeColumns:
    """Where a command line says that the time is, and what tells recordings apart; None where it says nothing."""

    time: str | None = None
    sample_period: float | None = None
    recording: str | None = None


def model_columns(model: Model) -> dict[str, str]:
    """Return the column of every coordinate and input: as when the model was identified, else its own name."""
    known = model.provenance.get("columns")
    place = known if isinstance(known, dict) else {}
    names = [c.name for c in model.coordinates] + [i.name for i in model.inputs]
    return {name: column if isinstance(column := place.get(name), str) else name for name in names}


def lacking_columns(names: Sequence[str], model: Model, files: Sequence[Path]) -> list[str]:
    """Return the columns of some coordinates or inputs that the first file has not.

    Args:
        names: of coordinates or inputs.
        model: whose they are.
        files: data.
    """
    there, place = column_names(files[0]), model_columns(model)
    return [place[name] for name in names if place[name] not in there]


def read_for(model: Model, files: Sequence[Path], given: TimeColumns, names: Sequence[str]) -> Records:
    """Return the recordings in some files.

    Args:
        model: whose columns are meant.
        files: data.
        given: where the time is; by default as identified, else t, time and the like.
        names: coordinates and inputs that are wanted.

    Raises:
        InputError: a file cannot be read, or columns are missing: all of them are named.
    """
    files = find_files(files)
    return read_records(files, layout_for(model, files, given, names))


def layout_for(model: Model, files: Sequence[Path], given: TimeColumns, names: Sequence[str]) -> Layout:
    """Return how some files are read for a model.

    Args:
        model: whose columns are meant.
        files: data.
        given: where the time is; by default as identified, else t, time and the like.
        names: coordinates and inputs that are wanted.

    Raises:
        InputError: columns are missing: all of them are named.
    """
    place = model_columns(model)
    for file in files:
        lacking = lacking_columns(names, model, [file])
        if lacking:
            there = column_names(file)
            inputs = {place[i.name] for i in model.inputs}
            roles = " and ".join(f"{c!r} is {'an input' if c in inputs else 'a coordinate'}" for c in lacking)
            hint = nearest(lacking[0], there) if len(lacking) == 1 else f"its columns are {', '.join(there)}"
            raise InputError(f"no column {', '.join(map(repr, lacking))} in {file.name}: {roles} of the model; {hint}")
    return Layout(
        time=_time_column(model, files[0], given),
        sample_period=given.sample_period,
        columns=tuple((name, place[name]) for name in names),
        angles=frozenset(c.name for c in model.coordinates if c.angle and c.name in names),
        degrees=_in_degrees(model) & set(names),
        held=frozenset(i.name for i in model.inputs if i.hold == "zero" and i.name in names),
        inputs=frozenset(i.name for i in model.inputs if i.name in names),
        recording=given.recording,
    )


def _in_degrees(model: Model) -> frozenset[str]:
    """Return the angles that were recorded in degrees when the model was identified."""
    known = model.provenance.get("degrees")
    return frozenset(c.name for c in model.coordinates if isinstance(known, list) and c.name in known)


def label_of(run: Record, files: Sequence[Path], recording: str) -> str:
    """Return what the column `recording` says of a run: the reader leaves it in the run's source.

    Args:
        run: that was read.
        files: it was read from one of them; of a folder, the file is named.
        recording: the column.
    """
    source = run.source
    for file in files:
        source = source.removeprefix(file.name)
    return source.partition(f" ({recording} ")[2].removesuffix(")")


def named_numbers(option: str, texts: Sequence[str], known: Sequence[str], what: str) -> dict[str, float]:
    """Return the numbers of options NAME=NUMBER by name.

    Args:
        option: as it is spelled.
        texts: what came after each.
        known: the names that there are.
        what: one of them is.

    Raises:
        InputError: a name that is not known or given twice, or no finite number.
    """
    given: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        name = name.strip()
        if name in given:
            raise InputError(f"{option} {name} is given twice")
        if name not in known:
            raise InputError(f"{option} {text}: {name!r} is no {what} of the model; {nearest(name, known)}")
        try:
            given[name] = float(value)
        except ValueError:
            raise InputError(f"{option} {text}: expected {what.upper()}=NUMBER, such as {name}=0.5") from None
        if not np.isfinite(given[name]):
            raise InputError(f"{option} {text}: the number must be finite")
    return given


def time_name(model: Model, data: Path, given: TimeColumns) -> str:
    """Return what the column of time is called in results: as in the data, else t.

    Args:
        model: that was identified with some column.
        data: a file.
        given: by the command line.
    """
    return _time_column(model, data, given) or "t"


@dataclass(frozen=True, eq=False)
class Sensors:
    """What sensors read of states (n,): `offset` more, in units of `unit` radians or of one."""

    offset: FloatArray
    unit: FloatArray

    @staticmethod
    def of(model: Model) -> Sensors:
        """Return the sensors of a model's states, those of angles in degrees where it was identified from such."""
        more = {c.name: c.offset for c in model.coordinates}
        degrees = _in_degrees(model)
        angular = {s for c in model.coordinates if c.name in degrees for s in c.states}
        return Sensors(
            np.array([more.get(s, 0.0) for s in model.states]),
            np.array([np.pi / 180.0 if s in angular else 1.0 for s in model.states]),
        )

    def read(self, states: FloatArray) -> FloatArray:
        """Return the readings of states (N, n)."""
        found: FloatArray = (states + self.offset) / self.unit
        return found

    def state(self, k: int, reading: float) -> float:
        """Return the k-th state from its reading."""
        return float(reading * self.unit[k] - self.offset[k])


def _time_column(model: Model, data: Path, given: TimeColumns) -> str | None:
    """Return the column that holds the time, None where a sample period stands for it."""
    if given.sample_period is not None or given.time is not None:
        return given.time
    known = model.provenance.get("time")
    there = column_names(data)
    for name in (known, *TIME_NAMES):
        if isinstance(name, str) and name in there:
            return name
    raise InputError(
        f"{data.name} has no column called t or time; name it with --time, or give --sample-period. Its columns are"
        f" {', '.join(there)}"
    )
