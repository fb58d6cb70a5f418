"""Measured runs: what was recorded (Record), what it stands for (Coordinate, Input), and whether the two fit."""

from __future__ import annotations

import keyword
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.errors import InputError, nearest

Hold = Literal["linear", "zero"]

LONGEST_NAME = 64
HIGHEST_ORDER = 8
LARGEST_VALUE = 1e30  # products of a few such values would overflow
DEGREES = frozenset({"deg", "degs", "degree", "degrees", "°"})


def check_name(name: str, what: str) -> None:
    """Refuse a name that is not a plain identifier; `what` says whose name it is.

    Raises:
        InputError: the name is not an ASCII Python identifier, is a keyword, or is longer than 64 characters.
    """
    plain = isinstance(name, str) and name.isascii() and name.isidentifier() and not keyword.iskeyword(name)
    plain = plain and name != "__debug__"  # a constant to Python's compiler, whatever its syntax says
    if not plain or len(name) > LONGEST_NAME:
        shown = repr(name) if len(str(name)) <= LONGEST_NAME else f"{str(name)[:20]!r}... ({len(str(name))} characters)"
        raise InputError(
            f"{what} {shown} is not a plain name: expected an ASCII letter or underscore followed by letters, digits "
            f"or underscores, no Python keyword, at most {LONGEST_NAME} characters"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """One uninterrupted run, uniformly sampled or not.

    Shapes: t (N,), values (N, c), one name and one unit a column; `source` says in messages where it came from.

    Raises:
        InputError: shapes that do not fit, fewer than 2 samples, a value that is not finite, time that does not
            strictly increase, names that are not unique plain identifiers.
    """

    t: FloatArray
    values: FloatArray
    names: tuple[str, ...]
    units: tuple[str | None, ...] = ()
    source: str = ""

    def __post_init__(self) -> None:
        names = tuple(self.names)
        object.__setattr__(self, "t", _float_array(self.t, "t", 1, self.source))
        object.__setattr__(self, "values", _float_array(self.values, "values", 2, self.source))
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "units", tuple(self.units) or (None,) * len(names))
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
        """Whether the record is but a piece of a recording."""
        return not (self.begins and self.ends)


@dataclass(frozen=True, slots=True)
class Coordinate:
    """A measured quantity and the order of its equation: a position has order 2, a concentration order 1.

    `angle`: in radians, unwrapped, enters the basis as sin and cos; `cyclic`: does not itself enter the equations.
    """

    name: str
    order: int = 1
    angle: bool = False
    cyclic: bool = False
    unit: str | None = None

    def __post_init__(self) -> None:
        check_name(self.name, "coordinate")
        if isinstance(self.order, bool) or self.order not in range(1, HIGHEST_ORDER + 1):
            raise InputError(
                f"coordinate {self.name!r}: order must be a whole number from 1 to {HIGHEST_ORDER}, got {self.order!r}"
            )

    def derivative(self, k: int) -> str:
        """Return the name of the k-th derivative: x, x_dot, x_ddot, x_dddot."""
        return f"{self.name}_{'d' * k}ot" if k else self.name

    @property
    def states(self) -> tuple[str, ...]:
        """The names of the derivatives below the order."""
        return tuple(self.derivative(k) for k in range(self.order))

    @property
    def target(self) -> str:
        """The name of the derivative that the equation gives."""
        return self.derivative(self.order)


@dataclass(frozen=True, slots=True)
class Input:
    """A quantity that drives the system, and how it runs between samples: linearly, or held ("zero" order).

    It acts `delay` seconds after it was recorded.
    """

    name: str
    hold: Hold = "linear"
    unit: str | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        check_name(self.name, "input")
        if self.hold not in ("linear", "zero"):
            raise InputError(f"input {self.name!r}: hold must be 'linear' or 'zero', got {self.hold!r}")
        if not np.isfinite(self.delay):
            raise InputError(f"input {self.name!r}: delay must be a number of seconds, got {self.delay!r}")


