"""The used columns of a table, in Arrow, by their names in the file: where every format and every frame ends up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.errors import InputError, nearest
from odescope.recordings.dates import DAY, FORMS, from_text, is_dates, is_durations, is_text
from odescope.recordings.headings import in_seconds
from odescope.recordings.layout import Layout
from odescope.recordings.text_headers import NUMBER

if TYPE_CHECKING:
    from pyarrow import Array, ChunkedArray, Table

ROUNDED = 1e-6  # of the range of whole numbers, by which floats may be off them
Columns: TypeAlias = "Mapping[str, ChunkedArray]"


def check_columns(labels: Sequence[str], available: Sequence[str], source: str) -> None:
    """Refuse labels that are not the name of exactly one column, and say which columns there are.

    Args:
        labels: wanted.
        available: the names of the columns.
        source: where these are, for messages.
    """
    for label in labels:
        count = available.count(label)
        if count > 1:
            raise InputError(f"{source} has {count} columns named {label!r}; rename all but one")
        if not count:
            hint = nearest(label, available)
            columns = ", ".join(available[:12]) + ", ..." * (len(available) > 12)
            listed = f" Its columns are: {columns}" if hint.startswith("did you mean") else ""
            bare = available and all(NUMBER.fullmatch(name) for name in available)
            header = "; its first line holds numbers, where column names are expected" if bare else ""
            raise InputError(f"no column {label!r} in {source}{header}; {hint}{listed}")


def from_table(table: Table, layout: Layout) -> Columns:
    """Return the used columns of an Arrow table: what codes of categories stand for, views of text as text."""
    return {label: _plain(table.column(label)) for label in layout.used}


def _plain(column: ChunkedArray) -> ChunkedArray:
    import pyarrow as pa

    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    return column.cast(pa.large_string()) if pa.types.is_string_view(column.type) else column


def from_arrays(arrays: Mapping[str, object], source: str) -> Columns:
    """Return arrays (N,), (N, 1) or (1, N) of one length as Arrow columns."""
    columns = {label: _arrow_column(array, label, source) for label, array in arrays.items()}
    lengths = {label: len(column) for label, column in columns.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{label!r} {length}" for label, length in lengths.items())
        raise InputError(f"the columns in {source} differ in length: {shown}")
    return columns


def _arrow_column(data: object, label: str, source: str) -> ChunkedArray:
    import pyarrow as pa

    if isinstance(data, np.ma.MaskedArray):
        data = np.ma.filled(data.astype(np.float64), np.nan)  # asarray would drop the mask without a word
    try:
        array = np.asarray(data)
        array = array.ravel() if array.ndim == 2 and 1 in array.shape else array
        native = array.astype(array.dtype.newbyteorder("="), copy=False)
        column = pa.chunked_array([_arrow_array(native)]) if array.ndim == 1 else None
    except (pa.ArrowException, ValueError, TypeError) as error:
        raise InputError(f"{label!r} in {source} is not a column of numbers: {first_line(error)}") from error
    if column is None:
        raise InputError(f"{label!r} in {source} is an array of shape {array.shape}, expected a single column")
    return column


def _arrow_array(array: np.ndarray) -> Array:
    """Return an array (N,) in Arrow, numbers by their memory: pa.array imports pandas where it is installed."""
    import pyarrow as pa

    if array.dtype.kind not in "iuf":
        return pa.array(array)
    memory = pa.py_buffer(np.ascontiguousarray(array))
    return pa.Array.from_buffers(pa.from_numpy_dtype(array.dtype), len(array), [None, memory])


def numbers(column: ChunkedArray, label: str, source: str) -> FloatArray:
    """Return a column as float64 (N,), NaN where a cell is missing.

    Args:
        column: of any numeric kind.
        label: its name, for messages.
        source: where it came from, for messages.

    Raises:
        InputError: it does not hold numbers.
    """
    import pyarrow as pa

    kind, types = column.type, pa.types
    numeric = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal, types.is_null)
    if not any(is_kind(kind) for is_kind in numeric):
        raise InputError(f"column {label!r} in {source} holds {kind}, expected numbers; convert it first")
    try:
        chunks = column.cast(pa.float64(), safe=not (types.is_integer(kind) and _may_be_rounded(column))).chunks
    except pa.ArrowException as error:
        raise InputError(f"column {label!r} in {source} does not fit 64-bit floats: {first_line(error)}") from error
    found, first = np.empty(len(column)), 0
    for chunk in chunks:
        # Through DLPack, because to_numpy imports pandas where it is installed, half a second for nothing.
        found[first : first + len(chunk)] = np.from_dlpack(chunk.fill_null(np.nan) if chunk.null_count else chunk)
        first += len(chunk)
    return found


def _may_be_rounded(column: ChunkedArray) -> bool:
    """Say whether whole numbers lose little as floats beside how far they go, as nanoseconds since 1970 do."""
    import pyarrow.compute as pc

    ends = pc.min_max(column).as_py()
    if ends["min"] is None:
        return True
    step = float(np.spacing(float(max(abs(ends["min"]), abs(ends["max"])))))
    return bool(step <= max(1.0, ROUNDED * (ends["max"] - ends["min"])))


def row_seconds(columns: Columns, layout: Layout, source: str) -> FloatArray:
    """Return the times of the rows of a table in seconds (N,), a clock's with the day that stands beside it.

    Args:
        columns: of the table.
        layout: names the column of the time, and that of the day if there is one.
        source: where the table came from, for messages.

    Raises:
        InputError: a column holds neither numbers nor dates, or the day stands beside what is no clock.
    """
    time = str(layout.time)
    found = times(columns[time], layout, source)
    if layout.date is None:
        return found
    if not is_dates(columns[time]) or np.nanmax(found, initial=0.0) >= DAY:
        raise InputError(
            f"the column {layout.date!r} holds the day of a clock, and {time!r} in {source} holds no clock, such as"
            " 12:00:00.5: leave date out of [data]"
        )
    return found + in_seconds_of_dates(columns[layout.date], layout.date, source)


def times(column: ChunkedArray, layout: Layout, source: str) -> FloatArray:
    """Return a column of times in seconds (N,), NaN where a cell is missing: of numbers, or of dates since 1970.

    Args:
        column: of numbers in the layout's unit of time, of durations, or dates, as instants, days, clocks or text.
        layout: that names it.
        source: where it came from, for messages.

    Raises:
        InputError: it holds neither.
    """
    if is_dates(column):
        return in_seconds_of_dates(column, str(layout.time), source)
    if is_durations(column):
        return _seconds(column, "duration")
    factor, over = in_seconds(layout.time_unit)
    found = numbers(column, str(layout.time), source)
    found *= factor
    found /= over
    return found


def in_seconds_of_dates(column: ChunkedArray, label: str, source: str) -> FloatArray:
    """Return a column of dates or clocks in seconds since 1970 (N,), NaN where a cell is missing.

    Args:
        column: of instants, of days or of text.
        label: its name, for messages.
        source: where it came from, for messages.

    Raises:
        InputError: it holds something else.
    """
    import pyarrow as pa

    if is_text(column):
        column = from_text(column, label, source)
    if pa.types.is_date(column.type):
        column = column.cast(pa.timestamp("s"))
    if pa.types.is_time(column.type):
        return _seconds(column, "time64")
    if not pa.types.is_timestamp(column.type):
        raise InputError(f"column {label!r} in {source} holds {column.type}, expected dates; {FORMS}")
    return _seconds(column, "timestamp")


def _seconds(column: ChunkedArray, kind: Literal["timestamp", "time64", "duration"]) -> FloatArray:
    """Return a column of instants, clocks or durations in seconds (N,), NaN where a cell is missing.

    Args:
        column: that counts in any unit.
        kind: of its type.
    """
    import pyarrow as pa

    fine = pa.timestamp("ns", column.type.tz) if kind == "timestamp" else getattr(pa, kind)("ns")
    ticks = column.cast(fine).cast(pa.int64()).combine_chunks()
    seconds = 1e-9 * ticks.fill_null(0).to_numpy().astype(np.float64)
    found: FloatArray = np.where(ticks.is_null().to_numpy(zero_copy_only=False), np.nan, seconds)
    return found


def recording_codes(columns: Columns, layout: Layout, source: str) -> tuple[list[str], IntArray]:
    """Return the labels of the recordings, in order of first appearance, and the index (N,) into them of each row.

    Args:
        columns: of the table.
        layout: says which of them labels recordings.
        source: where the table came from, for messages.

    Raises:
        InputError: a row without a label.
    """
    if layout.recording is None:
        return [""], np.zeros(len(columns[layout.numeric[0]]), dtype=np.int64)
    labels = columns[layout.recording].combine_chunks().dictionary_encode()
    names = [str(name) for name in labels.dictionary.to_pylist()]
    if labels.null_count or "" in names or "nan" in names:
        raise InputError(f"column {layout.recording!r} in {source} has empty cells: every row needs its recording")
    return names, labels.indices.to_numpy().astype(np.int64)


def first_line(error: BaseException) -> str:
    """Return the first line of what an error says."""
    return (str(error).splitlines() or [type(error).__name__])[0]
