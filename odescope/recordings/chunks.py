"""Chunks: recordings that do not fit in memory are cut into consecutive rows of a file that are worked on at once."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from odescope.errors import InputError
from odescope.recordings.text_files import RowIndex, part_of
from odescope.recordings.text_headers import TextFile


@dataclass(frozen=True, slots=True, eq=False)
class DataFile:
    r"""A data file, and how many rows of data it holds.

    `text` and `index` say of a text file what its header means and where its rows are; a file that is not `divisible`
    (compressed text, text with line ends of "\r" alone, MATLAB) can only be read whole. `name` tells it from other
    files of that name, where there are some.
    """

    path: Path
    rows: int
    divisible: bool
    text: TextFile | None = None
    index: RowIndex | None = None
    name: str = ""

    @property
    def source(self) -> str:
        """What its recordings are said to be from: its name, or what tells it from other files of that name."""
        return self.name or self.path.name


@dataclass(frozen=True, slots=True)
class Chunk:
    """Consecutive rows of one file that are worked on at once, and those around them that a filter needs.

    Its own rows are [first, stop), counted from 0, of the file's `size`; `before` and `after` of them more are read.
    `text` is the part of a text file that holds them all, `source` what the file is called.
    """

    path: Path
    first: int
    stop: int
    before: int
    after: int
    size: int
    source: str
    text: TextFile | None = None

    @property
    def whole(self) -> bool:
        """Whether the chunk is the whole file."""
        return (self.first, self.stop) == (0, self.size)

    @property
    def window(self) -> tuple[int, int]:
        """The rows [start, stop) of the file that are read."""
        return self.first - self.before, self.stop + self.after


def cut(file: DataFile, rows: int, overlap: int = 0) -> tuple[Chunk, ...]:
    """Cut a file into chunks of equal size, at most `rows` own rows each, with up to `overlap` rows around them.

    A file that is not divisible is one chunk. With an overlap of at least 16 rows, each sample that reading the file
    at once would keep is some chunk's own; with less, those of a run that a cut leaves too short are lost. A part
    of a Parquet file is found by reading its row group from the start, which is slow where there is only one.

    Args:
        file: see `odescope.recordings.readers.survey`.
        rows: at most, of each chunk's own.
        overlap: rows that are read before and after these.

    Raises:
        InputError: `rows` is below 1, or `overlap` below 0.
    """
    if rows < 1 or overlap < 0:
        raise InputError(f"a chunk needs at least 1 row and an overlap of at least 0, got {rows} and {overlap}")
    count = -(-file.rows // rows) if file.divisible else 1
    edges = [file.rows * k // count for k in range(count + 1)]
    return tuple(_chunk(file, first, stop, overlap) for first, stop in pairwise(edges))


def _chunk(file: DataFile, first: int, stop: int, overlap: int) -> Chunk:
    before, after = min(overlap, first), min(overlap, file.rows - stop)
    text = file.text
    if text is not None and file.index is not None:
        text = part_of(text, file.index, first - before, stop + after)
    return Chunk(file.path, first, stop, before, after, file.rows, file.source, text)
