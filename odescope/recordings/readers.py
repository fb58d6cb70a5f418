"""Reads recordings: CSV, Parquet and MATLAB files, dataframes and plain arrays become Records."""

from __future__ import annotations

import contextlib
import csv
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.errors import InputError, nearest
from odescope.recordings.record import Record, Records
from odescope.recordings.sampling import LARGEST_JITTER, Gaps, RawRun, split_gaps, uniform, unwrap
from odescope.recordings.text_files import NUMBER, TextFile, read_columns, read_header, refuse_blank_lines

TEXT = (".csv", ".txt", ".tsv", ".csv.gz", ".txt.gz", ".tsv.gz")
PARQUET = (".parquet", ".pq")
MATLAB = (".mat",)
NO_LABEL = "__HIVE_DEFAULT_PARTITION__"  # the folder of the rows whose cell was empty


@dataclass(frozen=True, slots=True)
class Layout:
    """Which columns of a file mean what, and what to do about gaps and jitter.

    `columns` and `units` are pairs (name in odescope, column in the file) and (name, unit); `angles` and `held` hold
    names in odescope; `time` and `recording` are columns in the file, or `recording` a folder's key (lap=7/a.parquet).

    Raises:
        InputError: not exactly one of `time` and `sample_period`, no column, a tolerance or period out of range.
    """

    time: str | None = None
    sample_period: float | None = None
    columns: tuple[tuple[str, str], ...] = ()
    units: tuple[tuple[str, str], ...] = ()
    angles: frozenset[str] = frozenset()
    held: frozenset[str] = frozenset()
    recording: str | None = None
    gaps: Gaps = "refuse"
    jitter: float = 0.05

    def __post_init__(self) -> None:
        if (self.time is None) == (self.sample_period is None):
            raise InputError("[data] needs exactly one of time (a column's name) and sample_period (a number)")
        if self.sample_period is not None and not 0 < self.sample_period < float("inf"):
            raise InputError(f"sample_period must be a positive number, got {self.sample_period!r}")
        if not self.columns:
            raise InputError("no column to read: name at least one coordinate")
        if self.gaps not in ("refuse", "split"):
            raise InputError(f"gaps must be 'refuse' or 'split', got {self.gaps!r}")
        if not 0 <= self.jitter <= LARGEST_JITTER:
            raise InputError(f"jitter must be between 0 and {LARGEST_JITTER} sample periods, got {self.jitter!r}")
        for name in (*(name for name, _ in self.units), *self.angles, *self.held):
            if name not in self.names:
                raise InputError(
                    f"the layout names {name!r}, which is not among its columns; {nearest(name, self.names)}"
                )

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns in odescope."""
        return tuple(name for name, _ in self.columns)

    @property
    def numeric(self) -> tuple[str, ...]:
        """The file's columns that must hold numbers, each once."""
        time = () if self.time is None else (self.time,)
        return tuple(dict.fromkeys((*time, *(column for _, column in self.columns))))

    @property
    def used(self) -> tuple[str, ...]:
        """The file's columns that are read at all, each once."""
        return tuple(dict.fromkeys((*self.numeric, *(() if self.recording is None else (self.recording,)))))


def read_records(files: Sequence[Path], layout: Layout) -> Records:
    """Read one recording a file, or several by the layout's `recording` column, ready for use.

    Each is split or refused at gaps, its angles are unwrapped, its time made uniform (see sampling). A folder stands
    for the Parquet files in it.

    Raises:
        InputError: a file that is missing, unreadable, of another kind, or whose columns do not serve.
    """
    if not files:
        raise InputError("no data file: expected at least one")
    runs = [run for file in find_files(files) for run in _runs(_read_file(file, layout), layout, file.name)]
    return Records(tuple(runs))


def find_files(files: Sequence[Path]) -> tuple[Path, ...]:
    """Return the files, a folder replaced by the Parquet files in it and in its folders, in order of their paths.

    What begins with "_" or "." is left out, as whoever writes such a dataset puts notes there.

    Raises:
        InputError: a folder without Parquet files.
    """
    return tuple(file for path in map(Path, files) for file in (_dataset(path) if path.is_dir() else (path,)))


def _dataset(folder: Path) -> list[Path]:
    files: list[Path] = []
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(("_", "."))]  # the walk goes only into these
        files += [Path(place, name) for name in names if name.lower().endswith(PARQUET) and name[0] not in "_."]
    if not files:
        raise InputError(
            f"{folder} is a directory without Parquet files ({', '.join(PARQUET)}), expected a data file or a folder of"
            " Parquet files; name files of other kinds one by one"
        )
    return sorted(files)


