"""Measured runs: one uninterrupted record, several together, and a record of which only a stretch counts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias, Union

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray, Table
from odescope.errors import InputError, nearest
from odescope.recordings.coordinate import Coordinate, check_name


@dataclass(frozen=True, slots=True)
class Repairs:
    """What was done to the rows of a run before it became a record: how many there were, and of how many what.

    `disordered` rows came before an earlier one and were sorted; `doubled` ones had the time of another and were merged
    with it; `jitter` is that of a regular clock whose stamps were smoothed, its standard deviation in sample periods;
    `scatter` is how far samples that were taken off even times are from these, likewise. `cut` counts the gaps at which
    the run was cut into several, `unseen` those of them that are no long ones, but what an input did in them is not
    known; the first of these bears what was done to its rows. `short` rows lay beside gaps in pieces too short to use,
    and were left out. `clocked` inputs change at even times alone, whenever they were read. `coarse` are the seconds
    that a clock ticked by while several rows came, which were spread evenly; 0 for none.
    """

    rows: int = 0
    disordered: int = 0
    doubled: int = 0
    jitter: float = 0.0
    scatter: float = 0.0
    cut: int = 0
    unseen: int = 0
    short: int = 0
    clocked: frozenset[str] = frozenset()
    coarse: float = 0.0


UNREPAIRED = Repairs()

# Recordings as a caller may give them: as they are, as tables, or as paths of files.
Recorded: TypeAlias = Union[
    "Record", "Records", Iterable["Record"], Table, Sequence[Table], Path, str, Sequence[Path | str]
]


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """One uninterrupted run, uniformly sampled or not.

    Shapes: t (N,), values (N, c), one name and one unit a column; counts (N, c) how many measured samples stand behind
    each value, None for 1 throughout: where it is 0 nothing was measured and the value is filled in, where it is 2 the
    value is the mean of two. `source` says in messages where it came from, `repairs` what was done to its rows. The
    times of one that is `dated` are dates or clocks, in seconds since 1970; others are by the clock of whoever logged.

    Raises:
        InputError: shapes that do not fit, fewer than 2 samples, a value that is not finite, time that does not
            strictly increase, names that are not unique plain identifiers, counts below 0.
    """

    t: FloatArray
    values: FloatArray
    names: tuple[str, ...]
    units: tuple[str | None, ...] = ()
    source: str = ""
    counts: FloatArray | None = None
    repairs: Repairs = UNREPAIRED
    dated: bool = False

    def __post_init__(self) -> None:
        names = tuple(self.names)
        object.__setattr__(self, "t", _float_array(self.t, "t", 1, self.source))
        object.__setattr__(self, "values", _float_array(self.values, "values", 2, self.source))
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "units", tuple(self.units) or (None,) * len(names))
        if self.counts is not None:
            object.__setattr__(self, "counts", _float_array(self.counts, "counts", 2, self.source))
        self._check_layout()
        rows = np.arange(1, len(self.t) + 1)
        check_finite(np.isfinite(self.t)[:, None], ("time",), rows, self.source)
        check_finite(np.isfinite(self.values), names, rows, self.source)
        check_increasing(self.t, rows, self.source)

    def _check_layout(self) -> None:
        columns = (len(self.names), len(self.units))
        if self.values.shape[0] != len(self.t) or columns != (self.values.shape[1],) * 2:
            raise InputError(
                f"a record needs t of shape (N,), values of shape (N, c), c names and c units; got t {self.t.shape}, "
                f"values {self.values.shape}, {columns[0]} names and {columns[1]} units{within(self.source)}"
            )
        if self.counts is not None and (self.counts.shape != self.values.shape or not np.all(self.counts >= 0.0)):
            raise InputError(
                f"counts of a record must be of shape {self.values.shape}, as its values, and not below 0; got "
                f"{self.counts.shape}{within(self.source)}"
            )
        if len(self.t) < 2:
            raise InputError(f"a record needs at least 2 samples, got {len(self.t)}{within(self.source)}")
        for k, name in enumerate(self.names):
            check_name(name, "column")
            if name in self.names[:k]:
                raise InputError(f"column name {name!r} is used twice{within(self.source)}; names must be unique")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def sample_period(self) -> float:
        """The mean step of time, in the unit of time: single steps of a clock that counts from 1970 are too coarse."""
        return self.duration / (len(self) - 1)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last."""
        return float(self.t[-1] - self.t[0])

    def column(self, name: str) -> FloatArray:
        """Return the samples (N,) of one column; InputError names the nearest column where there is none."""
        if name not in self.names:
            raise InputError(f"no column {name!r}{within(self.source)}; {nearest(name, self.names)}")
        return self.values[:, self.names.index(name)]

    def counted(self, name: str) -> FloatArray:
        """Return how many samples stand behind each value (N,) of one column."""
        return np.ones(len(self)) if self.counts is None else self.counts[:, self.names.index(name)]

    def part(self, first: int, stop: int) -> Record:
        """Return the samples [first, stop) as a record."""
        kept = slice(first, stop)
        counts = None if self.counts is None else self.counts[kept]
        return replace(self, t=self.t[kept], values=self.values[kept], counts=counts)


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """One or many runs with the same columns; InputError where there is none or where they differ."""

    runs: tuple[Record, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "runs", tuple(self.runs))
        if not self.runs:
            raise InputError("no recording: expected at least one")
        first = self.runs[0]
        for run in self.runs[1:]:
            if (run.names, run.units) != (first.names, first.units):
                raise InputError(
                    f"all recordings need the same columns and units: {_described(first)}, but {_described(run)}"
                )

    @classmethod
    def of(cls, data: Record | Records | Iterable[Record]) -> Records:
        """Return the records given as one record, several, or already together."""
        if isinstance(data, Records):
            return data
        return cls((data,) if isinstance(data, Record) else tuple(data))

    def __iter__(self) -> Iterator[Record]:
        return iter(self.runs)

    def __len__(self) -> int:
        return len(self.runs)

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """The runs as stretches of which every sample counts."""
        return tuple(Stretch.whole(run) for run in self.runs)

    @property
    def names(self) -> tuple[str, ...]:
        """The column names that all runs share."""
        return self.runs[0].names

    @property
    def samples(self) -> int:
        """The number of samples in all runs together."""
        return sum(len(run) for run in self.runs)


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """A record, of which the samples [first, stop) count; the others are there for the sake of filters.

    `begins` and `ends` tell whether the recording does so where the record does: at a gap, at another recording, at an
    end of the file. Elsewhere the record is cut out of a longer one.
    """

    record: Record
    first: int
    stop: int
    begins: bool = True
    ends: bool = True

    @classmethod
    def whole(cls, record: Record) -> Stretch:
        """Return a record that is a whole recording, of which every sample counts."""
        return cls(record, 0, len(record))

    @property
    def cut(self) -> bool:
        """Whether the record is cut out of a longer recording."""
        return not (self.begins and self.ends)


