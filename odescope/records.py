"""Measured runs: what was recorded (Record), what it stands for (Coordinate, Input), and how a raw run is made fit."""

from __future__ import annotations

import keyword
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.errors import InputError, nearest

Gaps = Literal["refuse", "split"]
Hold = Literal["linear", "zero"]

LONGEST_NAME = 64
HIGHEST_ORDER = 8
SHORTEST_PIECE = 16  # fewer samples leave nothing between the margins of a derivative filter
GAP_PERIODS = 1.5  # a longer step lacks at least one sample
EXACT_PERIODS = 1e-6  # deviations below this are the rounding of the clock's last digits
LARGEST_JITTER = 0.25  # beyond it a sample is no longer nearest to its own grid point
LARGEST_VALUE = 1e30  # products of a few such values would overflow
DEGREES = frozenset({"deg", "degs", "degree", "degrees", "°"})


def check_name(name: str, what: str) -> None:
    """Refuse a name that is not a plain identifier; `what` says whose name it is.

    Raises:
        InputError: the name is not an ASCII Python identifier, is a keyword, or is longer than 64 characters.
    """
    plain = isinstance(name, str) and name.isascii() and name.isidentifier() and not keyword.iskeyword(name)
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
        _check_finite(np.isfinite(self.t)[:, None], ("time",), rows, self.source)
        _check_finite(np.isfinite(self.values), names, rows, self.source)
        _check_increasing(self.t, rows, self.source)

    def _check_layout(self) -> None:
        columns = (len(self.names), len(self.units))
        if self.values.shape[0] != len(self.t) or columns != (self.values.shape[1],) * 2:
            raise InputError(
                f"a record needs t of shape (N,), values of shape (N, c), c names and c units; got t {self.t.shape}, "
                f"values {self.values.shape}, {columns[0]} names and {columns[1]} units{_within(self.source)}"
            )
        if len(self.t) < 2:
            raise InputError(f"a record needs at least 2 samples, got {len(self.t)}{_within(self.source)}")
        for k, name in enumerate(self.names):
            check_name(name, "column")
            if name in self.names[:k]:
                raise InputError(f"column name {name!r} is used twice{_within(self.source)}; names must be unique")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def sample_period(self) -> float:
        """The median step of time, in the unit of time."""
        return float(np.median(np.diff(self.t)))

    @property
    def duration(self) -> float:
        """Time from the first sample to the last."""
        return float(self.t[-1] - self.t[0])

    def column(self, name: str) -> FloatArray:
        """Return the samples (N,) of one column; InputError names the nearest column where there is none."""
        if name not in self.names:
            raise InputError(f"no column {name!r}{_within(self.source)}; {nearest(name, self.names)}")
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
    """A quantity that drives the system, and how it runs between samples: linearly, or held ("zero" order)."""

    name: str
    hold: Hold = "linear"
    unit: str | None = None

    def __post_init__(self) -> None:
        check_name(self.name, "input")
        if self.hold not in ("linear", "zero"):
            raise InputError(f"input {self.name!r}: hold must be 'linear' or 'zero', got {self.hold!r}")


@dataclass(frozen=True, slots=True, eq=False)
class RawRun:
    """One run as it was read: NaN where a cell is missing, time that may jump.

    Shapes: t (N,), values (N, c); rows (N,) counts the file's data rows from 1; `labels` are the columns' names in
    the file, which messages use.
    """

    t: FloatArray
    values: FloatArray
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    source: str
    rows: IntArray
    labels: tuple[str, ...]


def split_gaps(run: RawRun, gaps: Gaps = "refuse") -> tuple[Record, ...]:
    """Cut a raw run where cells are missing or time jumps by more than 1.5 periods, or refuse to.

    Pieces shorter than 16 samples are dropped. Angles are not unwrapped yet: across a gap that would be a guess.

    Raises:
        InputError: there are gaps and `gaps` is "refuse"; no piece is left; time goes back or repeats; a value is
            infinite.
    """
    _check_finite(~np.isinf(run.t)[:, None], ("time",), run.rows, run.source)
    _check_finite(~np.isinf(run.values), run.labels, run.rows, run.source)
    timed = np.flatnonzero(~np.isnan(run.t))
    _check_increasing(run.t[timed], run.rows[timed], run.source)
    complete = np.flatnonzero(~np.isnan(run.t) & ~np.isnan(run.values).any(axis=1))
    if len(complete) < 2:
        raise InputError(f"{len(complete)} of {len(run.t)} rows are complete{_within(run.source)}: expected at least 2")
    steps = np.diff(run.t[timed])
    longest = GAP_PERIODS * float(np.median(steps))
    if gaps == "refuse":
        _refuse_gaps(run, run.rows[timed[:-1]][steps > longest])
        return (_piece(run, complete),)
    cuts = (np.diff(complete) > 1) | (np.diff(run.t[complete]) > longest)
    pieces = np.split(complete, np.flatnonzero(cuts) + 1)
    kept = tuple(_piece(run, piece) for piece in pieces if len(piece) >= SHORTEST_PIECE)
    if not kept:
        raise InputError(
            f"nothing is left{_within(run.source)} after splitting at its gaps: the longest of {len(pieces)} pieces "
            f"has {max(map(len, pieces))} samples, and pieces shorter than {SHORTEST_PIECE} are dropped"
        )
    return kept


