"""A study meets the headings of a table: its labels become those of the columns, units in headings are taken over."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import TypeAlias, cast

import msgspec

from odescope.arrays import Table
from odescope.errors import InputError
from odescope.recordings.checks import is_degrees, units_differ
from odescope.recordings.frames import table_names
from odescope.recordings.headings import (
    UNITS_OF_TIME,
    Heading,
    doubtful_time_unit,
    find_label,
    named_time_unit,
    time_unit,
    told_in_seconds,
)
from odescope.recordings.readers import column_names, find_files
from odescope.recordings.record import Records
from odescope.study.options import Driven, Measured, Study

InMemory: TypeAlias = Records | Table | Sequence[Table] | None


def settled_columns(study: Study, data: InMemory | Path | str | Sequence[Path | str]) -> tuple[Study, InMemory]:
    """Return a study with the labels that its columns have in the data, and the units that stand there in brackets.

    Paths take the place of the study's files; what is in memory stays as it is. What a study says of a unit stays. A
    label that is not there stays, too: reading the data tells what there is.

    Args:
        study: may name a column "x (m)" or x.
        data: recordings in memory, paths, or None for the study's files.

    Raises:
        InputError: two columns may be meant by a label, two names read one column, or there is no file.
    """
    listed = list(data) if isinstance(data, (list, tuple)) else [data]
    paths = [os.fspath(path) for path in listed if isinstance(path, (str, PathLike))]
    if paths and len(paths) == len(listed):
        study = msgspec.structs.replace(study, data=msgspec.structs.replace(study.data, files=tuple(paths)))
        return settled_columns(study, None)
    if data is None and study.data.files:
        file = find_files(study.data.files)[0]
        return with_labels(study, column_names(file), file.name), None
    in_memory = cast("InMemory", data)  # or anything else, which reading it refuses
    labels = () if isinstance(data, Records) or not listed else table_names(listed[0])
    return with_labels(study, labels, "the data") if labels else study, in_memory


def with_labels(study: Study, labels: Sequence[str], source: str) -> Study:
    """Return a study as `settled_columns`, given the labels of the columns.

    Args:
        study: may name a column "x (m)" or x.
        labels: of the columns.
        source: where these are, for messages.
    """
    own = study.data
    named = (own.time, own.date, own.recording)
    time, date, recording = (name and (find_label(name, labels, source) or name) for name in named)
    unit = own.time_unit or (None if time is None else time_unit(time))
    data = msgspec.structs.replace(own, time=time, date=date, recording=recording, time_unit=unit)
    coordinates = {name: _measured(name, c, labels, source) for name, c in study.coordinates.items()}
    inputs = {name: _driven(name, i, labels, source) for name, i in study.inputs.items()}
    readers: dict[str, str] = {}
    columns = [(n, c.column) for n, c in coordinates.items()]
    columns += [(n, i.column) for n, i in inputs.items() if not isinstance(i.column, tuple)]
    for name, column in columns:
        label = column or name
        if label in readers and label in labels:
            raise InputError(
                f"{readers[label]!r} and {name!r} both read the column {label!r} in {source}: leave one out"
            )
        readers[label] = name
    return msgspec.structs.replace(study, data=data, coordinates=coordinates, inputs=inputs)


def converted(study: Study) -> list[str]:
    """Return which columns are in other units here than they were recorded in."""
    unit = study.data.time_unit
    times = [] if unit in (None, "s") else [told_in_seconds(unit)]
    angles = [f"{name} was recorded in degrees: here it is in radians" for name in sorted(study.degrees)]
    stay = list(_staying_in_degrees(study)) if angles else []
    if stay:
        verb = "stays" if len(stay) == 1 else "stay"
        angles.append(f"{', '.join(stay)} {verb} in degrees: only coordinates that are angles are converted")
    return [*times, *angles]


def _staying_in_degrees(study: Study) -> Iterator[str]:
    """Yield the inputs, and the coordinates that are no angles, that were recorded in degrees by unit or heading."""
    coordinates = [(name, c.column, c.unit) for name, c in study.coordinates.items() if not c.angle]
    inputs = [(n, i.column, i.unit) for n, i in study.inputs.items() if not isinstance(i.column, tuple)]
    for name, column, unit in (*coordinates, *inputs):
        if is_degrees(Heading.of(column or name).unit if unit is None else unit):
            yield name


def doubted_headings(study: Study) -> tuple[str, ...]:
    """Return a sentence for each unit of a study, as settled, that is not the one that its heading seems to say."""
    own = study.data
    said = []
    if own.time is not None and (headed := time_unit(own.time)) not in (None, own.time_unit):
        said.append(f"the heading {own.time!r} says {headed}, and the study {own.time_unit or 's'}, which was believed")
    if own.time is not None and own.time_unit is None and (word := doubtful_time_unit(own.time)) is not None:
        meant = named_time_unit(word)
        say = f"one of {', '.join(UNITS_OF_TIME)}"
        say = say if meant is None else f'as "{meant}" if it means that, or "s" (or head the column time ({meant}))'
        said.append(
            f"the heading {own.time!r} says {word}, which is taken for no unit of time: numbers there are read as"
            f" seconds; say which they are by time_unit in [data], or --time-unit, {say}"
        )
    measured = [(c.column or name, c.unit) for name, c in study.coordinates.items()]
    driven = [(i.column or name, i.unit) for name, i in study.inputs.items() if not isinstance(i.column, tuple)]
    for label, unit in (*measured, *driven):
        there = Heading.of(label).unit
        if units_differ(there, unit):
            said.append(
                f"the heading {label!r} says {there}, and the study {unit}: values are as in the file, in {there} if"
                " the heading is right"
            )
    return tuple(said)


def _label(name: str, column: str | None, labels: Sequence[str], source: str) -> tuple[str | None, str | None]:
    """Return the label of a column, None where it is as the study says, and the unit in its heading."""
    found = find_label(column or name, labels, source)
    return (column, None) if found is None else (column if found == (column or name) else found, Heading.of(found).unit)


def _measured(name: str, c: Measured, labels: Sequence[str], source: str) -> Measured:
    label, unit = _label(name, c.column, labels, source)
    return msgspec.structs.replace(c, column=label, unit=unit if c.unit is None else c.unit)


def _driven(name: str, i: Driven, labels: Sequence[str], source: str) -> Driven:
    if isinstance(i.column, tuple):  # each is settled where it is tried
        return i
    label, unit = _label(name, i.column, labels, source)
    return msgspec.structs.replace(i, column=label, unit=unit if i.unit is None else i.unit)