def records_from(data: object, layout: Layout) -> Records:
    """Take recordings from a dataframe (Arrow interface), a mapping of name to array, or a list of these.

    Raises:
        InputError: columns that are missing, not numbers or of different length, and whatever read_records refuses.
    """
    tables = list(data) if isinstance(data, (list, tuple)) else [data]
    if not tables:
        raise InputError("no data: expected at least one table")
    sources = [f"table {k}" for k in range(1, len(tables) + 1)] if len(tables) > 1 else ["the data"]
    runs = [
        run
        for table, source in zip(tables, sources, strict=True)
        for run in _runs(_from_memory(table, layout, source), layout, source)
    ]
    return Records(tuple(runs))


def _runs(columns: dict[str, Any], layout: Layout, source: str) -> Iterator[Record]:
    """Turn the used columns (Arrow, by their names in the file) into the records of one table."""
    check_rows(len(columns[layout.numeric[0]]), source)
    for run in raw_runs(columns, layout, source, _recordings(columns, layout, source)):
        for record in split_gaps(run, layout.gaps):
            yield ready(record, layout)


def ready(record: Record, layout: Layout) -> Record:
    """Return a record without gaps ready for use: its angles unwrapped, its time uniform.

    Raises:
        InputError: an angle in degrees, or time that is not uniform to within the layout's jitter.
    """
    return uniform(unwrap(record, layout.angles), layout.jitter, layout.held)


def raw_runs(
    columns: Mapping[str, Any], layout: Layout, source: str, groups: Iterable[tuple[str, IntArray]], before: int = 0
) -> Iterator[RawRun]:
    """Return the runs of a table of the used columns (Arrow, by their names in the file), `source` in messages.

    `groups` are the label and the row indices (n,) of each; `before` rows of the file come before the table.

    Raises:
        InputError: a column that does not hold numbers.
    """
    numbers = {label: _numbers(columns[label], label, source) for label in layout.numeric}
    values = np.column_stack([numbers[column] for _, column in layout.columns])
    units = dict(layout.units)
    counted = np.arange(len(values), dtype=np.float64) * (layout.sample_period or 0.0)
    for label, rows in groups:
        yield RawRun(
            t=counted[: len(rows)] if layout.time is None else numbers[layout.time][rows],
            values=values[rows],
            names=layout.names,
            units=tuple(units.get(name) for name in layout.names),
            source=f"{source} ({layout.recording} {label})" if layout.recording is not None else source,
            rows=before + rows + 1,
            labels=tuple(column for _, column in layout.columns),
        )


def check_rows(rows: int, source: str) -> None:
    """Refuse a table without rows."""
    if not rows:
        raise InputError(f"{source} holds column names but no rows of data")


def _recordings(columns: Mapping[str, Any], layout: Layout, source: str) -> list[tuple[str, IntArray]]:
    """Return each recording's label and row indices, in order of first appearance."""
    names, codes = recording_codes(columns, layout, source)
    order = np.argsort(codes, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(codes))[:-1])
    return list(zip(names, groups, strict=True))