def check_channels(records: Records, coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> None:
    """Refuse channels that cannot take part in an identification.

    Raises:
        InputError: a name used twice (derived names included) or without a column, a coordinate that changes in no
            recording, an input that is one constant, an angle in degrees, a wrapped angle
            that is not declared as one, values above 1e30.
    """
    if not coordinates:
        raise InputError("no coordinate: expected at least one measured quantity to find an equation for")
    _check_unique(coordinates, inputs)
    for name in (*(c.name for c in coordinates), *(driver.name for driver in inputs)):
        if (largest := max(float(np.abs(run.column(name)).max()) for run in records)) > LARGEST_VALUE:
            raise InputError(f"{name!r} has values as large as {largest:.3g}; give it in a larger unit")
    for coordinate in coordinates:
        columns = [run.column(coordinate.name) for run in records]
        if all(_constant(column) for column in columns):
            raise InputError(f"coordinate {coordinate.name!r} is constant in every recording; leave it out")
        if coordinate.angle:
            _check_angle(coordinate, records)
        else:
            _check_wraps(coordinate, records)
    for driver in inputs:  # constant within each run but not across them, it is a parameter and does inform
        if _constant(np.concatenate([run.column(driver.name) for run in records])):
            raise InputError(f"input {driver.name!r} is constant in all recordings together; leave it out")


def _check_unique(coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> None:
    owners: dict[str, str] = {}
    claims = [(name, f"coordinate {c.name!r}") for c in coordinates for name in (*c.states, c.target)]
    claims += [(driver.name, f"input {driver.name!r}") for driver in inputs]
    for name, owner in claims:
        if name in owners:
            raise InputError(f"the name {name!r} is used twice: by {owners[name]} and by {owner}; rename one of them")
        owners[name] = owner


def _check_angle(angle: Coordinate, records: Records) -> None:
    for unit in (angle.unit, records.runs[0].units[records.names.index(angle.name)]):  # all runs have the same
        if unit is not None and unit.strip().casefold() in DEGREES:
            raise InputError(_in_degrees(f"angle {angle.name!r} has the unit {unit!r}"))
    for run in records:
        check_radians(angle.name, run.column(angle.name), run.source)


def _check_wraps(coordinate: Coordinate, records: Records) -> None:
    """Refuse a coordinate that jumps by 2 pi and otherwise moves in small steps: an angle nobody declared."""
    for run in records:
        jumps = np.abs(np.diff(run.column(coordinate.name)))
        wraps = np.abs(jumps - 2.0 * np.pi) < 0.5
        if wraps.any() and not np.any(jumps[~wraps] > 0.25 * np.pi):
            raise InputError(
                f"coordinate {coordinate.name!r} jumps by about 2 pi{within(run.source)} ({int(wraps.sum())} times), so"
                " it looks like a wrapped angle: declare it with angle = true (on the command line NAME:angle)"
            )


def check_radians(name: str, column: FloatArray, source: str) -> None:
    """Refuse an angle (N,) that wraps by 360."""
    jumps = np.abs(np.diff(column))
    rows = np.flatnonzero(np.abs(jumps - 360) < 60)
    if len(rows):
        raise InputError(
            _in_degrees(
                f"angle {name!r} jumps by about 360{within(source)} ({len(rows)} times, first from "
                f"{column[rows[0]]:.6g} to {column[rows[0] + 1]:.6g}), so it looks like degrees"
            )
        )


def _in_degrees(what: str) -> str:
    return f"{what}, but angles are in radians here: multiply the column by pi/180"


def _constant(column: FloatArray) -> bool:
    """Constant up to rounding: resampling a constant leaves errors in the last digit."""
    return float(np.ptp(column)) <= 1e-12 * float(np.abs(column).max())


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


def check_finite(fine: BoolArray, names: tuple[str, ...], rows: IntArray, source: str) -> None:
    """Refuse a table (N, c) that is not fine everywhere; rows (N,) are the numbers that messages call its rows by."""
    if not fine.all():
        row, column = np.argwhere(~fine)[0]
        raise InputError(f"{names[column]!r} is not a finite number in data row {rows[row]}{within(source)}")


def check_increasing(t: FloatArray, rows: IntArray, source: str) -> None:
    """Refuse a time (N,) that goes back or repeats; rows (N,) are the numbers that messages call its samples by."""
    stuck = np.flatnonzero(np.diff(t) <= 0)
    if len(stuck):
        k = stuck[0]
        fault = "repeats" if t[k + 1] == t[k] else "goes back"
        raise InputError(
            f"time {fault} at data row {rows[k + 1]} ({t[k]:.9g}, then {t[k + 1]:.9g}){within(source)}; it must "
            'increase. If several runs share the file, name the column that tells them apart: recording = "..."'
        )
