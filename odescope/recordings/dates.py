"""Times that are text: dates and clocks, as loggers and spreadsheets write them."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError

if TYPE_CHECKING:
    from pyarrow import ChunkedArray

# What pandas reads as missing, and MATLAB, R and spreadsheets write.
MISSING = (
    *("", " ", "NA", "N/A", "n/a", "NaN", "nan", "NAN", "-nan", "-NaN", "null", "NULL", "None", "<NA>"),
    *("#N/A", "#N/A N/A", "#NA", "1.#IND", "-1.#IND", "1.#QNAN", "-1.#QNAN"),
)
DATE = re.compile(r"\s*(\d{1,4}[-./]\d{1,2}[-./]\d{1,4}\b|\d{1,2}:\d{2}\b)", re.ASCII)
FORMS = "dates are read as 2024-01-31 12:00:00.5 or 31.01.2024 12:00:00,5, clocks as 12:00:00.5"
DAY = 86_400  # seconds
SLASHES = "31/01/2024 is not read, as 01/02/2024 may be two days"
_ISO = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d(:\d\d(\.\d+)?)?Z?", re.ASCII)
# To ISO 8601, one after the other. Where dots stand between, the day comes first in every country that writes so.
_TO_ISO = (
    (r"^\s+|\s+$", ""),
    (r"(\d),(\d)", r"\1.\2"),
    (r"^(\d{1,2}:)", r"1970-01-01 \1"),
    (r"^(\d)\.", r"0\1."),
    (r"^(\d\d)\.(\d)\.", r"\1.0\2."),
    (r"^(\d\d)\.(\d\d)\.(\d{4})\b", r"\3-\2-\1"),
    (r"^(\d{4})[./](\d\d)[./](\d\d)\b", r"\1-\2-\3"),
    (r"^(\S+)[ T]+(\d):", r"\1 0\2:"),
)


def is_text(column: ChunkedArray) -> bool:
    """Return whether the cells of a column are text."""
    import pyarrow as pa

    return bool(pa.types.is_string(column.type) or pa.types.is_large_string(column.type))


def is_dates(column: ChunkedArray) -> bool:
    """Return whether a column holds dates: instants, days, clocks, or text that was read as such."""
    import pyarrow as pa

    kinds = (pa.types.is_timestamp, pa.types.is_date, pa.types.is_time)
    return any(is_kind(column.type) for is_kind in kinds) or is_text(column)


def is_durations(column: ChunkedArray) -> bool:
    """Return whether a column holds times that passed, which know their unit."""
    import pyarrow as pa

    return bool(pa.types.is_duration(column.type))


def in_zone(column: ChunkedArray) -> bool:
    """Return whether a column of dates says which zone they are of, which is then that of UTC."""
    import pyarrow as pa

    if is_text(column):
        return any(cell.rstrip().endswith("Z") for cell in column.drop_null()[:1].to_pylist())
    return bool(pa.types.is_timestamp(column.type)) and column.type.tz is not None


def to_text(t: FloatArray, zoned: bool) -> list[str]:
    """Return times in seconds since 1970 (N,) as dates of ISO 8601, or as clocks where all are of its first day.

    They have as many decimals as tell the microseconds of all: a 64-bit float of these decades knows no more.

    Args:
        t: the times.
        zoned: whether the dates say that they are of UTC.
    """
    ticks = np.rint(1e6 * t).astype(np.int64)
    digits = next(d for d in range(7) if not np.any(ticks % 10 ** (6 - d)))
    end = -(6 - digits + (digits == 0)) or None  # the point goes with the last of them
    shown = [text[:end].replace("T", " ") for text in np.datetime_as_string(ticks.astype("datetime64[us]")).tolist()]
    if len(ticks) and ticks.min() >= 0 and ticks.max() < DAY * 1_000_000:
        return [text.partition(" ")[2] for text in shown]
    return [f"{text}Z" for text in shown] if zoned else shown


def from_text(column: ChunkedArray, label: str, source: str) -> ChunkedArray:
    """Return a column of text as instants, null where a cell is missing; clocks are those of the first day of 1970.

    Args:
        column: of dates, the year or the day first, or of clocks.
        label: its name, for messages.
        source: where it came from, for messages.

    Raises:
        InputError: a cell is neither.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    text = pc.if_else(pc.is_in(column, pa.array(MISSING, column.type)), pa.scalar(None, column.type), column)
    for pattern, written in _TO_ISO:
        text = pc.replace_substring_regex(text, pattern, written)
    for zone in (None, "UTC"):
        with contextlib.suppress(pa.ArrowInvalid):
            return text.cast(pa.timestamp("ns", zone))
    shown = next((cell for cell, iso in _cells(column, text) if not _ISO.fullmatch(iso)), column.drop_null()[0].as_py())
    raise InputError(
        f"column {label!r} in {source} holds text that is no time, such as {shown[:40]!r}; {date_hint(shown)}"
    )


def _cells(column: ChunkedArray, text: ChunkedArray) -> Iterator[tuple[str, str]]:
    """Yield the cells that are not missing, as they were and as they were written anew."""
    pairs = zip(column.to_pylist(), text.to_pylist(), strict=True)
    return ((cell, iso) for cell, iso in pairs if iso is not None)


def date_hint(cell: str) -> str:
    """Return what is said of a time that cannot be read."""
    return f"{FORMS}; {SLASHES}" if re.search(r"\d/\d", cell) else FORMS