def unwrap(record: Record, angles: Iterable[str]) -> Record:
    """Return the record with the 2 pi jumps of the named columns removed; InputError if they jump by 360 instead."""
    values = record.values.copy()
    for name in angles:
        column = record.column(name)
        _check_radians(name, column, record.source)
        values[:, record.names.index(name)] = np.unwrap(column)
    return replace(record, values=values)


def uniform(record: Record, jitter: float = 0.05, held: frozenset[str] = frozenset()) -> Record:
    """Return the record on an exactly uniform time grid of as many samples.

    Jitter is the smallest, over all uniform grids, of the largest deviation of a sample from its grid point, in
    sample periods. Where it is rounding (below 1e-6, or within half a tick of the clock that wrote the times), the
    values stay and time becomes the grid. Up to `jitter` the columns are interpolated by cubic splines, except those
    in `held`: a held value fills the interval after it, and its own grid interval is the one that it fills most of.

    Raises:
        InputError: the jitter is above the tolerance, or a step is longer than 1.5 periods (see split_gaps).
    """
    t, period = record.t, record.sample_period
    if (longest := float(np.diff(t).max())) > GAP_PERIODS * period:
        raise InputError(f"time jumps by {longest:.6g}{_within(record.source)}, the sample period being {period:.6g}")
    chord = np.linspace(t[0], t[-1], len(t))
    if np.abs(t - chord).max() <= EXACT_PERIODS * period:
        return replace(record, t=chord)
    grid, deviation = _nearest_grid(t, chord)
    if deviation <= max(EXACT_PERIODS * period, 0.5 * _clock_tick(t)):
        return replace(record, t=grid)
    if deviation > jitter * period:
        raise InputError(
            f"the sampling is not uniform{_within(record.source)}: it deviates by {deviation / period:.3g} sample "
            f"periods from any uniform grid, and the tolerance is {jitter:.3g}; resample the recording, or raise "
            "jitter in [data]"
        )
    # The chord rather than the nearest grid: it ends where the samples end, so nothing is extrapolated.
    from scipy.interpolate import CubicSpline

    values = record.values.copy()
    smooth = [k for k, name in enumerate(record.names) if name not in held]
    values[:, smooth] = CubicSpline(t, values[:, smooth])(chord)
    return replace(record, t=chord, values=values)


