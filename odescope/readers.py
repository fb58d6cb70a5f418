"""Reads recordings: CSV, Parquet and MATLAB files, dataframes and plain arrays become Records."""

from __future__ import annotations

import csv
import gzip
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.errors import InputError, nearest
from odescope.records import LARGEST_JITTER, Gaps, RawRun, Record, Records, split_gaps, uniform, unwrap

TEXT = (".csv", ".txt", ".tsv", ".csv.gz", ".txt.gz", ".tsv.gz")
PARQUET = (".parquet", ".pq")
MATLAB = (".mat",)
MISSING = ("", " ", "NA", "N/A", "NaN", "nan", "NAN", "null", "NULL")
HEAD_BYTES = 1 << 20
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|infinity|nan)", re.IGNORECASE | re.ASCII)
RAGGED = re.compile(r"Row #(\d+): Expected (\d+) columns, got (\d+)")


@dataclass(frozen=True, slots=True)
class Layout:
    """Which columns of a file mean what, and what to do about gaps and jitter.

    `columns` and `units` are pairs (name in odescope, column in the file) and (name, unit); `angles` and `held` hold
    names in odescope; `time` and `recording` are columns in the file.

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

    Each is split or refused at gaps, its angles are unwrapped, its sampling made uniform (see records).

    Raises:
        InputError: a file that is missing, unreadable, of another kind, or whose columns do not serve.
    """
    if not files:
        raise InputError("no data file: expected at least one")
    runs = [run for file in map(Path, files) for run in _runs(_read_file(file, layout), layout, file.name)]
    return Records(tuple(runs))


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
    numbers = {label: _numbers(columns[label], label, source) for label in layout.numeric}
    values = np.column_stack([numbers[column] for _, column in layout.columns])
    if not len(values):
        raise InputError(f"{source} holds column names but no rows of data")
    units = dict(layout.units)
    for label, rows in _recordings(columns, layout, len(values), source):
        raw = RawRun(
            t=numbers[layout.time][rows] if layout.time is not None else _counted_time(len(rows), layout),
            values=values[rows],
            names=layout.names,
            units=tuple(units.get(name) for name in layout.names),
            source=f"{source} ({layout.recording} {label})" if layout.recording is not None else source,
            rows=rows + 1,
            labels=tuple(column for _, column in layout.columns),
        )
        for piece in split_gaps(raw, layout.gaps):
            yield uniform(unwrap(piece, layout.angles), layout.jitter, layout.held)


def _counted_time(samples: int, layout: Layout) -> FloatArray:
    return np.arange(samples, dtype=np.float64) * (layout.sample_period or 0.0)


def _recordings(columns: dict[str, Any], layout: Layout, rows: int, source: str) -> list[tuple[str, IntArray]]:
    """Return each recording's label and row indices, in order of first appearance."""
    if layout.recording is None:
        return [("", np.arange(rows))]
    labels = columns[layout.recording].combine_chunks().dictionary_encode()
    names = [str(name) for name in labels.dictionary.to_pylist()]
    if labels.null_count or "" in names or "nan" in names:
        raise InputError(f"column {layout.recording!r} in {source} has empty cells: every row needs its recording")
    codes = labels.indices.to_numpy().astype(np.int64)
    order = np.argsort(codes, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(codes))[:-1])
    return list(zip(names, groups, strict=True))


def _numbers(column: Any, label: str, source: str) -> FloatArray:
    """Return an Arrow column as float64 (N,), NaN where a cell is missing."""
    import pyarrow as pa

    kind, types = column.type, pa.types
    numeric = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal, types.is_null)
    if not any(is_kind(kind) for is_kind in numeric):
        raise InputError(f"column {label!r} in {source} holds {kind}, expected numbers; convert it first")
    try:
        return np.asarray(column.cast(pa.float64()).to_numpy(), dtype=np.float64)
    except pa.ArrowException as error:
        raise InputError(f"column {label!r} in {source} does not fit 64-bit floats: {_first_line(error)}") from error


