"""Angles that turn together at another ratio than one, as the wheels of a gear do."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Records

MOST = (0.005, 0.995)  # quantiles of an angle between which it counts: a wrong sample says nothing of a shaft
TURN = 2.0 * np.pi  # radians: each of them goes round, so that it is no pendulum that hangs beside another
TWIST = 1.0  # radians, of the slower: further apart they are not joined, or by something that is no shaft
LINE = 3  # samples, at least, of which one can say that they are on a line
SHARED = 0.5  # of what is not steady in the turning of the slower: they may part by less, or each turns by itself


def turning_together(records: Records, coordinates: Sequence[Coordinate]) -> tuple[tuple[str, str], ...]:
    """Return the pairs of angles that go round together, at some other ratio than one, but for less than a radian.

    Two that turn at steady rates of their own keep a ratio as well: what is not steady has to be common to both.
    What is between them is a function of the difference of one and a multiple of the other, which nothing repeats when
    they go round: a spring, say. Springs between angles that turn at one rate are among the mechanisms of angles.

    Args:
        records: with the angles in radians, without jumps of a turn.
        coordinates: what was measured.
    """
    angles = [c.name for c in coordinates if c.angle]
    about = {name: [_about_middle(run.column(name)) for run in records] for name in angles}
    going = [name for name in angles if max(map(np.ptp, about[name])) > TURN]
    unsteady = {a: max(_unsteady(run.t, of) for run, of in zip(records, about[a], strict=True)) for a in going}
    return tuple(
        (a, b) for a, b in combinations(going, 2) if _geared(about[a], about[b], min(unsteady[a], unsteady[b]))
    )


def shaft_note(angles: tuple[str, str]) -> str:
    """Return what is to be said of two angles that go round together."""
    one, other = angles
    return (
        f"{one} and {other} turn together, as the wheels of a gear do: the default library has powers of them, no sines"
    )


def _about_middle(angle: FloatArray) -> FloatArray:
    """Return an angle (N,) less its median, as far as most of its samples go."""
    found: FloatArray = np.clip(angle, *np.quantile(angle, MOST)) - np.median(angle)
    return found


def _unsteady(t: FloatArray, angle: FloatArray) -> float:
    """Return how far an angle (N,), clipped to where most of its samples are, goes from a steady rate, in radians."""
    most = (angle > angle.min()) & (angle < angle.max())
    if np.count_nonzero(most) < LINE:
        return 0.0
    since = t[most] - t[0]
    return float(np.ptp(angle[most] - np.polyval(np.polyfit(since, angle[most], 1), since)))


def _geared(one: Sequence[FloatArray], other: Sequence[FloatArray], unsteady: float) -> bool:
    """Say whether two angles (N,) a record part little from some ratio, and by more than TWIST from one to one.

    Args:
        one: of the angles.
        other: of them.
        unsteady: how far the slower goes from a steady rate, in radians.
    """
    x, y = (np.concatenate(of) for of in (one, other))
    fast, slow = (one, other) if x @ x >= y @ y else (other, one)
    ratio = float(x @ y) / min(float(x @ x), float(y @ y))
    return _twist(fast, slow, ratio) < min(TWIST, SHARED * unsteady) and _twist(fast, slow, 1.0) >= TWIST


def _twist(fast: Sequence[FloatArray], slow: Sequence[FloatArray], ratio: float) -> float:
    """Return the most that two angles (N,) a record part at a ratio, in radians of the slower, each by itself."""
    return float(max(np.ptp(_about_middle(f - ratio * s)) for f, s in zip(fast, slow, strict=True)) / abs(ratio))
