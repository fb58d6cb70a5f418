"""Text files of numbers: finds separator, header and decimal mark, and names the line where one goes wrong."""

from __future__ import annotations

import csv
import gzip
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

from odescope.errors import InputError

MISSING = ("", " ", "NA", "N/A", "NaN", "nan", "NAN", "null", "NULL")
HEAD_BYTES = 1 << 20
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|infinity|nan)", re.IGNORECASE | re.ASCII)
RAGGED = re.compile(r"Row #(\d+): Expected (\d+) columns, got (\d+)")


@dataclass(frozen=True, slots=True)
class TextFile:
    """A text file and what its header line says: separator, column names, and how many lines come before the data."""

    path: Path
    separator: str
    names: tuple[str, ...]
    skip: int

    @property
    def decimals(self) -> tuple[str, ...]:
        """The decimal marks that may come with this separator, likeliest first."""
        return (",", ".") if self.separator == ";" else (".",)


def read_header(path: Path) -> TextFile:
    """Read the header line, skipping blank lines before it.

    Raises:
        InputError: the file is empty, not in UTF-8, or nothing follows the header.
        csv.Error: a column's name is longer than 128 KiB.
    """
    with _open(path) as stream:
        start = stream.read(HEAD_BYTES)
    lines = start.splitlines()
    filled = [k for k, line in enumerate(lines) if line.strip(b"\xef\xbb\xbf \t")]
    if not filled:
        raise InputError(f"{path.name} is empty")
    try:
        text = lines[filled[0]].decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path.name} is not in UTF-8 (its header line cannot be decoded); save it as UTF-8"
        ) from error
    if "\0" in text:
        raise InputError(f"{path.name} is not a text file in UTF-8; save it as UTF-8")
    if len(filled) == 1 and len(start) < HEAD_BYTES:
        raise InputError(f"{path.name} holds column names but no rows of data")
    bare = re.sub(r'"[^"]*"', "", text)  # a separator within quotes belongs to a name
    separator = max("\t;,", key=bare.count)
    names = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
    return TextFile(path, separator, tuple(name.strip() for name in names), filled[0] + 1)


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


def read_columns(file: TextFile, labels: Sequence[str], numeric: Sequence[str]) -> dict[str, Any]:
    """Return the labelled columns as Arrow columns: those in `numeric` of floats, null or NaN where a cell is missing.

    The cells are converted while parsing; only where that fails are they looked at one by one.

    Raises:
        InputError: a row of too few or too many cells, a cell that is not a number.
        pyarrow.ArrowInvalid: a file that Arrow cannot parse for any other reason.
    """
    import pyarrow as pa

    types = {label: pa.float64() if label in numeric else pa.string() for label in labels}
    for decimal in file.decimals:
        try:
            return _parse(file, types, decimal)
        except pa.ArrowInvalid:
            continue  # what follows finds the cells at fault, or reads those that only Arrow refuses ("+1")
    cells = _parse(file, dict.fromkeys(types, pa.binary()), ".", threads=False)
    texts = {label: [cell.decode(errors="replace") for cell in cells[label].to_pylist()] for label in labels}
    faults = {mark: {label: _faults(texts[label], mark) for label in numeric} for mark in file.decimals}
    decimal = min(faults, key=lambda mark: sum(map(len, faults[mark].values())))
    columns: dict[str, Sequence[object]] = dict(texts)
    for label in numeric:
        if rows := faults[decimal][label]:
            _refuse_cells(file, label, texts[label], rows)
        columns[label] = [_float(cell, decimal) for cell in texts[label]]
    return {label: pa.chunked_array([pa.array(columns[label], types[label])]) for label in labels}


def _parse(file: TextFile, types: Mapping[str, Any], decimal: str, threads: bool = True) -> dict[str, Any]:
    """Parse the columns named in `types`; positions stand for names, which may repeat among the unused columns."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    positions = {label: str(file.names.index(label)) for label in types}
    try:
        table = arrow_csv.read_csv(
            pa.input_stream(str(file.path), compression="gzip" if _zipped(file.path) else None),
            arrow_csv.ReadOptions(
                column_names=[str(k) for k in range(len(file.names))], skip_rows=file.skip, use_threads=threads
            ),
            arrow_csv.ParseOptions(delimiter=file.separator),
            arrow_csv.ConvertOptions(
                include_columns=list(positions.values()),
                column_types={positions[label]: kind for label, kind in types.items()},
                null_values=list(MISSING),
                decimal_point=decimal,
            ),
        )
    except pa.ArrowInvalid as error:
        ragged = RAGGED.search(str(error))  # the row handler of pyarrow fails on rows that are not UTF-8
        if ragged is None:  # rows are counted only where one thread reads
            raise
        row, expected, got = map(int, ragged.groups())
        line = _line_numbers(file, [row - file.skip - 1])[0]
        raise InputError(
            f"line {line} of {file.path.name} has {got} cell{'s' * (got != 1)} where the header has {expected}"
        ) from error
    return {label: table.column(position) for label, position in positions.items()}


def _faults(cells: Sequence[str], decimal: str) -> list[int]:
    """Return the rows whose cell is neither missing nor a plain number with this decimal mark."""
    other = "," if decimal == "." else "."
    return [
        row
        for row, cell in enumerate(cells)
        if cell.strip() not in MISSING and (other in cell or not NUMBER.fullmatch(cell.strip().replace(decimal, ".")))
    ]


def _float(cell: str, decimal: str) -> float:
    plain = cell.strip().replace(decimal, ".")
    return float("nan") if plain in MISSING else float(plain)


def _refuse_cells(file: TextFile, label: str, cells: Sequence[str], rows: list[int]) -> None:
    lines = _line_numbers(file, rows[:3])
    shown = ", ".join(f"line {line}: {cells[row][:40]!r}" for line, row in zip(lines, rows, strict=False))
    more = f" and {len(rows) - 3} more" if len(rows) > 3 else ""
    hint = "delete that line if it holds units or a comment" if rows == [0] else "empty cells and NaN count as missing"
    raise InputError(f"column {label!r} in {file.path.name} has cells that are not numbers ({shown}{more}); {hint}")


def _line_numbers(file: TextFile, rows: Sequence[int]) -> list[int]:
    """Return the line numbers in the file of some data rows, both in increasing order; Arrow skips blank lines."""
    wanted, found, row = set(rows), [], -1
    with _lines(file.path) as stream:
        for number, line in enumerate(stream, start=1):
            if number > file.skip and line != "\n":
                row += 1
                if row in wanted:
                    found.append(number)
                if len(found) == len(wanted):
                    break
    return found


def _zipped(path: Path) -> bool:
    return path.name.lower().endswith(".gz")


def _open(path: Path) -> IO[bytes]:
    return cast(IO[bytes], gzip.open(path)) if _zipped(path) else path.open("rb")


def _lines(path: Path) -> IO[str]:
    """Open for counting lines: Latin-1 decodes any byte, and all three line endings come as one."""
    return io.TextIOWrapper(_open(path), encoding="latin-1")