def _locate(label: str, available: Sequence[str], source: str) -> int:
    """Return the position of a column, or say which there are."""
    count = list(available).count(label)
    if count > 1:
        raise InputError(f"{source} has {count} columns named {label!r}; rename all but one")
    if not count:
        hint = nearest(label, available)
        listed = f" Its columns are: {_listed(available)}" if hint.startswith("did you mean") else ""
        bare = available and all(NUMBER.fullmatch(name) for name in available)
        header = "; its first line holds numbers, where column names are expected" if bare else ""
        raise InputError(f"no column {label!r} in {source}{header}; {hint}{listed}")
    return list(available).index(label)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:12]) + ", ..." * (len(names) > 12)


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _read_file(path: Path, layout: Layout) -> dict[str, Any]:
    """Return the used columns of a file as Arrow columns by their names in the file."""
    import pyarrow as pa

    readers = {TEXT: _read_text, PARQUET: _read_parquet, MATLAB: _read_matlab}
    read = next((reader for endings, reader in readers.items() if path.name.lower().endswith(endings)), None)
    if path.is_dir():
        raise InputError(f"{path} is a directory, expected a data file")
    if not path.exists():
        raise InputError(f"no such file: {path}")
    if read is None:
        raise InputError(f"{path.name} is of no known kind; expected one of {', '.join((*TEXT, *PARQUET, *MATLAB))}")
    if not path.stat().st_size:
        raise InputError(f"{path.name} is empty")
    try:
        return read(path, layout)
    except (pa.ArrowException, OSError, EOFError, csv.Error) as error:
        raise InputError(f"{path.name} cannot be read: {_first_line(error)}") from error


def _read_parquet(path: Path, layout: Layout) -> dict[str, Any]:
    from pyarrow import parquet

    with parquet.ParquetFile(path) as file:
        available = file.schema_arrow.names
        for label in layout.used:
            _locate(label, available, path.name)
        table = file.read(columns=list(layout.used))
    return {label: _decoded(table.column(label)) for label in layout.used}


def _decoded(column: Any) -> Any:
    """Replace the codes of a categorical column by what they stand for."""
    import pyarrow as pa

    return column.cast(column.type.value_type) if pa.types.is_dictionary(column.type) else column


def _from_memory(data: object, layout: Layout, source: str) -> dict[str, Any]:
    """Return the used columns of a dataframe or a mapping as Arrow columns."""
    import pyarrow as pa

    if hasattr(data, "__arrow_c_stream__"):
        try:
            table = pa.table(data)
        except (pa.ArrowException, ValueError, TypeError) as error:
            raise InputError(f"{source} cannot be read as a table: {_first_line(error)}") from error
        return {label: _decoded(table.column(_locate(label, table.column_names, source))) for label in layout.used}
    if isinstance(data, Mapping):
        for label in layout.used:
            _locate(label, [str(name) for name in data], source)
        return _from_arrays({label: data[label] for label in layout.used}, source)
    raise InputError(
        f"{source} is a {type(data).__name__}; expected a dataframe with the Arrow interface (pandas, polars, pyarrow)"
        ", a mapping of name to array, or a list of these; files go to read_records"
    )


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
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    try:
        kinds = {name: (shape, kind) for name, shape, kind in whosmat(path)}
        _check_variables(kinds, layout, path.name)
        arrays = loadmat(path, variable_names=list(layout.used))
    except InputError:  # a ValueError too, but already worded
        raise
    except NotImplementedError as error:  # scipy's answer to HDF5
        raise InputError(f"{path.name} is a MATLAB 7.3 file; save it with save(..., '-v7')") from error
    except (MatReadError, ValueError, TypeError, KeyError, IndexError) as error:
        raise InputError(f"{path.name} cannot be read as a MATLAB file: {_first_line(error)}") from error
    return _from_arrays({label: arrays[label] for label in layout.used}, path.name)


def _check_variables(kinds: Mapping[str, tuple[tuple[int, ...], str]], layout: Layout, source: str) -> None:
    """Refuse variables that are no columns; where one is lacking, say which variables may be hiding it."""
    for label in layout.used:
        hiding = [name for name, (shape, kind) in kinds.items() if not _is_column(shape, kind)]
        if label in hiding or (label not in kinds and hiding):
            name = label if label in hiding else hiding[0]
            shape, kind = kinds[name]
            size = "x".join(map(str, shape))
            lacking = f"no variable {label!r} in {source}; " if label not in kinds else f"in {source}, "
            raise InputError(
                f"{lacking}{name!r} is a {size} {kind}: save each column as a variable of its own (for a struct, "
                "save(file, '-struct', name) does it)"
            )
        _locate(label, list(kinds), source)


def _is_column(shape: tuple[int, ...], kind: str) -> bool:
    return kind not in ("struct", "cell", "object", "function", "opaque", "sparse", "char") and (
        len(shape) == 1 or (len(shape) == 2 and 1 in shape)
    )


@dataclass(frozen=True, slots=True)
class _Head:
    """What the header line of a text file says: separator, column names, and how many lines to skip."""

    separator: str
    names: tuple[str, ...]
    lines: int

    @property
    def decimals(self) -> tuple[str, ...]:
        """The decimal marks that may come with this separator, likeliest first."""
        return (",", ".") if self.separator == ";" else (".",)


