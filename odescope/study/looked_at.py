"""The rows of a data file that a study is drafted from: all of a short log, parts evenly spread over a long one."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.recordings.chunks import Chunk, cut
from odescope.recordings.columns import Columns, times
from odescope.recordings.dates import is_dates
from odescope.recordings.formats import Format
from odescope.recordings.layout import Layout
from odescope.recordings.readers import survey

MOST_ROWS = 800_000  # that are looked at one and all
PARTS, PART_ROWS = 8, 50_000  # of a longer log


@dataclass(frozen=True, eq=False)
class ReadColumn:
    """The numbers (N,) in a column, and whether they are dates; `refusal` says what one of something else holds."""

    values: FloatArray
    dated: bool
    refusal: str = ""


def looked_at(file: Path, label: str) -> tuple[Chunk, ...]:
    """Return the parts of a data file that are looked at: the whole where it is short, or can only be read whole.

    Args:
        file: of data.
        label: of any column.

    Raises:
        InputError: the file cannot be read, or holds no rows.
    """
    found = survey(file, Layout(time=label, columns=(("column", label),)))
    if found.rows <= MOST_ROWS or not found.divisible:
        return cut(found, found.rows)
    parts = cut(found, PART_ROWS)
    return tuple(parts[k] for k in np.linspace(0, len(parts) - 1, PARTS).round().astype(int).tolist())


def column_of(kind: Format, chunks: Sequence[Chunk], label: str) -> ReadColumn:
    """Return a column of numbers or dates in some parts of a file.

    Args:
        kind: of the file.
        chunks: the parts.
        label: of the column.
    """
    found = []
    for chunk in chunks:
        read = kind.read if chunk.whole or kind.read_chunk is None else partial(_of_chunk, kind.read_chunk, chunk)
        own = read_column(read, chunk.path, label)
        if own.refusal:
            return own
        found.append(own)
    return ReadColumn(np.concatenate([own.values for own in found]), any(own.dated for own in found))


def _of_chunk(read_chunk: Callable[[Chunk, Layout], Columns], chunk: Chunk, _: Path, layout: Layout) -> Columns:
    return read_chunk(chunk, layout)


def read_column(read: Callable[[Path, Layout], Columns], file: Path, label: str) -> ReadColumn:
    """Return a column of numbers or dates.

    Args:
        read: what reads it, from the whole file or its head.
        file: of data.
        label: of the column.
    """
    layout = Layout(time=label, columns=(("column", label),))
    try:
        column = read(file, layout)[label]
        return ReadColumn(times(column, layout, file.name), is_dates(column))
    except InputError as error:
        # How many such cells there are depends on how much of the file was read.
        said = re.sub(r" and \d+ more", " and others", str(error).removeprefix(f"column {label!r} in {file.name} "))
        return ReadColumn(np.empty(0), False, said)
