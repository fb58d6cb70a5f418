"""Recordings that do not fit in memory: files are counted, cut into portions of rows, and read portion by portion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from odescope.arrays import IntArray
from odescope.errors import InputError
from odescope.recordings.readers import (
    MATLAB,
    PARQUET,
    TEXT,
    Layout,
    check_rows,
    matlab_rows,
    opened,
    parquet_columns,
    parquet_labels,
    raw_runs,
    read_records,
    ready,
    recording_codes,
    text_header,
)
from odescope.recordings.record import Stretch
from odescope.recordings.sampling import SHORTEST_PIECE, RawRun, gapless, piece
from odescope.recordings.text_files import RowIndex, TextFile, index_rows, part_of, read_columns, settle_decimal

PAGES_BYTES = 1 << 20  # what is read of a Parquet column at once: without it, all of the column in a row group


@dataclass(frozen=True, slots=True, eq=False)
class DataFile:
    r"""A data file, and how many rows of data it holds.

    `text` and `index` say of a text file what its header means and where its rows are; a file that is not `divisible`
    (compressed text, text with line ends of "\r" alone, MATLAB) can only be read whole.
    """

    path: Path
    rows: int
    divisible: bool
    text: TextFile | None = None
    index: RowIndex | None = None


@dataclass(frozen=True, slots=True)
class Portion:
    """Consecutive rows of one file that are worked on at once, and those around them that a filter needs.

    Its own rows are [first, stop), counted from 0, of the file's `size`; `before` and `after` of them more are read.
    `text` is the part of a text file that holds them all.
    """

    path: Path
    first: int
    stop: int
    before: int
    after: int
    size: int
    text: TextFile | None = None

    @property
    def whole(self) -> bool:
        """Whether the portion is the whole file."""
        return (self.first, self.stop) == (0, self.size)

    @property
    def window(self) -> tuple[int, int]:
        """The rows [start, stop) of the file that are read."""
        return self.first - self.before, self.stop + self.after


def survey(path: Path, layout: Layout) -> DataFile:
    """Count the rows of a data file and find where they are, in little memory.

    No number is parsed, but for those that tell the decimal mark of a text file with semicolons.

    Raises:
        InputError: the file is missing, unreadable, of no known kind or without rows of data, lacks a column, or has
            blank lines between samples that only a sample period tells apart.
    """
    file: DataFile = opened(path, _SURVEYS)(path, layout)
    check_rows(file.rows, path.name)
    return file


def _survey_text(path: Path, layout: Layout) -> DataFile:
    text = text_header(path, layout)
    index = index_rows(text, blanks=layout.time is not None)
    if not len(index.marks):
        return DataFile(path, index.rows, divisible=False)
    return DataFile(path, index.rows, True, settle_decimal(text, index, layout.numeric), index)


def _survey_parquet(path: Path, layout: Layout) -> DataFile:
    from pyarrow import parquet

    with parquet.ParquetFile(path) as file:
        parquet_labels(file, path, layout)
        return DataFile(path, file.metadata.num_rows, divisible=True)


def _survey_matlab(path: Path, layout: Layout) -> DataFile:
    return DataFile(path, matlab_rows(path, layout), divisible=False)


_SURVEYS = {TEXT: _survey_text, PARQUET: _survey_parquet, MATLAB: _survey_matlab}


def cut(file: DataFile, rows: int, overlap: int = 0) -> tuple[Portion, ...]:
    """Cut a file into portions of equal size, at most `rows` own rows each, with up to `overlap` rows around them.

    A file that is not divisible is one portion. With an overlap of at least 16 rows, each sample that reading the file
    at once would keep is some portion's own; with less, those of a piece that a cut leaves too short are lost. A part
    of a Parquet file is found by reading its row group from the start, which is slow where there is only one.

    Raises:
        InputError: `rows` is below 1, or `overlap` below 0.
    """
    if rows < 1 or overlap < 0:
        raise InputError(f"a portion needs at least 1 row and an overlap of at least 0, got {rows} and {overlap}")
    count = -(-file.rows // rows) if file.divisible else 1
    edges = [file.rows * k // count for k in range(count + 1)]
    return tuple(_portion(file, first, stop, overlap) for first, stop in pairwise(edges))


def _portion(file: DataFile, first: int, stop: int, overlap: int) -> Portion:
    before, after = min(overlap, first), min(overlap, file.rows - stop)
    text = file.text
    if text is not None and file.index is not None:
        text = part_of(text, file.index, first - before, stop + after)
    return Portion(file.path, first, stop, before, after, file.rows, text)


def read_portion(portion: Portion, layout: Layout) -> tuple[Stretch, ...]:
    """Read the rows of a portion, and no others, as records ready for use.

    A whole file gives the records of read_records. In a part of one, rows of one label that follow each other are one
    recording, and one that comes back later is another; each is cut or refused at gaps, its angles are unwrapped and
    its time made uniform by what the portion holds of it. With a sample period, time counts from the file's first row.

    Raises:
        InputError: the file is unreadable or no longer the one that was counted, its columns do not serve (see
            read_records), or the rows of its recordings are mixed.
    """
    if portion.whole:
        return tuple(Stretch.whole(record) for record in read_records([portion.path], layout))
    columns = opened(portion.path, _PARTS)(portion, layout)
    source, before = portion.path.name, portion.window[0]
    runs = raw_runs(columns, layout, source, _label_runs(columns, layout, portion), before)
    return tuple(stretch for run in runs for stretch in _stretches(run, portion, layout))


def _read_text_part(portion: Portion, layout: Layout) -> dict[str, Any]:
    assert portion.text is not None  # cut gives every part of a text file one
    columns = read_columns(portion.text, layout.used, layout.numeric)
    start, stop = portion.window
    return {label: column.slice(start - portion.text.first, stop - start) for label, column in columns.items()}


def _read_parquet_part(portion: Portion, layout: Layout) -> dict[str, Any]:
    """Read batch by batch, and keep what is needed: the file may be one single row group."""
    import pyarrow as pa
    from pyarrow import parquet

    start, stop = portion.window
    kept = []
    with parquet.ParquetFile(portion.path, buffer_size=PAGES_BYTES, pre_buffer=False) as file:
        if file.metadata.num_rows != portion.size:
            raise InputError(
                f"{portion.path.name} has {file.metadata.num_rows} rows where {portion.size} were counted: it was "
                "changed meanwhile; start again"
            )
        edges = np.cumsum([0, *(file.metadata.row_group(k).num_rows for k in range(file.num_row_groups))])
        groups = np.flatnonzero((edges[1:] > start) & (edges[:-1] < stop))
        row = int(edges[groups[0]])
        for batch in file.iter_batches(row_groups=groups.tolist(), columns=parquet_labels(file, portion.path, layout)):
            low, high = max(start - row, 0), min(stop - row, len(batch))
            if low < high:
                kept.append(batch.slice(low, high - low))
            row += len(batch)
            if row >= stop:
                break
    return parquet_columns(pa.Table.from_batches(kept), portion.path, layout)


_PARTS = {TEXT: _read_text_part, PARQUET: _read_parquet_part}


def _label_runs(columns: dict[str, Any], layout: Layout, portion: Portion) -> list[tuple[str, IntArray]]:
    """Return the label and the indices (n,) of rows that follow each other and have one label."""
    names, codes = recording_codes(columns, layout, portion.path.name)
    starts = np.concatenate(([0], np.flatnonzero(np.diff(codes)) + 1))
    _refuse_mixed(names, codes[starts], starts, layout, portion)
    groups = np.split(np.arange(len(codes)), starts[1:])
    return [(names[codes[start]], group) for start, group in zip(starts, groups, strict=True)]


def _refuse_mixed(names: list[str], codes: IntArray, starts: IntArray, layout: Layout, portion: Portion) -> None:
    """Refuse runs (n,) too short to work with where their label comes back: read at once, they would be one recording.

    The first and the last may only be cut short.
    """
    short = np.flatnonzero(np.diff(starts)[1:] < SHORTEST_PIECE) + 1
    again = short[np.bincount(codes)[codes[short]] > 1]
    if len(again):
        label, row = names[codes[again[0]]], portion.window[0] + int(starts[again[0]]) + 1
        raise InputError(
            f"recording {label!r} in {portion.path.name} is in several places, with only a few rows from data row {row}"
            f" on: in a file that is read in portions the rows of a recording must follow each other; sort it by"
            f" {layout.recording!r}, then by time"
        )


def _stretches(run: RawRun, portion: Portion, layout: Layout) -> Iterator[Stretch]:
    """Yield what is left of a run between its gaps, as far as it holds some of the portion's own rows."""
    rows, (start, stop) = run.rows - 1, portion.window
    if rows[-1] < portion.first or rows[0] >= portion.stop:
        return
    if layout.sample_period is not None:
        run = replace(run, t=rows * np.float64(layout.sample_period))
    cut_before, cut_after = rows[0] == start > 0, rows[-1] + 1 == stop < portion.size
    for samples in gapless(run, layout.gaps, partial=bool(cut_before or cut_after)):
        first, last = np.searchsorted(rows[samples], (portion.first, portion.stop)).tolist()
        if first < last:
            begins, ends = not (cut_before and samples[0] == 0), not (cut_after and samples[-1] + 1 == len(rows))
            yield Stretch(ready(piece(run, samples), layout), first, last, bool(begins), bool(ends))
