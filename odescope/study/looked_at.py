"""The rows of data files that a study is drafted from: all of short logs, parts evenly spread over a long one."""

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
from odescope.recordings.formats import Format, opened
from odescope.recordings.layout import Layout
from odescope.recordings.readers import column_names, survey
from odescope.recordings.text_files import NotNumbersError

MOST_ROWS = 800_000  # that are looked at one and all
LEAST_NUMBERS = 2  # of a column in a file that is looked at beside another
MOSTLY = 0.9  # of the cells of a column are numbers: then it holds numbers, and the others are faults
PARTS, PART_ROWS = 8, 50_000  # of a longer log


@dataclass(frozen=True, eq=False)
class ReadColumn:
    """The numbers (N,) in a column, and whether they are dates; `refusal` says what one of something else holds.

    `faults` says which cells among numbers are none, `share` how many of those that a refused column holds are.
    """

    values: FloatArray
    dated: bool
    refusal: str = ""
    faults: str = ""
    share: float = 0.0

    @property
    def serves(self) -> bool:
        """Whether it holds numbers enough to be looked at."""
        return not self.refusal and int(np.count_nonzero(np.isfinite(self.values))) >= LEAST_NUMBERS


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


def columns_of(files: Sequence[Path], labels: Sequence[str]) -> tuple[tuple[Chunk, ...], dict[str, ReadColumn]]:
    """Return the parts of data files that are looked at, and the columns of numbers or dates in these, by their labels.

    With the first, if it is short, these are the others that have what it has, up to `MOST_ROWS` rows in all: what one
    experiment does not show another may, as a temperature that is constant in each. Of a file that lacks something the
    reading of the study tells.

    Args:
        files: of data, the first of which is looked at in any case.
        labels: of its columns.

    Raises:
        InputError: a file cannot be read, or holds no rows.
    """
    chunks = looked_at(files[0], labels[0])
    rows, found = chunks[0].stop, [_columns_in(chunks, labels)]
    for file in files[1:] if chunks[0].whole else ():
        if not set(column_names(file)) >= set(labels):
            continue
        more = looked_at(file, labels[0])
        rows += more[0].stop
        if rows > MOST_ROWS or not more[0].whole:
            break
        own = _columns_in(more, labels)
        if all((own[label].serves and not own[label].faults) or not first.serves for label, first in found[0].items()):
            chunks += more
            found.append(own)
    return chunks, {label: _joined([own[label] for own in found]) for label in found[0]}


def _columns_in(chunks: Sequence[Chunk], labels: Sequence[str]) -> dict[str, ReadColumn]:
    """Return the columns in some parts of one file, by their labels."""
    with opened(chunks[0].path) as kind:
        return {label: _column_of(kind, chunks, label) for label in dict.fromkeys(labels)}


def _joined(parts: Sequence[ReadColumn]) -> ReadColumn:
    refused = next((part for part in parts if part.refusal), None)
    if refused is not None:
        return refused
    faults = next((part.faults for part in parts if part.faults), "")
    return ReadColumn(np.concatenate([part.values for part in parts]), any(part.dated for part in parts), faults=faults)


def _column_of(kind: Format, chunks: Sequence[Chunk], label: str) -> ReadColumn:
    readers = (
        kind.read if chunk.whole or kind.read_chunk is None else partial(_of_chunk, kind.read_chunk, chunk)
        for chunk in chunks
    )
    return _joined([_without_faults(read, chunks[0].path, label) for read in readers])


def _without_faults(read: Callable[[Path, Layout], Columns], file: Path, label: str) -> ReadColumn:
    """Return a column as `read_column` does, with the faults among numbers as missing cells."""
    found = read_column(read, file, label)
    if found.share < MOSTLY:
        return found
    layout = Layout(time=label, columns=(("column", label),), loose=frozenset({label}))
    return ReadColumn(times(read(file, layout)[label], layout, file.name), False, faults=found.refusal)


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
        return ReadColumn(np.empty(0), False, said, share=error.share if isinstance(error, NotNumbersError) else 0.0)
