"""The recordings that a model is run on: as it was identified from them, or as their columns are headed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from odescope.errors import InputError, nearest, said
from odescope.model.model import Model
from odescope.recordings.checks import differently_scaled, is_angular, is_degrees, of_other_kinds
from odescope.recordings.formats import PARQUET
from odescope.recordings.frames import table_names
from odescope.recordings.headings import UNITS_OF_TIME, Heading, TimeUnit, find_label, time_unit
from odescope.recordings.layout import Layout
from odescope.recordings.parquet_files import folder_labels
from odescope.recordings.readers import column_names, find_files, read_records, records_from
from odescope.recordings.record import Record, Recorded, Records

ROWS = "rows"  # what records of nothing but their times call them
TIME_NAMES = ("t", "time", "Time", "T", "TIME")


@dataclass(frozen=True)
class TimeColumns:
    """Where it is said that the time is, and what tells recordings apart; None where nothing is said."""

    time: str | None = None
    sample_period: float | None = None
    recording: str | None = None


UNSAID = TimeColumns()


def records_for(model: Model, data: Recorded, given: TimeColumns = UNSAID) -> Records:
    """Return recordings with the coordinates and the inputs of a model.

    Args:
        model: whose columns are meant.
        data: recordings as they are, tables or files; of the latter columns are found as the model was identified.
        given: where the time is; by default as identified, else t, time and the like.

    Raises:
        InputError: the data are none of these, cannot be read, or lack columns.
    """
    if isinstance(data, (Record, Records)):
        return Records.of(data)
    alone = isinstance(data, (str, PathLike, Mapping)) or hasattr(data, "__arrow_c_stream__")
    parts: list[object] = [data] if alone else list(data) if isinstance(data, Iterable) else []
    runs = [part for part in parts if isinstance(part, Record)]
    files = [Path(part) for part in parts if isinstance(part, (str, PathLike))]
    tables = [part for part in parts if isinstance(part, Mapping) or hasattr(part, "__arrow_c_stream__")]
    names = [c.name for c in model.coordinates] + [i.name for i in model.inputs]
    if parts and len(runs) == len(parts):
        return Records(tuple(runs))
    if parts and len(files) == len(parts):
        return read_for(model, files, given, names)
    if not parts or len(tables) < len(parts):
        raise InputError(
            f"data must be records, dataframes, dicts of columns, or paths of files, of one kind; {said(data)} came"
        )
    sources = [f"table {k}" for k in range(1, len(tables) + 1)] if len(tables) > 1 else ["the data"]
    labels = [TableLabels(table_names(table), source) for table, source in zip(tables, sources, strict=True)]
    return records_from(tables, _layout(model, labels, given, names))


@dataclass(frozen=True)
class TableLabels:
    """The labels of the columns of a table, where it came from, for messages, and the keys of folders KEY=VALUE."""

    labels: tuple[str, ...]
    source: str
    keys: tuple[str, ...] = ()


def model_columns(model: Model) -> dict[str, str]:
    """Return the column of every coordinate and input: as when the model was identified, else its own name."""
    known = model.provenance.get("columns")
    place = known if isinstance(known, dict) else {}
    names = [c.name for c in model.coordinates] + [i.name for i in model.inputs]
    return {name: column if isinstance(column := place.get(name), str) else name for name in names}


def clocks(model: Model) -> frozenset[str]:
    """Return the inputs of a model that are the time."""
    place, time = model_columns(model), model.provenance.get("time")
    return frozenset(i.name for i in model.inputs if place[i.name] == time)


def lacking_columns(names: Sequence[str], model: Model, files: Sequence[Path]) -> list[str]:
    """Return the columns of some coordinates or inputs that the first file has not.

    Args:
        names: of coordinates or inputs.
        model: whose they are.
        files: data.
    """
    place, table = model_columns(model), _of_file(files[0])
    return [place[name] for name in names if _label(name, place, table) is None]


def read_for(model: Model, files: Sequence[Path], given: TimeColumns, names: Sequence[str]) -> Records:
    """Return the recordings in some files.

    Args:
        model: whose columns are meant.
        files: data.
        given: where the time is; by default as identified, else t, time and the like.
        names: coordinates and inputs that are wanted; where there are none, the records hold the times of their rows.

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
    return _layout(model, [_of_file(file) for file in files], given, names)