def _read_text(path: Path, layout: Layout) -> dict[str, Any]:
    """Convert the used columns while parsing; only where that fails look at the cells one by one."""
    import pyarrow as pa

    head = _head(path)
    for label in layout.used:
        _locate(label, head.names, path.name)
    if layout.time is None:
        _refuse_blank_lines(path)
    types = {label: pa.float64() if label in layout.numeric else pa.string() for label in layout.used}
    for decimal in head.decimals:
        try:
            return _parse(path, head, types, decimal)
        except pa.ArrowInvalid:
            continue  # what follows finds the cells at fault, or reads those that only Arrow refuses ("+1")
    cells = _parse(path, head, dict.fromkeys(types, pa.binary()), ".", threads=False)
    texts = {label: [_decoded_text(cell) for cell in cells[label].to_pylist()] for label in layout.used}
    numeric = {label: texts[label] for label in layout.numeric}
    decimal = min(head.decimals, key=lambda mark: sum(len(_bad(text, mark)) for text in numeric.values()))
    columns: dict[str, object] = {label: np.array(text) for label, text in texts.items()}
    for label, text in numeric.items():
        if bad := _bad(text, decimal):
            _refuse_cells(path, head, label, text, bad)
        plain = (cell.strip().replace(decimal, ".") for cell in text)
        columns[label] = np.array([np.nan if cell in MISSING else float(cell) for cell in plain])
    return _from_arrays(columns, path.name)


def _parse(path: Path, head: _Head, types: Mapping[str, Any], decimal: str, threads: bool = True) -> dict[str, Any]:
    """Parse the columns named in `types`; positions stand for names, which may repeat among the unused columns."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    positions = {label: str(head.names.index(label)) for label in types}
    try:
        table = arrow_csv.read_csv(
            pa.input_stream(str(path), compression="gzip" if _zipped(path) else None),
            arrow_csv.ReadOptions(
                column_names=[str(k) for k in range(len(head.names))], skip_rows=head.lines, use_threads=threads
            ),
            arrow_csv.ParseOptions(delimiter=head.separator),
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
        line = _file_lines(path, head, [row - head.lines - 1])[0]
        raise InputError(
            f"line {line} of {path.name} has {got} cell{'s' * (got != 1)} where the header has {expected}"
        ) from error
    return {label: table.column(position) for label, position in positions.items()}


def _decoded_text(cell: bytes) -> str:
    return cell.decode("utf-8", errors="replace")


def _bad(cells: Sequence[str], decimal: str) -> list[int]:
    """Return the rows whose cell is neither missing nor a plain number with this decimal mark."""
    other = "," if decimal == "." else "."
    return [
        row
        for row, cell in enumerate(cells)
        if cell.strip() not in MISSING and (other in cell or not NUMBER.fullmatch(cell.strip().replace(decimal, ".")))
    ]


def _refuse_cells(path: Path, head: _Head, label: str, cells: Sequence[str], bad: Sequence[int]) -> None:
    lines = _file_lines(path, head, bad[:3])
    shown = ", ".join(f"line {line}: {cells[row][:40]!r}" for line, row in zip(lines, bad, strict=False))
    more = f" and {len(bad) - 3} more" if len(bad) > 3 else ""
    second = bad[0] == 0 and len(bad) == 1
    hint = "delete that line if it holds units or a comment" if second else "empty cells and NaN count as missing"
    raise InputError(f"column {label!r} in {path.name} has cells that are not numbers ({shown}{more}); {hint}")


def _zipped(path: Path) -> bool:
    return path.name.lower().endswith(".gz")


def _open(path: Path) -> IO[bytes]:
    return cast(IO[bytes], gzip.open(path)) if _zipped(path) else path.open("rb")


def _lines(path: Path) -> IO[str]:
    """Open for counting lines: Latin-1 decodes any byte, and all three line endings come as one."""
    return io.TextIOWrapper(_open(path), encoding="latin-1")


def _file_lines(path: Path, head: _Head, rows: Sequence[int]) -> list[int]:
    """Return the line numbers in the file of some data rows, both in increasing order; Arrow skips blank lines."""
    wanted, found, row = set(rows), [], -1
    with _lines(path) as stream:
        for number, line in enumerate(stream, start=1):
            if number > head.lines and line != "\n":
                row += 1
                if row in wanted:
                    found.append(number)
                if len(found) == len(wanted):
                    break
    return found


def _refuse_blank_lines(path: Path) -> None:
    """Without a time column a blank line is a lost sample that nothing else would show."""
    blank = 0
    with _lines(path) as stream:
        for number, line in enumerate(stream, start=1):
            if line == "\n":
                blank = blank or number
            elif blank > 1:
                raise InputError(
                    f"line {blank} of {path.name} is blank: with sample_period in place of a time column that would "
                    "shift every later sample; delete it, or put NaN there if a sample is missing"
                )


def _head(path: Path) -> _Head:
    """Read the header line, skipping blank lines before it."""
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
    return _Head(separator, tuple(name.strip() for name in names), filled[0] + 1)