def recording_codes(columns: Mapping[str, Any], layout: Layout, source: str) -> tuple[list[str], IntArray]:
    """Return the labels of the recordings, in order of first appearance, and the index (N,) into them of each row.

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


def _numbers(column: Any, label: str, source: str) -> FloatArray:
    """Return an Arrow column as float64 (N,), NaN where a cell is missing."""
    import pyarrow as pa

    kind, types = column.type, pa.types
    numeric = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal, types.is_null)
    if not any(is_kind(kind) for is_kind in numeric):
        raise InputError(f"column {label!r} in {source} holds {kind}, expected numbers; convert it first")
    try:
        # Through DLPack, because to_numpy imports pandas where it is installed, half a second for nothing.
        filled = column.cast(pa.float64()).fill_null(float("nan")).combine_chunks()
        return np.array(np.from_dlpack(filled), dtype=np.float64)
    except pa.ArrowException as error:
        raise InputError(f"column {label!r} in {source} does not fit 64-bit floats: {_first_line(error)}") from error


def check_columns(labels: Sequence[str], available: Sequence[str], source: str) -> None:
    """Refuse labels that are not the name of exactly one column, and say which columns there are."""
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


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _read_file(path: Path, layout: Layout) -> dict[str, Any]:
    """Return the used columns of a file as Arrow columns by their names in the file."""
    columns: dict[str, Any] = opened(path, _READERS)(path, layout)
    return columns


def column_names(path: Path) -> tuple[str, ...]:
    """Return the names of the columns of a data file, or of the first one in a folder.

    Raises:
        InputError: the file is missing, empty, of no known kind or damaged.
    """
    file = find_files([path])[0]
    return tuple(opened(file, _NAMES)(file))


def opened(path: Path, readers: Mapping[tuple[str, ...], Callable[..., Any]]) -> Callable[..., Any]:
    """Return the one of `readers`, by the endings of names, that serves a file; its errors are worded for the user.

    Raises:
        InputError: the file is missing, empty or of no known kind.
    """
    import pyarrow as pa

    read = next((reader for endings, reader in readers.items() if path.name.lower().endswith(endings)), None)
    if path.is_dir():
        raise InputError(f"{path} is a directory, expected a data file")
    if not path.exists():
        raise InputError(f"no such file: {path}")
    if read is None:
        raise InputError(f"{path.name} is of no known kind; expected one of {', '.join((*TEXT, *PARQUET, *MATLAB))}")
    if not path.stat().st_size:
        raise InputError(f"{path.name} is empty")

    def worded(*arguments: Any) -> Any:
        try:
            return read(*arguments)
        except (pa.ArrowException, OSError, EOFError, csv.Error) as error:
            raise InputError(f"{path.name} cannot be read: {_first_line(error)}") from error

    return worded


def _read_text(path: Path, layout: Layout) -> dict[str, Any]:
    file = text_header(path, layout)
    if layout.time is None:
        refuse_blank_lines(file)
    return read_columns(file, layout.used, layout.numeric)


def text_header(path: Path, layout: Layout) -> TextFile:
    """Return what the header of a text file says; InputError where it lacks a column."""
    file = read_header(path)
    check_columns(layout.used, file.names, path.name)
    return file


def _read_parquet(path: Path, layout: Layout) -> dict[str, Any]:
    from pyarrow import parquet

    with parquet.ParquetFile(path) as file:
        return parquet_columns(file.read(columns=parquet_labels(file, path, layout)), path, layout)


def parquet_labels(file: Any, path: Path, layout: Layout) -> list[str]:
    """Return which columns of a Parquet file to read; InputError where one is lacking."""
    names = file.schema_arrow.names
    in_path = layout.recording not in names and _folder_label(path, layout) is not None
    labels = [label for label in layout.used if not (in_path and label == layout.recording)]
    check_columns(labels, names, path.name)
    return labels


def parquet_columns(table: Any, path: Path, layout: Layout) -> dict[str, Any]:
    """Return the used columns of a table of `parquet_labels`, the recording from the path where the file lacks it."""
    import pyarrow as pa

    if layout.recording is not None and layout.recording not in table.column_names:
        label = pa.scalar(_folder_label(path, layout), pa.string())
        table = table.append_column(layout.recording, pa.repeat(label, len(table)))
    return _from_table(table, layout)


def _folder_label(path: Path, layout: Layout) -> str | None:
    """Return what a folder KEY=VALUE on the path says of the recording, None if none does."""
    for key, equals, value in (part.partition("=") for part in reversed(path.absolute().parent.parts)):
        if equals and unquote(key) == layout.recording:
            return "" if value == NO_LABEL else unquote(value)
    return None


def _from_memory(data: object, layout: Layout, source: str) -> dict[str, Any]:
    """Return the used columns of a dataframe or a mapping as Arrow columns."""
    import pyarrow as pa

    if hasattr(data, "__arrow_c_stream__"):
        try:
            table = pa.table(data)
        except (pa.ArrowException, ValueError, TypeError) as error:
            raise InputError(f"{source} cannot be read as a table: {_first_line(error)}") from error
        check_columns(layout.used, table.column_names, source)
        return _from_table(table, layout)
    if isinstance(data, Mapping):
        named = {str(name): column for name, column in data.items()}
        check_columns(layout.used, list(named), source)
        return _from_arrays({label: named[label] for label in layout.used}, source)
    raise InputError(
        f"{source} is a {type(data).__name__}; expected a dataframe with the Arrow interface (pandas, polars, pyarrow)"
        ", a mapping of name to array, or a list of these; files go to read_records"
    )


def _from_table(table: Any, layout: Layout) -> dict[str, Any]:
    """Return the used columns of an Arrow table, the codes of categories replaced by what they stand for."""
    import pyarrow as pa

    columns = {label: table.column(label) for label in layout.used}
    return {
        label: column.cast(column.type.value_type) if pa.types.is_dictionary(column.type) else column
        for label, column in columns.items()
    }


def _from_arrays(arrays: Mapping[str, object], source: str) -> dict[str, Any]:
    """Return arrays (N,), (N, 1) or (1, N) of one length as Arrow columns."""
    columns = {label: _arrow_column(array, label, source) for label, array in arrays.items()}
    lengths = {label: len(column) for label, column in columns.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{label!r} {length}" for label, length in lengths.items())
        raise InputError(f"the columns in {source} differ in length: {shown}")
    return columns


def _arrow_column(data: object, label: str, source: str) -> Any:
    import pyarrow as pa

    if isinstance(data, np.ma.MaskedArray):
        data = np.ma.filled(data.astype(np.float64), np.nan)  # asarray would drop the mask without a word
    try:
        array = np.asarray(data)
        array = array.ravel() if array.ndim == 2 and 1 in array.shape else array
        native = array.astype(array.dtype.newbyteorder("="), copy=False)
        column = pa.chunked_array([pa.array(native)]) if array.ndim == 1 else None
    except (pa.ArrowException, ValueError, TypeError) as error:
        raise InputError(f"{label!r} in {source} is not a column of numbers: {_first_line(error)}") from error
    if column is None:
        raise InputError(f"{label!r} in {source} is an array of shape {array.shape}, expected a single column")
    return column


def _read_matlab(path: Path, layout: Layout) -> dict[str, Any]:
    from scipy.io import loadmat

    matlab_rows(path, layout)
    with _matlab_faults(path):
        arrays = loadmat(path, variable_names=list(layout.used))
    return _from_arrays({label: arrays[label] for label in layout.used}, path.name)


def matlab_rows(path: Path, layout: Layout) -> int:
    """Return how many rows the used variables of a MATLAB file have, by the first of them.

    Raises:
        InputError: a variable is lacking or no column, or the file is none of MATLAB's.
    """
    from scipy.io import whosmat

    with _matlab_faults(path):
        kinds = {name: (shape, kind) for name, shape, kind in whosmat(path)}
        _check_variables(kinds, layout, path.name)
    return math.prod(kinds[layout.used[0]][0])


@contextlib.contextmanager
def _matlab_faults(path: Path) -> Iterator[None]:
    from scipy.io.matlab import MatReadError

    try:
        yield
    except InputError:  # a ValueError too, but already worded
        raise
    except NotImplementedError as error:  # scipy's answer to HDF5
        raise InputError(f"{path.name} is a MATLAB 7.3 file; save it with save(..., '-v7')") from error
    except (MatReadError, ValueError, TypeError, KeyError, IndexError) as error:
        raise InputError(f"{path.name} cannot be read as a MATLAB file: {_first_line(error)}") from error


def _check_variables(kinds: Mapping[str, tuple[tuple[int, ...], str]], layout: Layout, source: str) -> None:
    """Refuse variables that are no columns; where one is lacking, say which variables may be hiding it."""
    hiding = [name for name, (shape, kind) in kinds.items() if not _is_column(shape, kind)]
    for label in layout.used:
        if label in hiding or (hiding and label not in kinds):
            name = label if label in kinds else hiding[0]
            shape, kind = kinds[name]
            size = "x".join(map(str, shape))
            lacking = f"no variable {label!r} in {source}; " if label not in kinds else f"in {source}, "
            raise InputError(
                f"{lacking}{name!r} is a {size} {kind}: save each column as a variable of its own (for a struct, "
                "save(file, '-struct', name) does it)"
            )
    check_columns(layout.used, list(kinds), source)


def _is_column(shape: tuple[int, ...], kind: str) -> bool:
    return kind not in ("struct", "cell", "object", "function", "opaque", "sparse", "char") and (
        len(shape) == 1 or (len(shape) == 2 and 1 in shape)
    )


def _parquet_names(path: Path) -> list[str]:
    from pyarrow import parquet

    with parquet.ParquetFile(path) as file:
        names: list[str] = file.schema_arrow.names
        return names


def _matlab_names(path: Path) -> list[str]:
    from scipy.io import whosmat

    return [name for name, _, _ in whosmat(path)]


_READERS = {TEXT: _read_text, PARQUET: _read_parquet, MATLAB: _read_matlab}
_NAMES = {TEXT: lambda path: read_header(path).names, PARQUET: _parquet_names, MATLAB: _matlab_names}
