"""How a record becomes fit for use: its angles unwrapped, its time made uniform."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.recordings.checks import check_radians
from odescope.recordings.gaps import GAP_PERIODS
from odescope.recordings.record import Record, within

EXACT_PERIODS = 1e-6  # deviations below this are the rounding of the clock's last digits
PLAIN = 0.75 * np.pi  # steps of an angle up to which a jump by 2 pi cannot be taken for one, or one for a jump
RISE = 1.1  # times the least turn between windows: longer ones only see more of the motion
LARGEST_JITTER = 0.25  # beyond it a sample is no longer nearest to its own grid point


def unwrap(record: Record, angles: Iterable[str]) -> Record:
    """Return the record with the 2 pi jumps of the named columns removed; InputError if they jump by 360 instead."""
    values = record.values.copy()
    for name in angles:
        column = record.column(name)
        check_radians(name, column, record.source)
        values[:, record.names.index(name)] = _unwrapped(column)
    return replace(record, values=values)


def _unwrapped(angle: FloatArray) -> FloatArray:
    """Return an angle (N,) without its jumps by 2 pi.

    From sample to sample noise alone may step further than pi, and every such step taken for a jump would shift all
    that follows by a turn. The mean direction of a window hardly knows noise: it is unwrapped instead, and every sample
    is put next to it.
    """
    plain: FloatArray = np.unwrap(angle)
    window = 1 if np.abs(np.diff(plain)).max() < PLAIN else _window(angle)
    if window == 1:
        return plain
    mean = np.unwrap(np.angle(_sums(angle, window)))
    before = window // 2
    smooth = np.pad(mean, (before, window - 1 - before), mode="edge")
    near: FloatArray = angle + 2.0 * np.pi * np.rint((smooth - angle) / (2.0 * np.pi))
    return near


def _window(angle: FloatArray) -> int:
    """Return the window in samples between whose mean directions the angle turns least, at the worst place.

    In short windows it is noise that turns it, in long ones motion: of a record without noise it is one sample.
    """
    best, least, window = 1, np.inf, 1
    while 4 * window <= len(angle):
        mean = _sums(angle, window)
        worst = float(np.abs(np.angle(mean[window:] * mean[:-window].conj())).max())
        if worst > RISE * least:
            break
        if worst < least:
            best, least = window, worst
        window *= 2
    return best


def _sums(angle: FloatArray, window: int) -> NDArray[np.complex128]:
    """Return the sums of the directions in every window, as complex numbers (N - window + 1,)."""
    total = np.concatenate([[0.0], np.cumsum(np.exp(1j * angle))])
    sums: NDArray[np.complex128] = total[window:] - total[:-window]
    return sums


def uniform(record: Record, jitter: float = 0.05, held: frozenset[str] = frozenset()) -> Record:
    """Return the record on an exactly uniform time grid of as many samples.

    Jitter is the smallest, over all uniform grids, of the largest deviation of a sample from its grid point, in
    sample periods. Where it is rounding (below 1e-6, or within half a tick of the clock that wrote the times), the
    values stay and time becomes the grid. Up to `jitter` the columns are interpolated by cubic splines, except those
    in `held`: a held value fills the interval after it, and its own grid interval is the one that it fills most of.

    Args:
        record: without gaps.
        jitter: the tolerance, in sample periods.
        held: names of the columns that keep a value until the next one.

    Raises:
        InputError: the jitter is above the tolerance, or a step is longer than 1.5 periods: a gap.
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
