"""Reads recordings: CSV, Parquet and MATLAB files, at once or chunk by chunk, dataframes and plain arrays."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError, as_path
from odescope.files import shortest_ends
from odescope.recordings.chunks import Chunk, DataFile
from odescope.recordings.dates import in_zone, is_dates
from odescope.recordings.formats import FORMATS, PARQUET, opened
from odescope.recordings.frames import frame_columns
from odescope.recordings.layout import Layout
from odescope.recordings.record import Records, Stretch
from odescope.recordings.tables import check_rows, row_times, stretches

OF_FOLDERS = ((".csv", ".csv.gz"), (".tsv", ".tsv.gz"), (".mat",), (".txt", ".txt.gz"))  # of each the first there is


def read_records(files: Path | str | Sequence[Path | str], layout: Layout) -> Records:
    """Read one recording a file, or several by the layout's `recording` column, ready for use.

    Each is split or refused at gaps, its angles are unwrapped, its time made uniform. A folder stands for the data
    files in it.

    Raises:
        InputError: a file that is missing, unreadable, of another kind, or whose columns do not serve.
    """
    found = find_files(files)
    if not found:
        raise InputError("no data file: expected at least one")
    named = zip(found, shortest_ends(found), strict=True)
    return Records(tuple(s.record for file, source in named for s in _read_file(file, layout, source)))


def records_from(data: object, layout: Layout) -> Records:
    """Take recordings from a dataframe (Arrow interface), a mapping of name to array, or a list of these.

    Raises:
        InputError: columns that are missing, not numbers or of different length, and whatever read_records refuses.
    """
    tables = list(data) if isinstance(data, (list, tuple)) else [data]
    if not tables:
        raise InputError("no data: expected at least one table")
    sources = [f"table {k}" for k in range(1, len(tables) + 1)] if len(tables) > 1 else ["the data"]
    return Records(
        tuple(
            stretch.record
            for table, source in zip(tables, sources, strict=True)
            for stretch in stretches(frame_columns(table, layout, source), layout, source)
        )
    )


def read_chunk(chunk: Chunk, layout: Layout) -> tuple[Stretch, ...]:
    """Read the rows of a chunk, and no others, as records ready for use (see `odescope.recordings.tables`).

    Raises:
        InputError: the file is unreadable or no longer the one that was counted, its columns do not serve, or the rows
            of its recordings are mixed.
    """
    if chunk.whole:
        return _read_file(chunk.path, layout, chunk.source)
    with opened(chunk.path) as kind:
        assert kind.read_chunk is not None  # a file that is not divisible is one chunk
        columns = kind.read_chunk(chunk, layout)
    return tuple(stretches(columns, layout, chunk.source, chunk))


def _read_file(path: Path, layout: Layout, source: str) -> tuple[Stretch, ...]:
    with opened(path) as kind:
        columns = kind.read(path, layout)
    return tuple(stretches(columns, layout, source))


def read_times(file: Path, layout: Layout) -> dict[str, FloatArray]:
    """Return the times (n,) of the rows of each recording as the file has them, by the source of its records.

    Rows without a time are left out.

    Raises:
        InputError: the file is unreadable, or its columns do not serve.
    """
    found: dict[str, FloatArray] = {}
    files = find_files([file])
    for path, named in zip(files, shortest_ends(files), strict=True):
        with opened(path) as kind:
            columns = kind.read(path, layout)
        for source, t in row_times(columns, layout, named):
            found[source] = np.concatenate([found[source], t]) if source in found else t
    return found


def date_zone(file: Path, label: str) -> bool | None:
    """Return whether the dates in a column of the time name their zone; None where that holds numbers.

    Args:
        file: or a folder, whose first file is looked at.
        label: of the column.

    Raises:
        InputError: the file is unreadable, or has no such column.
    """
    path = find_files([file])[0]
    with opened(path) as kind:
        column = kind.read(path, Layout(time=label, columns=((label, label),)))[label]
    return in_zone(column) if is_dates(column) else None


def survey(path: Path, layout: Layout) -> DataFile:
    """Count the rows of a data file and find where they are, in little memory.

    No number is parsed, but for those that tell the decimal mark of a text file with semicolons.

    Raises:
        InputError: the file is missing, unreadable, of no known kind or without rows of data, lacks a column, or has
            blank lines between samples that only a sample period tells apart.
    """
    with opened(path) as kind:
        file = kind.survey(path, layout)
    check_rows(file.rows, path.name)
    return file


def column_names(path: Path | str) -> tuple[str, ...]:
    """Return the names of the columns of a data file, or of the first one in a folder.

    Raises:
        InputError: the file is missing, empty, of no known kind or damaged.
    """
    file = find_files([path])[0]
    with opened(file) as kind:
        return tuple(kind.names(file))


def find_files(files: Path | str | Sequence[Path | str]) -> tuple[Path, ...]:
    """Return the files, in order of their paths: of a folder the data files in it, of a pattern those that match.

    Of a folder those are the Parquet files in it and in the folders in it, or, where there are none, the files in
    itself of the first kind of `OF_FOLDERS` that there is. In a name, * stands for anything and ? for one character; a
    file that is really called so is meant itself. What begins with "_" or "." in a folder is left out, as whoever
    writes such a dataset puts notes there.

    Raises:
        InputError: a folder without data files, a pattern that no file matches, what is no path.
    """
    listed = files if isinstance(files, Sequence) and not isinstance(files, str) else [files]
    named = (file for path in listed for file in _matching(as_path(path, "a data file")))
    return tuple(file for path in named for file in (_dataset(path) if path.is_dir() else (path,)))


def _matching(path: Path) -> list[Path]:
    if not any(sign in path.name for sign in "*?"):
        return [path]
    found = matches(path)
    if not found:
        raise InputError(f"no file matches {path.name!r} in {path.parent}")
    return found


def matches(path: Path) -> list[Path]:
    """Return the files that a path or a pattern stands for, in order; none where there are none."""
    if path.exists():
        return [path]
    return sorted(path.parent.glob(re.sub(r"\*+", "*", path.name)))  # of "**" pathlib makes folders, or an error


def _dataset(folder: Path) -> list[Path]:
    files: list[Path] = []
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(("_", "."))]  # the walk goes only into these
        files += [Path(place, name) for name in names if name.lower().endswith(PARQUET.endings) and name[0] not in "_."]
    # Those of other kinds in folders below may be anything, such as the results of a run, and a .txt may be a note.
    for endings in OF_FOLDERS:
        files = files or [f for f in folder.iterdir() if f.name.lower().endswith(endings) and f.name[0] not in "_."]
    if not files:
        known = ", ".join(ending for kind in FORMATS for ending in kind.endings)
        raise InputError(f"{folder} is a directory without data files ({known})")
    return sorted(files)