def time_label(model: Model, file: Path, given: TimeColumns) -> str | None:
    """Return the column of a file that holds the time, None where a sample period stands for it.

    Args:
        model: that was identified with some column.
        file: of data.
        given: where the time is said to be.
    """
    return _time_label(model, _of_file(file), given)


def time_unit_of(model: Model, file: Path, given: TimeColumns) -> TimeUnit:
    """Return the unit of the times in a file.

    Args:
        model: that was identified with some column.
        file: of data.
        given: where the time is said to be.
    """
    label = time_label(model, file, given)
    return "s" if label is None else _time_unit(model, label)


def in_degrees(model: Model) -> frozenset[str]:
    """Return the angles that were recorded in degrees when the model was identified."""
    known = model.provenance.get("degrees")
    return frozenset(c.name for c in model.coordinates if isinstance(known, list) and c.name in known)


def _of_file(file: Path) -> TableLabels:
    first = find_files([file])[0]
    keys = folder_labels(first) if first.name.lower().endswith(PARQUET.endings) else {}
    return TableLabels(column_names(first), file.name, tuple(keys))


def _layout(model: Model, tables: Sequence[TableLabels], given: TimeColumns, names: Sequence[str]) -> Layout:
    for table in tables:
        _check_complete(model, table, given, names)
    first = tables[0]
    place = _places(model, first, given)
    time, day = _time_label(model, first, given), model.provenance.get("date")
    labels = {name: _label(name, place, first) or place[name] for name in names} or _rows_alone(model, first, given)
    _check_units(model, labels)
    angles = frozenset(c.name for c in model.coordinates if c.angle and c.name in names)
    beside = isinstance(day, str) and time is not None and time == model.provenance.get("time")
    return Layout(
        time=time,
        date=find_label(str(day), first.labels, first.source) if beside else None,
        sample_period=_known_period(model) if given.sample_period is None and time is None else given.sample_period,
        columns=tuple(labels.items()),
        angles=angles,
        degrees=frozenset(name for name in angles if _reads_degrees(model, name, labels[name])),
        held=frozenset(i.name for i in model.inputs if i.hold == "zero" and i.name in names),
        inputs=frozenset(i.name for i in model.inputs if i.name in names),
        recording=_recording(model, first, given),
        time_unit="s" if time is None else _time_unit(model, time),
    )


def _rows_alone(model: Model, table: TableLabels, given: TimeColumns) -> dict[str, str]:
    """Return a column for a run that needs none, since nothing drives it: the time, else the first that is there."""
    recording = _recording(model, table, given)
    others = [label for label in table.labels if label != recording]
    return {ROWS: _time_label(model, table, given) or (others or list(table.labels))[0]}


def recording_column(model: Model, file: Path, given: TimeColumns) -> str | None:
    """Return the column of a file that tells recordings apart: as is said, else as identified where it is there.

    Args:
        model: that knows where it was.
        file: of data.
        given: what is said.
    """
    return given.recording or _recording(model, _of_file(file), given)


def _recording(model: Model, table: TableLabels, given: TimeColumns) -> str | None:
    if given.recording is not None:
        return find_label(given.recording, table.labels, table.source) or given.recording
    known = model.provenance.get("recording")
    return known if isinstance(known, str) and known in (*table.labels, *table.keys) else None


def _places(model: Model, table: TableLabels, given: TimeColumns) -> dict[str, str]:
    """Return the column of every coordinate and input; that of the time, which a table may call otherwise, is its own.

    Raises:
        InputError: the model holds the time, and the table has it in another unit.
    """
    place = model_columns(model)
    for name in clocks(model):
        if (time := _time_label(model, table, given)) is not None:
            if (unit := _time_unit(model, time)) != "s":
                raise InputError(
                    f"the model holds the time, {name}, in seconds, and {time!r} in {table.source} is in {unit}:"
                    " name or add a column in seconds"
                )
            place[name] = time
    return place