def less_offsets(record: Record, coordinates: Iterable[Coordinate]) -> Record:
    """Return a record with coordinates instead of what was read of them, which is more by their offsets."""
    shift = {c.name: c.offset for c in coordinates if c.offset}
    if not shift:
        return record
    return replace(record, values=record.values - np.array([shift.get(name, 0.0) for name in record.names]))


def in_radians(record: Record, angles: Iterable[str]) -> Record:
    """Return a record with the named angles in radians; one whose unit is that already stays as it is."""
    columns = [k for k, name in enumerate(record.names) if name in set(angles) and record.units[k] != "rad"]
    values, units = record.values.copy(), list(record.units)
    for k in columns:
        values[:, k] *= np.pi / 180.0
        units[k] = "rad"
    return replace(record, values=values, units=tuple(units)) if columns else record


def within(source: str) -> str:
    """Say where, for the end of a message, if that is known."""
    return f" in {source}" if source else ""


def _described(record: Record) -> str:
    columns = (f"{name} [{unit}]" if unit else name for name, unit in zip(record.names, record.units, strict=True))
    return f"{record.source or 'one'} has {', '.join(columns)}"


def _float_array(data: object, what: str, dimensions: int, source: str) -> FloatArray:
    """Return a read-only float64 array that nobody else can write to."""
    array = np.asarray(data)
    if array.dtype.kind not in "biuf" or array.ndim != dimensions:
        raise InputError(
            f"{what} of a record must be a {dimensions}-d array of real numbers, got {array.ndim}-d {array.dtype}"
            f"{within(source)}"
        )
    floats = np.asarray(array, dtype=np.float64)
    if floats.flags.writeable:
        floats = floats.copy()
        floats.setflags(write=False)
    return floats


def check_finite(fine: BoolArray, names: tuple[str, ...], rows: IntArray, source: str, advice: str = "") -> None:
    """Refuse a table that is not finite everywhere.

    Args:
        fine: (N, c), whether a value is.
        names: of the columns.
        rows: (N,) the numbers that the message calls rows by.
        source: where the table came from, for the message.
        advice: what to write instead, for the end of the message.
    """
    if not fine.all():
        row, column = np.argwhere(~fine)[0]
        raise InputError(f"{names[column]!r} is not a finite number in data row {rows[row]}{within(source)}{advice}")


def check_increasing(t: FloatArray, rows: IntArray, source: str) -> None:
    """Refuse a time that goes back or repeats.

    Args:
        t: (N,) the time.
        rows: (N,) the numbers that the message calls its samples by.
        source: where it came from, for the message.
    """
    stuck = np.flatnonzero(np.diff(t) <= 0)
    if len(stuck):
        k = stuck[0]
        fault = "repeats" if t[k + 1] == t[k] else "goes back"
        raise InputError(
            f"time {fault} at data row {rows[k + 1]} ({t[k]:.9g}, then {t[k + 1]:.9g}){within(source)}; it must"
            " increase: sort the rows by it; if several runs share the file, name the column that tells them apart,"
            ' --recording or recording = "..."; if the clock is too coarse, give sample_period in its place'
        )
