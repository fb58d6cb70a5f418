"""Text files of numbers: reads them whole or in parts, and names the line where one goes wrong."""

from __future__ import annotations

import contextlib
import io
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from odescope.arrays import BoolArray, IntArray
from odescope.errors import InputError
from odescope.recordings.dates import DATE, MISSING, date_hint, from_text
from odescope.recordings.text_headers import NUMBER, TextFile, evened, open_bytes, zipped

if TYPE_CHECKING:
    from pyarrow import ChunkedArray, DataType, NativeFile, Table

HEAD_PART = 1 << 18  # bytes that tell what kind of cells a column has
BLOCK_BYTES = 1 << 20  # what counting lines reads at once
MARK_ROWS = 8192  # the place of every so-manieth row is kept: part of a file is read from the one before it
TELLING_MARKS = 8  # so many times MARK_ROWS rows are parsed at once to find the decimal mark
THOUSANDS = r"^\s*[+-]?[1-9]\d{0,2}(,\d{3})+\s*$"  # 1,250 may be a thousand and more, or one and a quarter
RAGGED = re.compile(r"(?:Row #(\d+): )?Expected (\d+) columns, got (\d+)")


class NotNumbersError(InputError):
    """Cells of a column are no numbers; of those that are not empty, `share` are."""

    def __init__(self, message: str, share: float) -> None:
        super().__init__(message, share)
        self.share = share

    def __str__(self) -> str:
        return str(self.args[0])


@dataclass(frozen=True, slots=True, eq=False)
class RowIndex:
    r"""The rows of data in a text file, and where they are.

    `marks` are the byte offsets from which every MARK_ROWS-th row is read (0, with the header, for the first) and the
    size of the file. There are none where it can only be read whole: compressed, or with line ends of "\r" alone.
    """

    rows: int
    marks: IntArray


def index_rows(file: TextFile, blanks: bool) -> RowIndex:
    """Count the rows of data of a whole file, without parsing them or holding more than a block of it.

    Raises:
        InputError: there is a blank line between samples, and `blanks` are not allowed (see refuse_blank_lines).
    """
    rows = lines = lone = blank = 0
    marks = []
    with open_bytes(file.path) as stream:
        for starts, empty, returns in _line_starts(stream):
            header = max(file.skip - lines, 0)
            filled = starts[header:][~empty[header:]]
            marks.append(filled[-rows % MARK_ROWS :: MARK_ROWS])
            rows, lines = rows + len(filled), lines + len(starts)
            lone, blank = lone + returns, blank + int(np.count_nonzero(empty[header:]))
        size = stream.tell()
    if lone:
        rows = sum(1 for _ in _filled_lines(file))
    if blank and not blanks:  # which of them lie between samples takes a look at each line
        refuse_blank_lines(file)
    if lone or zipped(file.path):
        return RowIndex(rows, np.empty(0, dtype=np.int64))
    return RowIndex(rows, np.concatenate(([0], np.concatenate(marks)[1:], [size])))


def _line_starts(stream: IO[bytes]) -> Iterator[tuple[IntArray, BoolArray, int]]:
    r"""Yield the lines of each block: where they start, which are blank, and how many "\r" (in sum) end none."""
    offset = start = 0
    before = np.zeros(1, dtype=np.uint8)
    while block := stream.read(BLOCK_BYTES):
        characters = np.concatenate((before, np.frombuffer(block, dtype=np.uint8)))
        ends = np.flatnonzero(characters[1:] == ord("\n"))
        returns = characters[ends] == ord("\r")
        lone = int(np.count_nonzero(characters[1:] == ord("\r"))) - int(np.count_nonzero(returns))
        starts = np.concatenate(([start], offset + ends + 1))
        yield starts[:-1], offset + ends - starts[:-1] <= returns, lone
        start, offset, before = int(starts[-1]), offset + len(block), characters[-1:]
    if start < offset:  # the last line may do without an end
        yield np.array([start]), np.array([False]), 0


