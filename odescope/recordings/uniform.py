"""How a run becomes a record on a uniform time grid: every sample goes to the grid point that is nearest to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.errors import InputError
from odescope.recordings.between_samples import looks_held, on_polygon, unseen_steps
from odescope.recordings.clock import EXACT_PERIODS, Stamps, read_clock, ticks_coarsely, whole_steps
from odescope.recordings.command_clock import by_clock, command_clock, integrals
from odescope.recordings.gaps import GAP_PERIODS, RawRun
from odescope.recordings.local_spline import fit_beside, fit_smooth
from odescope.recordings.lost_rows import sample_numbers
from odescope.recordings.record import Record, within
from odescope.recordings.repeats import stale, stays_at_end


def uniform(
    run: RawRun,
    jitter: float | None = None,
    held: frozenset[str] = frozenset(),
    inputs: frozenset[str] = frozenset(),
) -> tuple[Record, IntArray]:
    """Return the record of a run on an exactly uniform time grid, and the grid point (n,) of each of its rows.

    Where the deviation of the samples from a grid is rounding (below 1e-6 periods, or within half a tick of the clock
    that wrote the times), values stay as they are. Elsewhere a sample y taken at t goes to the nearest grid point g as
    y - s(t) + s(g), s a smooth curve through its column: white noise stays white and keeps its variance, as no
    interpolation leaves it. Several samples at one point are averaged, `Record.counts` says how many; where there is
    none the value is s(g). A held value fills the interval after it, and its own grid interval is the one that it
    fills most of. An input runs in lines from sample to sample, and is the polygon on the grid that is nearest to them.

    Args:
        run: in order, its gaps no longer than a smooth curve bridges, its angles unwrapped; each column has samples.
        jitter: the largest deviation that is accepted, in sample periods; None: any.
        held: names of the columns that keep a value until the next one.
        inputs: names of the columns that are commanded: they may run by the number of the sample, hold values over
            several rows, and need not be smooth.

    Raises:
        InputError: the least over all uniform grids of the largest deviation of a sample is above `jitter`.
    """
    ticks = ticks_coarsely(run, held, inputs)
    numbers = np.arange(len(run.t)) if ticks else sample_numbers(run.t)
    grid, deviation = _nearest_grid(run.t, numbers)
    if not ticks and not _lies_on(run.t, grid, deviation) and (lost := whole_steps(run.t)) is not None:
        finer, less = _nearest_grid(run.t, lost)
        if _lies_on(run.t, finer, less):
            numbers, grid, deviation = lost, finer, 0.0
    if _lies_on(run.t, grid, deviation):
        return on_grid(run, grid[numbers], grid, numbers, held, inputs)
    period = float(grid[-1] - grid[0]) / (len(grid) - 1)
    if jitter is not None and deviation > jitter * period:
        raise InputError(
            f"the sampling is not uniform{within(run.source)}: it deviates by {deviation / period:.3g} sample "
            f"periods from any uniform grid, and the limit is {jitter:.3g}; leave jitter out of [data], or raise it"
        )
    if ticks:
        read = replace(run.repairs, jitter=float(np.std(run.t - grid)) / period)
        return on_grid(replace(run, repairs=read), grid, grid, numbers, held, inputs)
    return _off_even_times(run, held, inputs)


def _off_even_times(run: RawRun, held: frozenset[str], inputs: frozenset[str]) -> tuple[Record, IntArray]:
    """Return the record of samples whose stamps lie on no grid, on the one that suits these or a clock of the inputs.

    Args:
        run: see `uniform`.
        held: names of the columns that keep a value until the next one.
        inputs: names of the columns that are commanded.
    """
    stamps = read_clock(run, held, inputs)
    commands = {name: run.values[:, run.names.index(name)] for name in run.names if name in inputs}
    clock = command_clock((run.t - stamps.origin) / stamps.period, tuple(commands.values()))
    if clock is not None:  # stamps that show the clock by which inputs change are right, and its ticks are the grid
        tick, period = clock
        stamps = Stamps(run.t, stamps.origin + tick * stamps.period, period * stamps.period)
    points = np.rint((stamps.t - stamps.origin) / stamps.period).astype(np.int64)
    first = int(points[0])
    grid = stamps.origin + stamps.period * np.arange(first, int(points[-1]) + 1, dtype=np.float64)
    off = 0.0 if stamps.jitter else float(np.std(stamps.t - grid[points - first])) / stamps.period
    begun = np.floor((stamps.t - stamps.origin) / stamps.period).astype(np.int64) - first
    clocked = {name: by_clock(begun, u, len(grid)) for name, u in commands.items()} if clock else {}
    by_ticks = {name: values for name, values in clocked.items() if values is not None}
    done = replace(run.repairs, jitter=stamps.jitter, scatter=off, clocked=frozenset(by_ticks))
    run = replace(run, repairs=done)
    return on_grid(run, stamps.t, grid, points - first, held, inputs, by_ticks)


def on_grid(
    run: RawRun,
    t: FloatArray,
    grid: FloatArray,
    points: IntArray,
    held: frozenset[str],
    inputs: frozenset[str] = frozenset(),
    by_ticks: Mapping[str, FloatArray] = MappingProxyType({}),
) -> tuple[Record, IntArray]:
    """Return the record of samples that belong to some points of a grid (see `uniform`), and these points.

    The record begins where the last column has its first sample, and ends where the first one has its last.

    Args:
        run: the samples, NaN where one is missing.
        t: (n,) when they were taken.
        grid: (N,) uniform.
        points: (n,) the point of each, not falling.
        held: names of the columns that keep a value until the next one.
        inputs: names of the columns that run in lines from sample to sample, if they do not look held.
        by_ticks: (N,) inputs that are known on the grid.
    """
    measured = ~np.isnan(run.values)
    weights = np.where(measured, 1.0 if run.counts is None else run.counts, 0.0)
    if len(points) == len(grid) and measured.all() and np.array_equal(t, grid):
        return Record(grid, run.values, run.names, run.units, run.source, run.counts, run.repairs, run.dated), points
    values, counts = np.empty((len(grid), len(run.names))), np.empty((len(grid), len(run.names)))
    for k, name in enumerate(run.names):
        there = np.flatnonzero(measured[:, k])
        own = t[there], run.values[there, k], weights[there, k]
        counts[:, k] = np.bincount(points[there], own[2], len(grid))
        if name in by_ticks:
            values[:, k] = by_ticks[name]
        elif name in held or (name in inputs and looks_held(own[1])):
            values[:, k] = _held(*own[:2], grid)
            steps = unseen_steps(points[there], own[1])
            for gap in np.flatnonzero(steps).tolist():
                values[steps[gap] : points[there[gap + 1]], k] = own[1][gap + 1]
        else:
            commands = () if name in inputs else tuple(by_ticks.values())
            values[:, k] = _assigned(*own, grid, points[there], commands)
            if name in inputs:
                between = _between_coarse(*own[:2], grid) if _coarse(own[0], grid) else values[:, k]
                values[:, k] = _in_lines(*own[:2], grid, np.where(counts[:, k] > 0.0, np.nan, between))
    some = counts > 0.0
    first, stop = int(some.argmax(axis=0).max()), len(grid) - int(some[::-1].argmax(axis=0).max())
    whole = Record(grid, values, run.names, run.units, run.source, counts, run.repairs, run.dated)
    record = whole.part(first, stop)
    if np.all(counts[first:stop] == 1.0):
        record = replace(record, counts=None)
    return record, points - first


def _assigned(
    t: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    grid: FloatArray,
    points: IntArray,
    commands: Sequence[FloatArray] = (),
) -> FloatArray:
    """Return a column (N,) on a grid: at each point the mean of the samples (n,) that belong to it, moved there.

    Args:
        t: (n,) when they were taken.
        values: (n,) samples.
        weights: (n,) how many samples each is the mean of.
        grid: (N,) uniform.
        points: (n,) the point of each.
        commands: (N,) inputs that are held from each point to the next, at which the column has kinks.
    """
    there = np.bincount(points, weights, len(grid))
    if there.all() and np.array_equal(t, grid[points]):
        return np.bincount(points, weights * values, len(grid)) / there if len(t) > len(grid) else values
    # Time counts in periods from the first point: that of a clock that counts from 1970 is too coarse for a spline.
    scale = (len(grid) - 1) / (grid[-1] - grid[0])
    at, where = (t - grid[0]) * scale, (grid - grid[0]) * scale
    smooth = _smooth(at, values, weights, commands)
    # Between samples that are far apart beside others that are close, and beyond such ones, a cubic may go anywhere.
    least, most = values.min() - np.ptp(values), values.max() + np.ptp(values)
    curve = np.clip(smooth(np.clip(where, at[0] - 1.0, at[-1] + 1.0)), least, most)
    moved = values - smooth(at) + curve[points] if not np.array_equal(t, grid[points]) else values
    for k in np.flatnonzero(stale(values)).tolist():  # what was not measured anew repeats its neighbour here, too
        moved[k] = moved[k - 1] if values[k] == values[k - 1] else moved[k + 1]
    stays = stays_at_end(values)  # and what is at the end of the sensor's range is there whenever it was read
    moved[stays] = values[stays]
    total = np.bincount(points, weights * moved, len(grid))
    return np.where(there > 0.0, total / np.maximum(there, 1.0), curve)


def _smooth(
    at: FloatArray, values: FloatArray, weights: FloatArray, commands: Sequence[FloatArray]
) -> Callable[[FloatArray], FloatArray]:
    """Return a function through samples that is smooth but for what inputs make of it, see `_assigned`."""
    if not commands:
        smooth: Callable[[FloatArray], FloatArray] = fit_smooth(at, values, weights)
        return smooth
    spline, share = fit_beside(at, values, weights, integrals(commands, at))
    return lambda where: np.asarray(spline(where) + integrals(commands, where) @ share)


def _coarse(t: FloatArray, grid: FloatArray) -> bool:
    return float(np.median(np.diff(t))) > GAP_PERIODS * float(grid[1] - grid[0])


def _between_coarse(t: FloatArray, values: FloatArray, grid: FloatArray) -> FloatArray:
    """Return an input (N,) between samples (n,) that are all further apart than the grid's points, free of overshoot.

    A spline swings about every switch; this is nearly as close to what is smooth.
    """
    from scipy.interpolate import Akima1DInterpolator

    if len(t) < 3:
        return np.interp(grid, t, values)
    curve: FloatArray = Akima1DInterpolator(t, values, method="makima")(np.clip(grid, t[0], t[-1]))
    return curve


def _in_lines(t: FloatArray, values: FloatArray, grid: FloatArray, between: FloatArray) -> FloatArray:
    """Return an input (N,) on a grid that runs in lines through its samples (n,) and what is known between them.

    Args:
        t: (n,) when it was sampled.
        values: (n,) samples.
        grid: (N,) uniform.
        between: (N,) values where no sample belongs to a point, NaN elsewhere.
    """
    known = ~np.isnan(between)
    nodes, first = np.unique(np.concatenate([t, grid[known]]), return_index=True)
    return on_polygon(nodes, np.concatenate([values, between[known]])[first], grid)


def _held(t: FloatArray, values: FloatArray, grid: FloatArray) -> FloatArray:
    """Return a held column (N,) on a grid: at each point the value that fills most of the interval after it."""
    middle = grid + 0.5 * (grid[1] - grid[0])
    before = np.searchsorted(t, middle, side="right") - 1
    found: FloatArray = values[np.maximum(before, 0)]
    return found


def _nearest_grid(t: FloatArray, numbers: IntArray) -> tuple[FloatArray, float]:
    """Return the uniform grid (N,) whose largest deviation from t is smallest, and that deviation.

    Sample `numbers` (n,) belong to the points of the grid. The best line in this sense is parallel to an edge of the
    convex hull of the points (number, time); a chord through the ends is taken off and the rest is scaled first,
    because the deviations are tiny beside the times. The chord itself is taken where it deviates by rounding alone.
    """
    from scipy.spatial import ConvexHull

    chord = np.linspace(t[0], t[-1], int(numbers[-1]) + 1)
    rest = t - chord[numbers]
    scale = float(np.abs(rest).max())
    if scale <= EXACT_PERIODS * (chord[1] - chord[0]):
        return chord, scale
    index = np.linspace(0.0, 1.0, len(chord))
    points = np.column_stack((index[numbers], rest / scale))
    x, y = points[ConvexHull(points).vertices].T
    run, rise = np.roll(x, -1) - x, np.roll(y, -1) - y
    slopes = rise[run != 0] / run[run != 0]
    heights = y - slopes[:, None] * x
    best = int(np.argmin(np.ptp(heights, axis=1)))
    middle = (heights[best].max() + heights[best].min()) / 2
    return chord + scale * (middle + slopes[best] * index), scale * float(np.ptp(heights[best])) / 2


def _lies_on(t: FloatArray, grid: FloatArray, deviation: float) -> bool:
    """Say whether stamps that deviate so much from a uniform grid lie on it but for their last digits.

    Args:
        t: (n,) the stamps.
        grid: (N,) uniform.
        deviation: the largest.
    """
    rounding = EXACT_PERIODS * float(grid[-1] - grid[0]) / (len(grid) - 1)
    return deviation <= rounding or deviation <= 0.5 * _clock_tick(t)


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
