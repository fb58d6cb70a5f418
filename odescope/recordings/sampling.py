"""How a raw run becomes fit for use: cut at its gaps, its angles unwrapped, its time made uniform."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.errors import InputError
from odescope.recordings.checks import check_radians
from odescope.recordings.record import Record, check_finite, check_increasing, within

Gaps = Literal["refuse", "split"]

SHORTEST_PIECE = 16  # fewer samples leave nothing between the margins of a derivative filter
GAP_PERIODS = 1.5  # a longer step lacks at least one sample
EXACT_PERIODS = 1e-6  # deviations below this are the rounding of the clock's last digits
LARGEST_JITTER = 0.25  # beyond it a sample is no longer nearest to its own grid point


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
    return tuple(piece(run, samples) for samples in gapless(run, gaps))


def gapless(run: RawRun, gaps: Gaps, partial: bool = False) -> tuple[IntArray, ...]:
    """Return the samples (n,) of each piece between the gaps of a raw run, as indices into it (see split_gaps).

    A `partial` run is cut out of a longer one, whose rest may well serve: that nothing is left of it is no fault.

    Raises:
        InputError: as split_gaps does.
    """
    check_finite(~np.isinf(run.t)[:, None], ("time",), run.rows, run.source)
    check_finite(~np.isinf(run.values), run.labels, run.rows, run.source)
    timed = np.flatnonzero(~np.isnan(run.t))
    check_increasing(run.t[timed], run.rows[timed], run.source)
    complete = np.flatnonzero(~np.isnan(run.t) & ~np.isnan(run.values).any(axis=1))
    if len(complete) < 2:
        if partial and (gaps == "split" or len(complete) == len(run.t)):
            return ()
        raise InputError(f"{len(complete)} of {len(run.t)} rows are complete{within(run.source)}: expected at least 2")
    steps = np.diff(run.t[timed])
    longest = GAP_PERIODS * float(np.median(steps))
    if gaps == "refuse":
        _refuse_gaps(run, run.rows[timed[:-1]][steps > longest])
        return (complete,)
    cuts = (np.diff(complete) > 1) | (np.diff(run.t[complete]) > longest)
    pieces = np.split(complete, np.flatnonzero(cuts) + 1)
    kept = tuple(samples for samples in pieces if len(samples) >= SHORTEST_PIECE)
    if not kept and not partial:
        raise InputError(
            f"nothing is left{within(run.source)} after splitting at its gaps: the longest of {len(pieces)} pieces "
            f"has {max(map(len, pieces))} samples, and pieces shorter than {SHORTEST_PIECE} are dropped"
        )
    return kept


def piece(run: RawRun, samples: IntArray) -> Record:
    """Return some samples (n,) of a raw run as a record; InputError where one of them is not finite."""
    return Record(run.t[samples], run.values[samples], run.names, run.units, run.source)


def _refuse_gaps(run: RawRun, jumps: IntArray) -> None:
    holes = {"time": np.isnan(run.t)}  # by label: a column that serves under two names is told once
    holes |= {f"column {label!r}": np.isnan(cells) for label, cells in zip(run.labels, run.values.T, strict=True)}
    found = [_missing(what, cells, run.rows) for what, cells in holes.items() if cells.any()]
    if len(jumps):
        rows = _listed([str(row) for row in jumps])
        found.append(f"time has {_counted(len(jumps))} (after data row{'s' * (len(jumps) > 1)} {rows})")
    if found:
        raise InputError(
            f"{' and '.join(found)}{within(run.source)}, where row 1 is the first row of data; "
            "repair them there or set gaps = 'split' in [data]"
        )


def _missing(what: str, missing: BoolArray, rows: IntArray) -> str:
    """Say in which rows cells are missing."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False])).astype(np.int8)))
    spans = [
        f"{rows[start]}-{rows[stop - 1]}" if stop - start > 1 else f"{rows[start]}"
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
    ]
    plural = "s" * (int(missing.sum()) > 1)
    return f"{what} has {_counted(len(spans))} (data row{plural} {_listed(spans)})"


def _counted(gaps: int) -> str:
    return f"{gaps} gap{'s' * (gaps != 1)}"


def _listed(items: list[str]) -> str:
    return ", ".join(items[:6]) + ", ..." * (len(items) > 6)


def unwrap(record: Record, angles: Iterable[str]) -> Record:
    """Return the record with the 2 pi jumps of the named columns removed; InputError if they jump by 360 instead."""
    values = record.values.copy()
    for name in angles:
        column = record.column(name)
        check_radians(name, column, record.source)
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
    t, period = record.t, float(np.median(np.diff(record.t)))
    if (longest := float(np.diff(t).max())) > GAP_PERIODS * period:
        raise InputError(f"time jumps by {longest:.6g}{within(record.source)}, the sample period being {period:.6g}")
    chord = np.linspace(t[0], t[-1], len(t))
    if np.abs(t - chord).max() <= EXACT_PERIODS * period:
        return replace(record, t=chord)
    grid, deviation = _nearest_grid(t, chord)
    if deviation <= max(EXACT_PERIODS * period, 0.5 * _clock_tick(t)):
        return replace(record, t=grid)
    if deviation > jitter * period:
        raise InputError(
            f"the sampling is not uniform{within(record.source)}: it deviates by {deviation / period:.3g} sample "
            f"periods from any uniform grid, and the tolerance is {jitter:.3g}; resample the recording, or raise "
            "jitter in [data]"
        )
    # The chord rather than the nearest grid: it ends where the samples end, so nothing is extrapolated.
    from scipy.interpolate import CubicSpline

    values = record.values.copy()
    smooth = [k for k, name in enumerate(record.names) if name not in held]
    values[:, smooth] = CubicSpline(t, values[:, smooth])(chord)
    return replace(record, t=chord, values=values)


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
