"""What stands in memory of the recordings, and the chunks of which decisions are made where that is not all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

import numpy as np

from odescope.errors import InputError
from odescope.files import shortest_ends
from odescope.parallel.workers import Threads
from odescope.pipeline.store import Store
from odescope.recordings.chunks import Chunk, DataFile, cut
from odescope.recordings.layout import Layout
from odescope.recordings.readers import column_names, find_files, read_chunk, survey
from odescope.recordings.record import Records
from odescope.regression.rows import FOLDS
from odescope.study.options import Data

PROGRAM = 550.0  # MB that an identification takes however short its log is
BYTES_A_CELL = 110.0  # at the most, while a table is read and filtered
SAMPLED = 8  # chunks of the size that fits in memory together, of which decisions are made
LEAST_ROWS = 50_000  # in memory at once: fewer decide nothing


def rows_in_memory(memory: float, columns: int) -> int:
    """Return how many rows of so many columns may stand in memory, given the memory of all in MB."""
    return int((memory - PROGRAM) * 1e6 / (BYTES_A_CELL * columns))


def _refuse_too_little(memory: float, columns: int) -> None:
    if rows_in_memory(memory, columns) < LEAST_ROWS:
        least = PROGRAM + LEAST_ROWS * BYTES_A_CELL * columns / 1e6
        raise InputError(
            f"memory = {memory:g} MB is too little for a long log of {columns} columns: expected at least {least:.0f},"
            f" of which the program itself takes {PROGRAM:.0f} (memory in [data])"
        )


@dataclass(frozen=True, eq=False)
class Sample:
    """The recordings that stand in memory, of which decisions are made: all, or a sample; and where the rest lies.

    `origin` is the chunk of each record, `files` all files and `rows` the rows that a chunk of them may have at most;
    data that were given in memory have no chunks. Where the sample is not `complete`, there is more in the files.
    """

    records: Records
    chunks: tuple[Chunk, ...] = ()
    origin: tuple[int, ...] = ()
    files: tuple[DataFile, ...] = ()
    rows: int = 0
    complete: bool = True
    store: Store | None = None

    @property
    def folds(self) -> tuple[int, ...] | None:
        """The fold of each record, where all of a chunk is held out together."""
        return None if self.complete else tuple(k % FOLDS for k in self.origin)

    def without(self, dropped: Sequence[bool]) -> Sample:
        """Return the log less some of its records."""
        kept = [not d for d in dropped]
        origin = tuple(compress(self.origin, kept))
        return replace(self, records=Records(tuple(compress(self.records, kept))), origin=origin)


def open_recordings(data: Data, layout: Layout, store: Store | None) -> Sample:
    """Return what fits in memory of the files of a study: all, or chunks evenly spread over them.

    Args:
        data: where the recordings are, and what memory there is.
        layout: what their columns mean.
        store: remembers what was sampled.

    Raises:
        InputError: a file that is missing, unreadable, of another kind, or whose columns do not serve.
    """
    if not data.files:
        raise InputError("the study names no files: set files in [data], or pass the recordings")
    paths = find_files([Path(f) for f in data.files])
    try:
        surveyed = list(zip(Threads().map(survey, paths, layout), shortest_ends(paths), strict=True))
    except InputError as error:
        raise _unmeasured(paths, layout, error) from error
    files = tuple(replace(_anywhere(f), name=name) for f, name in surveyed)
    columns, total = len(layout.used), sum(f.rows for f in files)
    rows = rows_in_memory(data.memory, columns)
    complete = total <= max(rows, LEAST_ROWS)
    chunks = tuple(p for f in files for p in cut(f, f.rows if complete else max(rows // SAMPLED, 1)))
    if not complete:
        _refuse_too_little(data.memory, columns)
        _refuse_indivisible(files, rows)
        sampled = () if store is None else store.sampled(chunks, total)
        chunks = sampled or spread(chunks, rows)
        if store is not None and not sampled:
            store.keep_sample(chunks, total)
    read = [[s.record for s in read_chunk(p, layout)] for p in chunks]
    origin = tuple(k for k, records in enumerate(read) for _ in records)
    records = Records(tuple(record for own in read for record in own))
    return Sample(records, chunks, origin, files, rows // SAMPLED, complete, store)


def _unmeasured(paths: Sequence[Path], layout: Layout, error: InputError) -> InputError:
    """Return the error with what can be done where a column lacks in some files only: it was not measured there."""
    names = {path: set(column_names(path)) for path in paths if path.is_file()}
    for label in layout.used:
        lacking = [path for path in names if label not in names[path]]
        if 0 < len(lacking) < len(names):
            left = ", ".join(dict.fromkeys(path.name for path in lacking))
            return InputError(
                f"column {label!r} lacks in {left}, and is in other files: every coordinate and input has to be"
                f" measured in every recording; leave {left} out of files, or {label!r} out of the study"
            )
    return error


def _refuse_indivisible(files: Sequence[DataFile], rows: int) -> None:
    for file in files:
        if not file.divisible and file.rows > rows:
            raise InputError(
                f"{file.path.name} has {file.rows} rows and can only be read whole, but {rows} fit in the memory that"
                " is allowed: unpack it, convert it to Parquet, or allow more ([data] memory)"
            )


def spread(chunks: Sequence[Chunk], rows: int) -> tuple[Chunk, ...]:
    """Return chunks evenly spread among all that have together about so many rows."""
    sizes = np.array([p.stop - p.first for p in chunks])
    middles, total = np.cumsum(sizes) - 0.5 * sizes, int(sizes.sum())
    count = max(min(len(chunks), FOLDS), int(len(chunks) * min(1.0, rows / total)))
    while True:
        wanted = total * (np.arange(count) + 0.5) / count
        index = np.unique(np.abs(middles[None] - wanted[:, None]).argmin(axis=1))
        if sizes[index].sum() <= rows or count <= FOLDS:
            return tuple(chunks[k] for k in index)
        count = max(FOLDS, int(0.9 * count))


def _anywhere(file: DataFile) -> DataFile:
    """Return a file whose path does not depend on where it is read from."""
    path = file.path.absolute()
    return replace(file, path=path, text=None if file.text is None else replace(file.text, path=path))
