"""The kinds of data files: what each can be asked, and which serves a file."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from odescope.errors import InputError
from odescope.recordings.chunks import Chunk, DataFile
from odescope.recordings.columns import Columns, check_columns, first_line
from odescope.recordings.layout import Layout
from odescope.recordings.matlab_files import matlab_names, read_matlab, survey_matlab
from odescope.recordings.parquet_files import (
    parquet_names,
    read_parquet,
    read_parquet_chunk,
    read_parquet_head,
    survey_parquet,
)
from odescope.recordings.text_files import (
    head_of,
    index_rows,
    read_columns,
    read_loosely,
    refuse_blank_lines,
    settle_decimal,
)
from odescope.recordings.text_headers import TextFile, read_header

SHEETS = (".xlsx", ".xls", ".xlsm", ".ods", ".numbers")


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes:
        endings: of the names of its files.
        names: of the columns of a file.
        survey: the rows of a file, without parsing its numbers.
        read: the used columns of a whole file.
        read_head: those of its first rows.
        read_chunk: those of a chunk; None where files can only be read whole.
    """

    endings: tuple[str, ...]
    names: Callable[[Path], Sequence[str]]
    survey: Callable[[Path, Layout], DataFile]
    read: Callable[[Path, Layout], Columns]
    read_head: Callable[[Path, Layout], Columns]
    read_chunk: Callable[[Chunk, Layout], Columns] | None = None


def _header(path: Path, layout: Layout) -> TextFile:
    """Return what the header of a text file says; InputError where it lacks a column."""
    file = read_header(path)
    check_columns(layout.used, file.names, path.name)
    return file


def _survey_text(path: Path, layout: Layout) -> DataFile:
    text = _header(path, layout)
    index = index_rows(text, blanks=layout.time is not None)
    if not len(index.marks):
        return DataFile(path, index.rows, divisible=False)
    return DataFile(path, index.rows, True, settle_decimal(text, index, layout.numeric), index)


def _read_text(path: Path, layout: Layout) -> Columns:
    file = _header(path, layout)
    if layout.time is None:
        refuse_blank_lines(file)
    return _columns(file, layout)


def _columns(file: TextFile, layout: Layout) -> Columns:
    """Return the used columns of a text file, or of a part of one."""
    loose = [label for label in layout.numeric if label in layout.loose]
    strict = [label for label in layout.used if label not in loose]
    numeric = [label for label in layout.numeric if label in strict]
    time = layout.time if layout.time in strict else None
    return read_loosely(file, loose) | (read_columns(file, strict, numeric, time) if strict else {})


def _read_text_head(path: Path, layout: Layout) -> Columns:
    return _columns(head_of(_header(path, layout)), layout)


def _read_text_chunk(chunk: Chunk, layout: Layout) -> Columns:
    assert chunk.text is not None  # cut gives every chunk of a text file one
    columns = _columns(chunk.text, layout)
    start, stop = chunk.window
    return {label: column.slice(start - chunk.text.first, stop - start) for label, column in columns.items()}


TEXT = Format(
    (".csv", ".txt", ".tsv", ".csv.gz", ".txt.gz", ".tsv.gz"),
    lambda path: read_header(path).names,
    _survey_text,
    _read_text,
    _read_text_head,
    _read_text_chunk,
)
PARQUET = Format(
    (".parquet", ".pq"), parquet_names, survey_parquet, read_parquet, read_parquet_head, read_parquet_chunk
)
MATLAB = Format((".mat",), matlab_names, survey_matlab, read_matlab, read_matlab)
FORMATS = (TEXT, PARQUET, MATLAB)


@contextmanager
def opened(path: Path) -> Iterator[Format]:
    """Yield the format of a data file; what reading it raises inside is worded for the user.

    Raises:
        InputError: the file is missing, empty, of no known kind or damaged.
    """
    import pyarrow as pa

    found = next((kind for kind in FORMATS if path.name.lower().endswith(kind.endings)), None)
    if path.is_dir():
        raise InputError(f"{path} is a directory, expected a data file")
    if not path.exists():
        raise InputError(f"no such file: {path}")
    if found is None:
        known = ", ".join(ending for kind in FORMATS for ending in kind.endings)
        sheet = "; save the sheet as CSV" if path.name.lower().endswith(SHEETS) else ""
        raise InputError(f"{path.name} is of no known kind; expected one of {known}{sheet}")
    if not path.stat().st_size:
        raise InputError(f"{path.name} is empty")
    try:
        yield found
    except (pa.ArrowException, OSError, EOFError, csv.Error) as error:
        raise InputError(f"{path.name} cannot be read: {first_line(error)}") from error