def part_of(file: TextFile, index: RowIndex, start: int, stop: int) -> TextFile:
    """Return the part of a whole file that holds some data rows, and some around them.

    Args:
        file: the whole file.
        index: where its rows are.
        start: the first row that is wanted, counted from 0.
        stop: the row after the last.
    """
    low, high = start // MARK_ROWS, -(-stop // MARK_ROWS)
    begin, end = int(index.marks[low]), int(index.marks[high])
    first = low * MARK_ROWS
    rows = min(high * MARK_ROWS, index.rows) - first
    return replace(file, skip=file.skip if low == 0 else 0, begin=begin, end=end, first=first, rows=rows)


def head_of(file: TextFile) -> TextFile:
    """Return the part of a whole file that its first lines are; of a compressed one, the whole."""
    if zipped(file.path) or file.path.stat().st_size <= HEAD_PART:
        return file
    with file.path.open("rb") as stream:
        end = stream.read(HEAD_PART).rfind(b"\n") + 1
    return replace(file, end=end) if end else file


def settle_decimal(file: TextFile, index: RowIndex, numeric: Sequence[str]) -> TextFile:
    """Return the file with one decimal mark, where its numbers tell: a part of it with whole numbers could not.

    Args:
        file: the whole file.
        index: where its rows are.
        numeric: the columns that hold numbers.
    """
    import pyarrow as pa

    step = TELLING_MARKS * MARK_ROWS
    for start in range(0, index.rows, step) if len(file.decimals) > 1 else ():
        part = part_of(file, index, start, min(start + step, index.rows))
        fitting = []
        for decimal in file.decimals:
            with contextlib.suppress(pa.ArrowInvalid):
                _parse(part, dict.fromkeys(numeric, pa.float64()), decimal)
                fitting.append(decimal)
        if len(fitting) == 1:
            _refuse_thousands(part, numeric, fitting[0])
            return replace(file, decimals=tuple(fitting))
    return file


