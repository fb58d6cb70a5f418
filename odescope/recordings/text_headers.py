"""The header line of a text file of numbers: names of columns, what separates them, decimal marks, cells in a row."""

from __future__ import annotations

import csv
import gzip
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import IO, cast

from odescope.errors import InputError
from odescope.recordings.dates import DATE

HEAD_BYTES = 1 << 20
SAID = re.compile(r"sep=([;,|\t])", re.IGNORECASE)  # the first line of spreadsheets' own: what separates
COMMENT = re.compile(r"^[ \t]*#++ *+(?=[^,;|\t])")  # what makes a line one; a "#" alone in its cell is a name
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|infinity|nan)", re.IGNORECASE | re.ASCII)
DECIMAL_COMMA = re.compile(rb"\d,\d")
QUOTED_COMMA = re.compile(rb'"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*"')  # where commas separate


@dataclass(frozen=True, slots=True)
class TextFile:
    """A text file, or a part of one, and what its header line says.

    `skip` lines come before the data; `decimals` are the decimal marks that its numbers may have, likeliest first.
    A part is the bytes from `begin` to `end` of the file, and holds `rows` data rows after the `first` ones.
    """

    path: Path
    separator: str
    names: tuple[str, ...]
    skip: int
    decimals: tuple[str, ...]
    begin: int = 0
    end: int | None = None
    first: int = 0
    rows: int | None = None


def read_header(path: Path) -> TextFile:
    """Read the header line, skipping blank lines and comments before it (see `_header_line`).

    Raises:
        InputError: the file is empty, no text of one byte a character, or nothing follows the header.
        csv.Error: a column's name is longer than 128 KiB.
    """
    with open_bytes(path) as stream:
        start = stream.read(HEAD_BYTES)
    lines = start.splitlines()
    filled = [k for k, line in enumerate(lines) if line.strip(b"\xef\xbb\xbf \t")]
    if not filled:
        raise InputError(f"{path.name} is empty")
    text = _decoded(lines[filled[0]])
    if "\0" in text:
        raise InputError(f"{path.name} is not a text file in UTF-8; save it as UTF-8")
    said = SAID.fullmatch(text.strip(" \r\n"))
    told = said is not None and len(filled) > 1
    at = _header_line(lines, filled[told:], None if said is None else said[1])
    text = COMMENT.sub("", _decoded(lines[at]))
    while text.count('"') % 2 and at + 1 < len(lines):  # a line break within quotes belongs to a name
        at += 1
        text = f"{text} {_decoded(lines[at])}"
    if filled[-1] <= at and len(start) < HEAD_BYTES:
        raise InputError(f"{path.name} holds column names but no rows of data")
    bare = re.sub(r'"[^"]*"', "x", text)  # a separator within quotes belongs to a name
    below = next((_decoded(lines[k]).rstrip() for k in filled if k > at), "")
    separator = _separator(path, bare.rstrip(), below) if said is None else said[1]
    names = _cells(text, separator)
    mark = QUOTED_COMMA if separator == "," else DECIMAL_COMMA
    commas = mark.search(b"\n".join(lines[at + 1 :])) is not None
    decimals = (",", ".") if separator == ";" else (".", ",") if commas else (".",)
    return TextFile(path, separator, tuple(" ".join(name.split()) for name in names), at + 1, decimals)


def _header_line(lines: Sequence[bytes], filled: Sequence[int], separator: str | None) -> int:
    """Return which line is the header: the first that begins with no "#", unless the last comment above has the names.

    Such a comment has as many cells as the line below, and that holds a number or a date, as no header does.

    Args:
        lines: of the file.
        filled: those of them that are not blank.
        separator: of cells, where the file says it.
    """
    comments = list(takewhile(lambda k: _decoded(lines[k]).lstrip().startswith("#"), filled))
    if not comments or len(comments) == len(filled):
        return filled[len(comments) - 1 if comments else 0]
    below = filled[len(comments)]
    row = _decoded(lines[below])
    # More commas may be decimal marks, and dates hold spaces.
    separator = separator or next((mark for mark in "\t;,| " if mark in row), ",")
    cells = _cells(row, separator)
    data = any(NUMBER.fullmatch(cell.strip().replace(",", ".")) or DATE.match(cell) for cell in cells)
    names = _cells(COMMENT.sub("", _decoded(lines[comments[-1]])), separator)
    return comments[-1] if data and _counts(names) & _counts(cells) else below


def _separator(path: Path, header: str, below: str) -> str:
    """Return what separates the cells of a header: a tab, semicolon or comma, else what the line below has as often.

    Args:
        path: of the file, for messages.
        header: the line, without what stands in quotes.
        below: the line below, empty where there is none.

    Raises:
        InputError: names and numbers are spread over columns of text.
    """
    if any(mark in header for mark in "\t;,"):
        return max("\t;,", key=header.count)
    for mark in "| ":
        names, cells = header.rstrip(mark).split(mark), below.rstrip(mark).split(mark)
        if len(names) == len(cells) > 1 and all(name.strip() for name in names):
            return mark
    numbers = below.split()
    if len(numbers) == len(header.split()) > 1 and all(NUMBER.fullmatch(word) for word in numbers):
        raise InputError(
            f"several spaces stand between the columns of {path.name}: expected a comma, a semicolon, a tab, or a"
            " single space; save it with one of these"
        )
    return ","


def _cells(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True))


def _counts(cells: Sequence[str]) -> set[int]:
    """Return how many cells a line has, with and without an empty one behind a separator that ends it."""
    return {len(cells), len(cells) - (not cells[-1].strip())}


def _decoded(line: bytes) -> str:
    """Return a header line of UTF-8, or of Windows in western Europe, where spreadsheets save in that unless asked."""
    try:
        return line.decode("utf-8-sig")
    except UnicodeDecodeError:
        return line.decode("cp1252", errors="replace")


def evened(file: TextFile) -> bytes:
    """Return a file or part whose rows have as many cells as the header, where they differ by an empty last one.

    Loggers end each row with a separator, or only the header, or only some rows. Other rows stay as they are.
    """
    with open_bytes(file.path) as stream:
        stream.seek(file.begin)
        text = stream.read() if file.end is None else stream.read(file.end - file.begin)
    names, split = file.names, re.escape(file.separator.encode())
    named = len(names) - (len(names) > 1 and not names[-1])
    cell = rb'(?:"(?:[^"\r\n]|"")*+"[^%b\r\n]*+|[^"%b\r\n][^%b\r\n]*+|)' % (split, split, split)
    row = rb"(?<![^\r\n])(?=[^\r\n])(%b(?:%b%b){%d})%b? *(?![^\r\n])" % (cell, split, cell, named - 1, split)
    return re.sub(row, rb"\1" + file.separator.encode() * (len(names) - named), text)


def zipped(path: Path) -> bool:
    """Return whether a file is compressed, by its name."""
    return path.name.lower().endswith(".gz")


def open_bytes(path: Path) -> IO[bytes]:
    """Open a text file, compressed or not."""
    return cast(IO[bytes], gzip.open(path)) if zipped(path) else path.open("rb")
