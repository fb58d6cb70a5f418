"""A data file for looking at: its columns of numbers as overviews, read once and never copied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.recordings.columns import numbers, row_seconds
from odescope.recordings.formats import opened
from odescope.recordings.layout import Layout
from odescope.study.clock_column import clock_of
from odescope.study.looked_at import read_column
from odescope.workbench.overview import Overview

if TYPE_CHECKING:
    from pyarrow import Array, ChunkedArray


@dataclass(frozen=True, eq=False)
class LogFile:
    """What is looked at.

    Attributes:
        path: of the file.
        labels: of all columns.
        rows: how many there are.
        axis: the label of the axis that the lines are over.
        lines: the columns of numbers but the time, by their labels.
    """

    path: Path
    labels: tuple[str, ...]
    rows: int
    axis: str
    lines: Mapping[str, Overview]


def open_log(path: Path) -> LogFile:
    """Return a data file for looking at.

    Where the time goes back, as it does from one recording in a file to the next, lines are over the rows.

    Raises:
        InputError: it cannot be read, or holds no numbers.
    """
    with opened(path) as kind:
        labels = tuple(dict.fromkeys(kind.names(path)))
        heads = {label: found for label in labels if not (found := read_column(kind.read_head, path, label)).refusal}
        clock = clock_of({n: c.values for n, c in heads.items()}, [n for n, c in heads.items() if c.dated])
        drawn = [label for label, column in heads.items() if label != clock.label and not column.dated]
        if not drawn:
            raise InputError(f"{path.name} holds no numbers to draw; its columns are {', '.join(labels)}")
        layout = Layout(
            time=clock.label,
            sample_period=1.0 if clock.label is None else None,
            columns=tuple((f"column_{k}", label) for k, label in enumerate(drawn)),
            time_unit=clock.unit,
            date=clock.date,
        )
        columns = kind.read(path, layout)
    rows = len(columns[drawn[0]])
    values = {label: tuple(_pieces(columns[label], label, path.name)) for label in drawn}
    axis, t = "time (s)", np.empty(0) if clock.label is None else row_seconds(columns, layout, path.name)
    if clock.label is not None and heads[clock.label].dated:
        axis = "time from the first row (s)"
        t -= t[0]
    if len(t) < rows or not np.all(t[1:] >= t[:-1]):
        axis, t = "row", np.arange(rows, dtype=np.float64)
    lines = {
        label: Overview.of(np.split(t, np.cumsum([len(piece) for piece in ys])[:-1]), ys)
        for label, ys in values.items()
    }
    return LogFile(path, labels, rows, axis, lines)


def _pieces(column: ChunkedArray, label: str, source: str) -> Iterator[FloatArray]:
    """Yield the pieces of a column as they were read."""
    import pyarrow as pa

    for chunk in column.chunks:
        if _plain(chunk):
            yield np.asarray(np.from_dlpack(chunk), dtype=np.float64)
        else:
            yield numbers(pa.chunked_array([chunk]), label, source)


def _plain(chunk: Array) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_float64(chunk.type)) and not chunk.null_count
