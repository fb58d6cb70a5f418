"""Angles of a run, unwrapped: the jumps by 2 pi taken out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from odescope.arrays import FloatArray
from odescope.recordings.checks import TURNS, check_radians
from odescope.recordings.gaps import GAP_PERIODS, RawRun

PLAIN = 0.75 * np.pi  # steps of an angle up to which a jump by 2 pi cannot be taken for one, or one for a jump
JUMP = 1.0  # rad: how far a jump by 2 pi may be from that
ASIDE = 0.01  # of the samples of an angle that may be far off at either side
RISE = 1.1  # times the least turn between windows: longer ones only see more of the motion
AROUND = 4  # samples on either side of a gap, at least, from which the speed of an angle is told
TOLD = 0.5  # of a gap's length: the speed over less than that, beside it, says nothing of turns within


def unwrap(run: RawRun, angles: Iterable[str]) -> RawRun:
    """Return the run with the 2 pi jumps of the named columns removed, told from the samples that were measured.

    Across a gap an angle goes on at the mean of its speeds before and after.

    Raises:
        InputError: an angle jumps by 360 instead.
    """
    values = run.values.copy()
    for name in angles:
        k = run.names.index(name)
        there = np.flatnonzero(~np.isnan(values[:, k]))
        column = values[there, k]
        check_radians(name, column, run.source)
        values[there, k] = _bridged(run.t[there], _unwrapped(column))
    return replace(run, values=values)


def _bridged(t: FloatArray, angle: FloatArray) -> FloatArray:
    """Return an unwrapped angle (n,) with whole turns added where it may have made some in a gap."""
    steps = np.diff(t)
    period = np.median(steps)
    turns = np.zeros(len(angle))
    for k in np.flatnonzero(steps > GAP_PERIODS * period):
        around = max(AROUND, int(steps[k] / period))  # as long as the gap itself: noise must not make a turn
        before, after = slice(max(k - around, 0), k + 1), slice(k + 1, k + 2 + around)
        if min(np.ptp(t[before]), np.ptp(t[after])) < TOLD * steps[k]:
            continue
        speeds = [(angle[s][-1] - angle[s][0]) / np.ptp(t[s]) for s in (before, after)]
        expected = 0.5 * (speeds[0] + speeds[1]) * steps[k]
        turns[k + 1] = np.rint((expected - (angle[k + 1] - angle[k])) / (2.0 * np.pi))
    unwrapped: FloatArray = angle + 2.0 * np.pi * np.cumsum(turns)
    return unwrapped


def _unwrapped(angle: FloatArray) -> FloatArray:
    """Return an angle (N,) without its jumps by 2 pi.

    From sample to sample noise alone may step further than pi, and every such step taken for a jump would shift all
    that follows by a turn. The mean direction of a window hardly knows noise: it is unwrapped instead, and every sample
    is put next to it. What runs over several turns in steps that are no jumps is no wrapped angle, but one in degrees.
    """
    if _runs_on(angle):
        return angle
    plain: FloatArray = np.unwrap(angle)
    window = 1 if np.abs(np.diff(plain)).max() < PLAIN else _window(angle)
    if window == 1:
        return plain
    mean = np.unwrap(np.angle(_sums(angle, window)))
    before = window // 2
    smooth = np.pad(mean, (before, window - 1 - before), mode="edge")
    near: FloatArray = angle + 2.0 * np.pi * np.rint((smooth - angle) / (2.0 * np.pi))
    return near


def _runs_on(angle: FloatArray) -> bool:
    """Say whether an angle (N,) was recorded over several turns, and in steps longer than half a turn but no jumps."""
    steps = np.abs(np.diff(angle))
    long = steps[steps > np.pi]
    low, high = np.quantile(angle, [ASIDE, 1.0 - ASIDE])
    return bool(high - low > TURNS * 2.0 * np.pi and np.any(np.abs(long - 2.0 * np.pi) > JUMP))


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