def check_channels(records: Records, coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> None:
    """Refuse channels that cannot take part in an identification.

    Raises:
        InputError: a name used twice (derived names included) or without a column, a coordinate that changes in no
            recording, an input that is one constant, an angle in degrees, values above 1e30.
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
    for driver in inputs:  # constant within each run but not across them, it is a parameter and does inform
        if _constant(np.concatenate([run.column(driver.name) for run in records])):
            raise InputError(f"input {driver.name!r} is constant in all recordings together; leave it out")


def _check_unique(coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> None:
    owners: dict[str, str] = {}
    claims = [(name, f"coordinate {c.name!r}") for c in coordinates for name in (*c.states, c.target)]
    for name, owner in (*claims, *((driver.name, f"input {driver.name!r}") for driver in inputs)):
        if name in owners:
            raise InputError(f"the name {name!r} is used twice: by {owners[name]} and by {owner}; rename one of them")
        owners[name] = owner


def _check_angle(angle: Coordinate, records: Records) -> None:
    units = {angle.unit, *(run.units[run.names.index(angle.name)] for run in records)}
    for unit in units:
        if unit is not None and unit.strip().casefold() in DEGREES:
            raise InputError(_in_degrees(f"angle {angle.name!r} has the unit {unit!r}"))
    for run in records:
        _check_radians(angle.name, run.column(angle.name), run.source)


def _check_radians(name: str, column: FloatArray, source: str) -> None:
    jumps = np.abs(np.diff(column))
    rows = np.flatnonzero(np.abs(jumps - 360) < 60)
    if len(rows):
        raise InputError(
            _in_degrees(
                f"angle {name!r} jumps by about 360{_within(source)} ({len(rows)} times, first from "
                f"{column[rows[0]]:.6g} to {column[rows[0] + 1]:.6g}), so it looks like degrees"
            )
        )


def _in_degrees(what: str) -> str:
    return f"{what}, but angles are in radians here: multiply the column by pi/180"


def _constant(column: FloatArray) -> bool:
    """Constant up to rounding: resampling a constant leaves errors in the last digit."""
    return float(np.ptp(column)) <= 1e-12 * float(np.abs(column).max())


def _nearest_grid(t: FloatArray, chord: FloatArray) -> tuple[FloatArray, float]:
    """Return the uniform grid (N,) whose largest deviation from t is smallest, and that deviation.

    The best line in this sense is parallel to an edge of the convex hull of the points (index, time); a chord
    through the ends is taken off and the rest is scaled first, because the deviations are tiny beside the times.
    """
    from scipy.spatial import ConvexHull

    scale = float(np.abs(t - chord).max())
    index = np.linspace(0.0, 1.0, len(t))
    points = np.column_stack((index, (t - chord) / scale))
    x, y = points[ConvexHull(points).vertices].T
    run, rise = np.roll(x, -1) - x, np.roll(y, -1) - y
    slopes = rise[run != 0] / run[run != 0]
    heights = y - slopes[:, None] * x
    best = int(np.argmin(np.ptp(heights, axis=1)))
    middle = (heights[best].max() + heights[best].min()) / 2
    return chord + scale * (middle + slopes[best] * index), scale * float(np.ptp(heights[best])) / 2


def _clock_tick(t: FloatArray) -> float:
    """Return the coarsest step that explains the digits of all times: of decimals, of a binary clock, of the float."""
    single = bool(np.all(t == t.astype(np.float32)))
    rounding = float(np.spacing(np.abs(t).max()))
    ticks = [float(np.spacing(np.float32(np.abs(t).max()))) if single else rounding]
    elapsed, shortest = t - t[0], float(np.diff(t).min())
    for base in (10.0, 2.0):
        top = int(np.floor(np.log(shortest) / np.log(base)))
        bottom = int(np.ceil(np.log(EXACT_PERIODS * shortest) / np.log(base)))
        for unit in (base**k for k in range(top, bottom - 1, -1)):
            count = np.rint(elapsed / unit)
            slack = EXACT_PERIODS + 2 * rounding / unit
            if slack < 0.1 and np.abs(elapsed / unit - count).max() <= slack:
                # the common divisor finds clocks that tick in fives or twenties of a decimal
                ticks.append(unit * int(np.gcd.reduce(count.astype(np.int64))))
                break
    return max(ticks) + 4 * rounding  # the float rounds what the clock has rounded already


def _piece(run: RawRun, rows: IntArray) -> Record:
    return Record(run.t[rows], run.values[rows], run.names, run.units, run.source)


def _refuse_gaps(run: RawRun, jumps: IntArray) -> None:
    found = [_missing("time", np.isnan(run.t), run.rows)]
    found += [
        _missing(f"column {label!r}", np.isnan(column), run.rows)
        for label, column in dict(zip(run.labels, run.values.T, strict=True)).items()
    ]
    if len(jumps):
        rows = _listed([str(row) for row in jumps])
        found.append(f"time has {_counted(len(jumps), 'gap')} (after data row{'s' * (len(jumps) > 1)} {rows})")
    if any(found):
        raise InputError(
            f"{' and '.join(filter(None, found))}{_within(run.source)}, where row 1 is the first row of data; "
            "repair them there or set gaps = 'split' in [data]"
        )


def _missing(what: str, missing: BoolArray, rows: IntArray) -> str:
    """Say in which rows cells are missing; empty where none is."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False])).astype(np.int8)))
    spans = [
        f"{rows[start]}-{rows[stop - 1]}" if stop - start > 1 else f"{rows[start]}"
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
    ]
    plural = "s" * (int(missing.sum()) > 1)
    return f"{what} has {_counted(len(spans), 'gap')} (data row{plural} {_listed(spans)})" if spans else ""


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _listed(items: list[str]) -> str:
    return ", ".join(items[:6]) + ", ..." * (len(items) > 6)


def _within(source: str) -> str:
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
            f"{_within(source)}"
        )
    floats = np.asarray(array, dtype=np.float64)
    if floats.flags.writeable:
        floats = floats.copy()
        floats.setflags(write=False)
    return floats


def _check_finite(fine: BoolArray, names: tuple[str, ...], rows: IntArray, source: str) -> None:
    if not fine.all():
        row, column = np.argwhere(~fine)[0]
        raise InputError(f"{names[column]!r} is not a finite number in data row {rows[row]}{_within(source)}")


def _check_increasing(t: FloatArray, rows: IntArray, source: str) -> None:
    for k in np.flatnonzero(np.diff(t) <= 0)[:1]:
        fault = "repeats" if t[k + 1] == t[k] else "goes back"
        raise InputError(
            f"time {fault} at data row {rows[k + 1]} ({t[k]:.9g}, then {t[k + 1]:.9g}){_within(source)}; it must "
            'increase. If several runs share the file, name the column that tells them apart: recording = "..."'
        )
