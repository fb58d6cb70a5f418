"""Parquet files, and datasets of them whose folders say KEY=VALUE."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np

from odescope.errors import InputError
from odescope.recordings.chunks import Chunk, DataFile
from odescope.recordings.columns import Columns, check_columns, from_table
from odescope.recordings.layout import Layout

if TYPE_CHECKING:
    from pyarrow import Table
    from pyarrow.parquet import ParquetFile

PAGES_BYTES = 1 << 20  # what is read of a column at once: without it, all of the column in a row group
HEAD_ROWS = 4096
NO_LABEL = "__HIVE_DEFAULT_PARTITION__"  # the folder of the rows whose cell was empty


def parquet_names(path: Path) -> list[str]:
    """Return the names of the columns."""
    from pyarrow import parquet

    with parquet.ParquetFile(path) as file:
        names: list[str] = file.schema_arrow.names
        return names


def survey_parquet(path: Path, layout: Layout) -> DataFile:
    """Return how many rows a Parquet file holds."""
    from pyarrow import parquet

    with parquet.ParquetFile(path) as file:
        _labels(file, path, layout)
        return DataFile(path, file.metadata.num_rows, divisible=True)


def read_parquet(path: Path, layout: Layout) -> Columns:
    """Return the used columns of a whole file."""
    from pyarrow import parquet

    with parquet.ParquetFile(path) as file:
        return _columns(file.read(columns=_labels(file, path, layout)), path, layout)


def read_parquet_head(path: Path, layout: Layout) -> Columns:
    """Return the used columns of the first rows of a file."""
    import pyarrow as pa
    from pyarrow import parquet

    with parquet.ParquetFile(path, buffer_size=PAGES_BYTES, pre_buffer=False) as file:
        batches = file.iter_batches(HEAD_ROWS, columns=_labels(file, path, layout))
        return _columns(pa.Table.from_batches([next(batches)]), path, layout)


def read_parquet_chunk(chunk: Chunk, layout: Layout) -> Columns:
    """Return the used columns of a chunk; only what is needed of each batch is kept: the file may be one row group."""
    import pyarrow as pa
    from pyarrow import parquet

    start, stop = chunk.window
    kept = []
    with parquet.ParquetFile(chunk.path, buffer_size=PAGES_BYTES, pre_buffer=False) as file:
        if file.metadata.num_rows != chunk.size:
            raise InputError(
                f"{chunk.path.name} has {file.metadata.num_rows} rows where {chunk.size} were counted: it was "
                "changed meanwhile; start again"
            )
        edges = np.cumsum([0, *(file.metadata.row_group(k).num_rows for k in range(file.num_row_groups))])
        groups = np.flatnonzero((edges[1:] > start) & (edges[:-1] < stop))
        row = int(edges[groups[0]])
        for batch in file.iter_batches(row_groups=groups.tolist(), columns=_labels(file, chunk.path, layout)):
            low, high = max(start - row, 0), min(stop - row, len(batch))
            if low < high:
                kept.append(batch.slice(low, high - low))
            row += len(batch)
            if row >= stop:
                break
    return _columns(pa.Table.from_batches(kept), chunk.path, layout)


def _labels(file: ParquetFile, path: Path, layout: Layout) -> list[str]:
    """Return which columns of a Parquet file to read; InputError where one is lacking."""
    names = file.schema_arrow.names
    in_path = layout.recording not in names and layout.recording in folder_labels(path)
    labels = [label for label in layout.used if not (in_path and label == layout.recording)]
    check_columns(labels, names, path.name)
    return labels


def _columns(table: Table, path: Path, layout: Layout) -> Columns:
    """Return the used columns of what was read, the recording from the path where the file lacks it."""
    import pyarrow as pa

    if layout.recording is not None and layout.recording not in table.column_names:
        label = pa.scalar(folder_labels(path)[layout.recording], pa.string())
        table = table.append_column(layout.recording, pa.repeat(label, len(table)))
    return from_table(table, layout)


def folder_labels(path: Path) -> dict[str, str]:
    """Return what the folders KEY=VALUE on the path of a file say, by key; the innermost one of a key counts."""
    parts = (part.partition("=") for part in path.absolute().parent.parts)
    return {unquote(key): "" if value == NO_LABEL else unquote(value) for key, equals, value in parts if equals}
