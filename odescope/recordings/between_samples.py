"""What an input does between its samples: lines, band-limited interpolation, commands held over several rows."""

from __future__ import annotations

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray

REACH = 32  # samples to each side that a value between samples is made of
WINDOW = 8.0  # of Kaiser: what lies below 0.9 of half the sampling rate is kept to 1e-4
FINER = 4  # nodes a sample of a band-limited input that is laid out
IN_STEP = 20  # jumps, at least, that say that a command changes at every so many rows alone
ALONE = 0.9  # of the jumps: so many stand between samples that do not change
JUMP = 0.1  # standard deviations of the input: smaller jumps may be steps of a converter
CLEAR = 10.0  # times what it usually changes from one sample to the next: what else steps
RARE = 8  # samples a step, at least: what steps more often may be any signal


def shifted(samples: FloatArray, late: float) -> FloatArray:
    """Return a band-limited input (N,) as it was so many samples ago: windowed-sinc interpolation.

    Beyond its ends an input is taken to go on point-symmetrically about its first or last sample, for what is within
    the record, and to stay at that sample, for what is not.
    """
    at = np.arange(len(samples)) - late
    below = np.floor(at).astype(np.int64)
    between = _later(samples, float(np.median(at - below)))
    found: FloatArray = between[np.clip(below, 0, len(samples) - 1)]
    found[at <= 0.0], found[at >= len(samples) - 1.0] = samples[0], samples[-1]
    return found


def laid_out(samples: FloatArray) -> FloatArray:
    """Return nodes (FINER N,) of a polygon that stands for a band-limited input (N,): FINER a sample, the first at it.

    A polygon through an input of frequency w lies inside its bends and loses w^2/12 of it, w in radians a node. The
    nodes are moved outwards by that much, a twelfth of the second difference, so that means over intervals are right to
    fourth order. After the last sample the input stays.
    """
    fine = np.stack([_later(samples, k / FINER) for k in range(FINER)], axis=1).ravel()
    fine[-FINER:] = samples[-1]
    within = fine[: len(fine) - FINER + 1]
    within[1:-1] -= np.diff(within, 2) / 12.0
    return fine


def on_polygon(t: FloatArray, values: FloatArray, grid: FloatArray) -> FloatArray:
    """Return the values (N,) on a uniform grid of the polygon nearest, in least squares, to that through samples (n,).

    Its mean and its first moment about every point of the grid are those of the polygon through the samples: what is
    slow beside the period sees the same input. Samples that were merely moved to the grid would come a little early or
    late, and an input that was commanded by a clock with jitter does that together with its own deviation.

    Args:
        t: (n,) when the input was sampled, increasing; before the first and after the last sample it stays.
        values: (n,) samples.
        grid: (N,) on which the polygon is to stand, two points or more.
    """
    from scipy.linalg import solveh_banded

    count = len(grid)
    at = (t - grid[0]) * (count - 1) / (grid[-1] - grid[0])
    nodes = np.union1d(np.clip(at, 0.0, count - 1.0), np.arange(count))
    low, high = nodes[:-1], nodes[1:]
    middle = 0.5 * (low + high)
    cell = np.minimum(middle.astype(np.int64), count - 2)
    left, right = np.zeros(count), np.zeros(count)
    # Simpson's rule: between nodes a polygon times a hat function of the grid is a parabola.
    for place, share in ((low, 1.0 / 6.0), (middle, 2.0 / 3.0), (high, 1.0 / 6.0)):
        weighed, away = share * (high - low) * np.interp(place, at, values), place - cell
        left += np.bincount(cell, weighed * (1.0 - away), count)
        right += np.bincount(cell + 1, weighed * away, count)
    gram = np.full((2, count), 2.0 / 3.0)
    gram[0, [0, -1]], gram[1] = 1.0 / 3.0, 1.0 / 6.0
    found: FloatArray = solveh_banded(gram, left + right, lower=True)
    return found


def _later(samples: FloatArray, fraction: float) -> FloatArray:
    """Return a band-limited input (N,) a fraction of a sample after each sample."""
    if fraction == 0.0:
        return samples.copy()
    away = fraction + np.arange(REACH, -REACH, -1) - 1.0  # of the sample from the place between two, in samples
    weights = np.sinc(away) * np.i0(WINDOW * np.sqrt(1.0 - (away / REACH) ** 2))
    padded = np.pad(samples, (REACH - 1, REACH), mode="reflect", reflect_type="odd")
    found: FloatArray = np.correlate(padded, weights / weights.sum(), mode="valid")
    return found


def looks_held(samples: FloatArray) -> bool:
    """Say whether an input (N,) is seen to be held over several rows: runs of equal values between large jumps.

    One step is enough. A slow signal after a coarse converter has runs, too, but its jumps are small, and come at any
    row: a command that is computed every so many rows changes at these alone, however little.
    """
    changes = np.diff(samples)
    jumps = changes != 0.0
    if not jumps.any():
        return False
    still: BoolArray = ~jumps
    alone = still[:-2] & jumps[1:-1] & still[2:]
    large = float(np.median(np.abs(changes[jumps]))) > JUMP * float(samples.std())
    apart = int(np.count_nonzero(alone)) > ALONE * int(np.count_nonzero(jumps))
    return (large and apart) or _in_step(np.flatnonzero(jumps)) is not None


def _in_step(jumps: IntArray) -> tuple[int, int] | None:
    """Return at every how many samples, two or more, and from which on an input jumps (J,); None if often between."""
    if len(jumps) < IN_STEP:
        return None
    every = int(np.bincount(np.diff(jumps)).argmax())
    if every < 2:
        return None
    there = np.bincount(jumps % every)
    return (every, int(there.argmax())) if there.max() > ALONE * len(jumps) else None


def unseen_steps(points: IntArray, values: FloatArray) -> IntArray:
    """Return at which point a command stepped between samples (n - 1,) that are not next to each other; 0 if unknown.

    It is known where the command changes at every so many points, and one of these alone lies in the gap.

    Args:
        points: (n,) of its samples, not falling.
        values: (n,) samples.
    """
    before, after, changed = points[:-1], points[1:], np.diff(values) != 0.0
    unseen, found = changed & (after - before > 1), np.zeros_like(after)
    if not unseen.any() or (seen := _in_step(after[changed & (after - before == 1)])) is None:
        return found
    every, phase = seen
    first = before + 1 + (phase - before - 1) % every
    once = unseen & (first <= after) & (first + every > after)
    found[once] = first[once]
    return found


def steps_of(samples: FloatArray) -> IntArray:
    """Return the samples (S,) after which an input (N,) steps: large changes, rare and alone, of what hardly moves.

    None of an input that is no such signal.
    """
    changes = np.abs(np.diff(samples))
    large = (changes > JUMP * float(samples.std())) & (changes > CLEAR * float(np.median(changes)))
    beside = np.zeros_like(large)
    beside[1:] |= large[:-1]
    beside[:-1] |= large[1:]
    steps = np.flatnonzero(large & ~beside)
    return steps if RARE * np.count_nonzero(large) <= len(samples) else steps[:0]