def _check_complete(model: Model, table: TableLabels, given: TimeColumns, names: Sequence[str]) -> None:
    """Refuse a table without columns that are wanted; all of them are named."""
    place = _places(model, table, given)
    lacking = [place[name] for name in names if _label(name, place, table) is None]
    if lacking:
        inputs = {place[i.name] for i in model.inputs}
        roles = " and ".join(f"{c!r} is {'an input' if c in inputs else 'a coordinate'}" for c in lacking)
        hint = nearest(lacking[0], table.labels) if len(lacking) == 1 else f"its columns are {', '.join(table.labels)}"
        listed = ", ".join(map(repr, lacking))
        raise InputError(f"no column {listed} in {table.source}: {roles} of the model; {hint}")


def _check_units(model: Model, labels: Mapping[str, str]) -> None:
    """Refuse columns that are headed with another unit than their quantities have in the model, for sure.

    The one that the model was identified from is read as it was then; angles are, in degrees or radians.
    """
    known = model.provenance.get("columns")
    units = {c.name: c.unit for c in model.coordinates} | {i.name: i.unit for i in model.inputs}
    angles = {c.name for c in model.coordinates if c.angle}
    for name, unit in units.items():
        label = labels.get(name, "")
        headed = Heading.of(label).unit
        as_then = isinstance(known, dict) and known.get(name) == label
        if as_then or (name in angles and (is_degrees(headed) or is_angular(headed))):
            continue
        own = unit or ("rad" if name in angles else None)
        if not (differently_scaled(headed, own) or of_other_kinds(headed, own)):
            continue
        raise InputError(
            f"{name} of the model is in {own}, and the heading {label!r} says {headed}: convert the column, or take the"
            f" unit out of its heading; if it holds something else, name the column of {name} so"
        )


def _label(name: str, place: Mapping[str, str], table: TableLabels) -> str | None:
    """Return the label of a coordinate's or input's column: as when the model was identified, else by its own name."""
    found = find_label(place[name], table.labels, table.source)
    return found or find_label(name, table.labels, table.source)


def _time_label(model: Model, table: TableLabels, given: TimeColumns) -> str | None:
    if given.sample_period is not None:
        return given.time
    if given.time is not None:
        return find_label(given.time, table.labels, table.source) or given.time
    known = model.provenance.get("time")
    for name in (known, *TIME_NAMES):
        if isinstance(name, str) and (found := find_label(name, table.labels, table.source)):
            return found
    if _known_period(model) is not None:
        return None
    raise InputError(
        f"{table.source} has no column called t or time; name it with --time, or give --sample-period. Its columns are"
        f" {', '.join(table.labels)}"
    )


def _known_period(model: Model) -> float | None:
    """Return the sampling period that a study gave, in seconds, where no column held the time."""
    known = model.provenance.get("sample_period")
    return known if isinstance(known, float) and known > 0.0 else None


def _reads_degrees(model: Model, name: str, label: str) -> bool:
    """Say whether a column holds an angle in degrees: as the model was identified where it is the same, else as headed.

    What a study said of the unit stood above the heading, and the same column is not to be read in two ways.
    """
    known, columns = name in in_degrees(model), model.provenance.get("columns")
    if isinstance(columns, dict) and columns.get(name) == label:
        return known
    unit = Heading.of(label).unit
    return is_degrees(unit) or (known and unit != "rad")


def _time_unit(model: Model, label: str) -> TimeUnit:
    """Return the unit of a column of time: as the model was identified where it is the same, else as it is headed."""
    known = model.provenance.get("time_unit") if label == model.provenance.get("time") else None
    headed = time_unit(label) or "s"
    return next((unit for unit in UNITS_OF_TIME if unit == known), headed)