def _refuse_thousands(file: TextFile, numeric: Sequence[str], decimal: str) -> None:
    """Refuse numbers whose commas may all stand between thousands; where semicolons separate, they are decimal.

    Args:
        file: or a part of one.
        numeric: the columns that hold numbers.
        decimal: the mark with which they can be read.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    if decimal != "," or file.separator == ";" or len(file.decimals) == 1:
        return
    found = None
    for label, cells in _parse(file, dict.fromkeys(numeric, pa.string()), ".").items():
        marked = cells.filter(pc.fill_null(pc.match_substring(cells, ","), False))
        if not pc.all(pc.match_substring_regex(marked, THOUSANDS)).as_py() and len(marked):
            return
        found = (label, marked[0].as_py()) if len(marked) else found
    if found is not None:
        raise InputError(
            f"column {found[0]!r} in {file.path.name} has numbers such as {found[1].strip()!r}, whose comma may stand"
            " between thousands or before decimals: write them without the one, or with points for the other"
        )


def refuse_blank_lines(file: TextFile) -> None:
    """Refuse a blank line between samples: without a time column it is a lost sample that nothing else would show."""
    blank = 0
    with _lines(file.path) as stream:
        for number, line in enumerate(stream, start=1):
            if line == "\n":
                blank = blank or (number if number > file.skip else 0)
            elif blank:
                raise InputError(
                    f"line {blank} of {file.path.name} is blank: with sample_period in place of a time column that "
                    "would shift every later sample; delete it, or put NaN there if a sample is missing"
                )


def read_columns(
    file: TextFile, labels: Sequence[str], numeric: Sequence[str], time: str | None = None
) -> dict[str, ChunkedArray]:
    """Return the labelled columns as Arrow columns: those in `numeric` of floats, null or NaN where a cell is missing.

    The cells are converted while parsing; only where that fails are they looked at one by one. The column `time` may
    hold dates instead: Arrow parses those of ISO 8601 (2026-11-22 13:05:01.25), `from_text` other ones.

    Args:
        file: or a part of one.
        labels: of the columns that are read.
        numeric: those of them that must hold numbers.
        time: that of them that may hold dates.

    Raises:
        InputError: a row of too few or too many cells, a cell that is not a number; a part of a file without the rows
            that were counted there.
        pyarrow.ArrowInvalid: a file that Arrow cannot parse for any other reason.
    """
    import pyarrow as pa

    types = {label: pa.float64() if label in numeric else pa.string() for label in labels}
    dated = [] if time is None else [types | {time: pa.timestamp("ns", zone)} for zone in (None, "UTC")]
    for decimal, kinds in itertools.product(file.decimals, (types, *dated)):
        try:
            found = _parse(file, kinds, decimal)
        except pa.ArrowInvalid:
            continue  # what follows finds the cells at fault, or reads those that only Arrow refuses ("+1")
        _refuse_thousands(file, [label for label in numeric if kinds[label] == types[label]], decimal)
        return found
    if time is not None:
        for decimal in file.decimals:
            with contextlib.suppress(pa.ArrowInvalid, InputError):
                found = _parse(file, {**types, time: pa.string()}, decimal)
                return {**found, time: from_text(found[time], time, file.path.name)}
    texts = _texts(file, labels)
    dates = None if time is None else _as_dates(texts[time], time)  # then the cells at fault are in other columns
    checked = [label for label in numeric if dates is None or label != time]
    faults = {mark: {label: _faults(texts[label], mark) for label in checked} for mark in file.decimals}
    decimal = min(faults, key=lambda mark: sum(map(len, faults[mark].values())))
    columns: dict[str, Sequence[object]] = dict(texts)
    for label in checked:
        if rows := faults[decimal][label]:
            _refuse_cells(file, label, texts[label], rows, label == time)
        columns[label] = [_float(cell, decimal) for cell in texts[label]]
    _refuse_thousands(file, checked, decimal)
    own = {time: dates} if time is not None and dates is not None else {}
    return own | {
        label: pa.chunked_array([pa.array(columns[label], types[label])]) for label in labels if label not in own
    }


def read_loosely(file: TextFile, labels: Sequence[str]) -> dict[str, ChunkedArray]:
    """Return the labelled columns as Arrow columns of floats, NaN where a cell is missing or no number.

    Raises:
        InputError: a row of too few or too many cells.
        pyarrow.ArrowInvalid: a file that Arrow cannot parse for any other reason.
    """
    import pyarrow as pa

    found = {}
    for label, cells in _texts(file, labels).items() if labels else ():
        faults = {mark: set(_faults(cells, mark)) for mark in file.decimals}
        decimal = min(faults, key=lambda mark: len(faults[mark]))
        values = [_float("" if row in faults[decimal] else cell, decimal) for row, cell in enumerate(cells)]
        found[label] = pa.chunked_array([pa.array(values, pa.float64())])
    return found


def _texts(file: TextFile, labels: Sequence[str]) -> dict[str, list[str]]:
    """Return the cells of the labelled columns as they stand in the file."""
    import pyarrow as pa

    cells = _parse(file, dict.fromkeys(labels, pa.binary()), ".", threads=False)
    return {label: [cell.decode(errors="replace") for cell in cells[label].to_pylist()] for label in labels}


def _parse(
    file: TextFile, types: Mapping[str, DataType], decimal: str, threads: bool = True
) -> dict[str, ChunkedArray]:
    """Parse the columns named in `types`; positions stand for names, which may repeat among the unused columns."""
    import pyarrow as pa

    positions = {label: str(file.names.index(label)) for label in types}
    kinds = {positions[label]: kind for label, kind in types.items()}
    try:
        try:
            table = _table(file, _arrow_stream(file), kinds, decimal, threads)
        except pa.ArrowInvalid as error:
            if not RAGGED.search(str(error)):
                raise
            table = _table(file, pa.BufferReader(evened(file)), kinds, decimal, threads)
    except pa.ArrowInvalid as error:
        ragged = RAGGED.search(str(error))  # the row handler of pyarrow fails on rows that are not UTF-8
        if ragged is None or ragged[1] is None:  # rows are counted only where one thread reads
            raise
        row, expected, got = map(int, ragged.groups())
        line = _line_numbers(file, [row - file.skip - 1])[0]
        raise InputError(
            f"line {line} of {file.path.name} has {got} cell{'s' * (got != 1)} where the header has {expected}"
        ) from error
    if file.rows not in (None, len(table)):
        raise InputError(
            f"{file.path.name} has {len(table)} rows where {file.rows} were counted, after data row {file.first}: it "
            "was changed meanwhile, or the text of a cell goes over several lines; put it on one"
        )
    return {label: table.column(position) for label, position in positions.items()}


def _table(file: TextFile, stream: NativeFile, kinds: Mapping[str, DataType], decimal: str, threads: bool) -> Table:
    from pyarrow import csv as arrow_csv

    return arrow_csv.read_csv(
        stream,
        arrow_csv.ReadOptions(
            column_names=[str(k) for k in range(len(file.names))], skip_rows=file.skip, use_threads=threads
        ),
        arrow_csv.ParseOptions(delimiter=file.separator),
        arrow_csv.ConvertOptions(
            include_columns=list(kinds), column_types=kinds, null_values=list(MISSING), decimal_point=decimal
        ),
    )


def _arrow_stream(file: TextFile) -> NativeFile:
    import pyarrow as pa

    if file.end is None:
        return pa.input_stream(str(file.path), compression="gzip" if zipped(file.path) else None)
    return pa.OSFile(str(file.path)).get_stream(file.begin, file.end - file.begin)


def _faults(cells: Sequence[str], decimal: str) -> list[int]:
    """Return the rows whose cell is neither missing nor a plain number with this decimal mark."""
    other = "," if decimal == "." else "."
    return [
        row
        for row, cell in enumerate(cells)
        if cell.strip() not in MISSING and (other in cell or not NUMBER.fullmatch(cell.strip().replace(decimal, ".")))
    ]


def _as_dates(cells: Sequence[str], label: str) -> ChunkedArray | None:
    """Return cells as instants where every one is a date or a clock, None where one is not."""
    import pyarrow as pa

    with contextlib.suppress(InputError):
        return from_text(pa.chunked_array([pa.array(cells)]), label, "the file")
    return None


def _float(cell: str, decimal: str) -> float:
    plain = cell.strip().replace(decimal, ".")
    return float("nan") if plain in MISSING else float(plain)


def _refuse_cells(file: TextFile, label: str, cells: Sequence[str], rows: list[int], times: bool) -> None:
    lines = _line_numbers(file, rows[:3])
    shown = ", ".join(f"line {line}: {cells[row][:40]!r}" for line, row in zip(lines, rows, strict=False))
    more = f" and {len(rows) - 3} more" if len(rows) > 3 else ""
    units = rows == [0] and file.first == 0
    hint = "delete that line if it holds units or a comment" if units else "empty cells and NaN count as missing"
    if DATE.match(cells[rows[0]]):
        hint = date_hint(cells[rows[0]]) if times else "dates are read in the column of the time alone"
    raise NotNumbersError(
        f"column {label!r} in {file.path.name} has cells that are not numbers ({shown}{more}); {hint}",
        1.0 - len(rows) / sum(cell.strip() not in MISSING for cell in cells),
    )


def _line_numbers(file: TextFile, rows: Sequence[int]) -> list[int]:
    """Return the line numbers of some data rows, counted from 0 in the file or part, both in increasing order."""
    wanted = set(rows)
    numbered = (number for row, number in enumerate(_filled_lines(file)) if row in wanted)
    return list(itertools.islice(numbered, len(wanted)))


def _filled_lines(file: TextFile) -> Iterator[int]:
    """Yield the number in the whole file of every line of data, except for blank ones: Arrow skips those."""
    before = _newlines(file.path, file.begin)
    with _lines(file.path, file.begin) as stream:
        for number, line in enumerate(stream, start=1):
            if number > file.skip and line != "\n":
                yield before + number


def _newlines(path: Path, stop: int) -> int:
    """Count the line ends in the first `stop` bytes of a file."""
    with path.open("rb") as stream:
        sizes = (min(BLOCK_BYTES, stop - done) for done in range(0, stop, BLOCK_BYTES))
        return sum(stream.read(size).count(b"\n") for size in sizes)


def _lines(path: Path, begin: int = 0) -> IO[str]:
    """Open for counting lines: Latin-1 decodes any byte, and all three line endings come as one."""
    stream = open_bytes(path)
    stream.seek(begin)
    return io.TextIOWrapper(stream, encoding="latin-1")
