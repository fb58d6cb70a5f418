"""What a recording's time stamps are worth: the period, lost rows, and whether sampling or only the clock jitters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray, robust_deviation
from odescope.recordings.gaps import GAP_PERIODS, RawRun
from odescope.recordings.local_spline import fit_between, fit_smooth
from odescope.recordings.lost_rows import sample_numbers

EXACT_PERIODS = 1e-6  # deviations below this are the rounding of the clock's last digits
EXACT_STEPS = 0.1  # periods by which steps may differ from whole ones: what counts is the grid that they add up to
REGULAR = -0.25  # lag-1 autocorrelation of steps: -1/2 is a regular clock read with jitter, 0 irregular sampling
DRIFT = 256  # samples over which a clock keeps its rate
SURE = 3.0  # standard deviations of chi-squared beyond which a clock is seen to drift
FAR = 4.0  # standard deviations of jitter: what is further away is not the jitter of reading, but a late sample
LATE = 0.05  # periods: what is nearer to its regular time is not late, however regular the clock
MEASURED = 0.25  # of the points of a grid that a clock of whole steps lies on: of fewer the steps fit by chance
ROUNDS = 3  # of fitting a line less what is far from it
BALANCED = 10  # long steps of a coarse clock, at least: so many rows lost by chance do not fall as evenly as its ticks
TICKS = 0.75  # by which stamps of a clock that ticks coarsely are off a line, at most: half of one is its rounding
LOCAL = 5  # samples that say together how smooth a motion is at some times
SEEN = 10.0  # in log-likelihood: by so much the stamps of a clock make a motion smoother than regular times
TRUE_STAMPS = 0.5  # slope of residuals on motion: 1 if stamps say when samples were taken, 0 if they only jitter


@dataclass(frozen=True, eq=False)
class Stamps:
    """The times t (n,) at which samples were taken, and the grid that suits them, `origin` + `period` * number.

    `jitter` is the standard deviation, in periods, of the recorded stamps about them; 0 where they are the stamps.
    """

    t: FloatArray
    origin: float
    period: float
    jitter: float = 0.0


def whole_steps(t: FloatArray) -> IntArray | None:
    """Return the number (n,) of each sample where rows of a regular clock are lost all over, None where that is not so.

    Steps are then whole multiples of the shortest, whatever their mean: many are longer, and come later for good. A
    clock that ticks coarsely and is read with jitter has such steps, too, but what comes late is made up for by the
    next.
    """
    steps = np.diff(t)
    shortest = float(steps.min())
    whole = np.rint(steps / shortest)
    period = float(t[-1] - t[0]) / float(whole.sum())
    if len(t) < MEASURED * whole.sum() or np.abs(steps - whole * period).max() > EXACT_STEPS * period:
        return None
    regular = sample_numbers(t)
    rest = t - t[0] - (t[-1] - t[0]) / regular[-1] * regular
    if _autocorrelation(rest, regular, np.zeros(len(t), dtype=np.bool_)) < REGULAR:
        return None
    found: IntArray = np.concatenate([[0], np.cumsum(whole)]).astype(np.int64)
    return found


def ticks_coarsely(run: RawRun, rough: frozenset[str], inputs: frozenset[str] = frozenset()) -> bool:
    """Say whether a regular clock was read in ticks not much shorter than its period, so that some steps are of two.

    They look like those of a faster clock that lost rows; but its long steps would not come so evenly that the stamps
    keep to a line over the number of the row. Where every tenth row was lost, they do: the values tell, then.

    Args:
        run: in order, its angles unwrapped.
        rough: names of the columns that jump and say nothing of time.
        inputs: names of the columns that are commanded.
    """
    steps = np.diff(run.t)
    tick = float(steps.min())
    whole, rounding = np.rint(steps / tick), 4.0 * float(np.spacing(np.abs(run.t).max()))
    if whole.max() != 2.0 or np.abs(steps - whole * tick).max() > EXACT_PERIODS * tick + rounding:
        return False
    if np.median(whole) != 1.0 or np.count_nonzero(whole == 2.0) < BALANCED:
        return False
    t, numbers = run.t - run.t[0], np.arange(len(run.t))
    slope, origin = np.polyfit(numbers, t, 1)
    regular = origin + slope * numbers
    if np.abs(t - regular).max() > TICKS * tick:
        return False
    silent = rough | inputs if frozenset(run.names) - rough - inputs else rough
    told = [np.flatnonzero(~np.isnan(y)) for y in run.values.T]
    columns = [(k, there) for k, there in enumerate(told) if run.names[k] not in silent and len(there) > LOCAL]
    return sum(_evener(t[there], regular[there], run.values[there, k]) for k, there in columns) < SEEN


def _evener(t: FloatArray, other: FloatArray, y: FloatArray) -> float:
    """Return how much likelier samples y (n,) were taken at t than at other times, in log-likelihood.

    Each is predicted by a cubic through two samples before and two after it, at true times as well as noise lets.
    """
    misfits = []
    for time in (t, other):
        off, weights = off_cubics(time, y)
        misfits.append(float(np.mean(off**2 / (1.0 + np.sum(weights**2, axis=1)))))
    least = EXACT_PERIODS**2 * float(np.var(y)) + 1e-300
    return 0.5 * len(y) * float(np.log((misfits[1] + least) / (misfits[0] + least)))


def off_cubics(t: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far samples (n - 4,) are off cubics through two before and two after each, and the weights of these.

    Args:
        t: (n,) increasing, five or more.
        y: (n,) samples.
    """
    windows = np.lib.stride_tricks.sliding_window_view(t, LOCAL)
    away = np.delete(windows, LOCAL // 2, axis=1) - windows[:, LOCAL // 2, None]
    between = away[:, :, None] - away[:, None, :]
    np.einsum("ijj->ij", between)[:] = -away  # so that the product holds the numerator of a weight, too
    weights: FloatArray = np.prod(-away, axis=1)[:, None] / np.prod(between, axis=2)
    near = np.delete(np.lib.stride_tricks.sliding_window_view(y, LOCAL), LOCAL // 2, axis=1)
    off: FloatArray = y[LOCAL // 2 : -(LOCAL // 2)] - np.sum(weights * near, axis=1)
    return off, weights


def read_clock(run: RawRun, rough: frozenset[str], inputs: frozenset[str] = frozenset()) -> Stamps:
    """Return when the samples of a run were taken, and the grid that suits them.

    Where the steps have the autocorrelation of a regular clock read with jitter, a line through the stamps, or a smooth
    curve where the clock drifts, is taken for the times, unless the values say otherwise: irregular sampling may have
    that autocorrelation too, but then the motion between the regular and the recorded time of a sample shows in
    its residual about a smooth curve. Samples that come late are judged one by one by their values.

    Args:
        run: in order, its angles unwrapped.
        rough: names of the columns that jump and say nothing of time.
        inputs: names of the columns that are commanded. Commands may run by the number of the sample, whenever it was
            taken: whether sampling is regular the others say, if there are any.
    """
    t, numbers = run.t - run.t[0], sample_numbers(run.t)
    origin, period = _line(numbers, t)
    regular = origin + period * numbers
    regular = regular + _drift(t - regular, numbers, period)
    rest = t - regular
    far = _far(rest, period)
    if np.abs(rest[~far]).max() > GAP_PERIODS * period:  # no line goes through the stamps: there is no regular clock
        return Stamps(run.t, float(run.t[0]), float(np.median(np.diff(t))))
    jitters = _autocorrelation(rest, numbers, far) < REGULAR
    taken, jitter = t, 0.0
    if jitters or far.any():
        moved, own = _told_by_values(t, regular, far, run, rough, inputs)
        if jitters and moved <= TRUE_STAMPS:
            taken, jitter = regular, float(np.std(rest[~far])) / period
        taken = np.where(far, np.where(own > 0.0, t, regular), taken)
    if np.any(np.diff(taken) <= 0.0):
        taken, jitter = t, 0.0
    return Stamps(taken + run.t[0], origin + run.t[0], period, jitter)


def _line(numbers: IntArray, t: FloatArray) -> tuple[float, float]:
    """Return origin and slope of the line through stamps, those that are far from it left out."""
    inside = np.ones(len(t), dtype=np.bool_)
    for _ in range(ROUNDS):
        slope, origin = np.polyfit(numbers[inside], t[inside], 1)
        inside = ~_far(t - origin - slope * numbers, slope)
    return float(origin), float(slope)


def _far(rest: FloatArray, period: float) -> BoolArray:
    """Tell which samples (n,) are further from their regular times than jitter would have them."""
    far: BoolArray = np.abs(rest - np.median(rest)) > max(FAR * robust_deviation(rest), LATE * period)
    return far


def _autocorrelation(rest: FloatArray, numbers: IntArray, far: BoolArray) -> float:
    """Return the lag-1 autocorrelation of the steps of time less their mean, late samples left out."""
    steps = np.where(far[1:] | far[:-1] | (np.diff(numbers) != 1), 0.0, np.diff(rest))
    power = float(steps @ steps)
    return float(steps[1:] @ steps[:-1]) / power if power > 0.0 else 0.0


def _drift(rest: FloatArray, numbers: IntArray, period: float) -> FloatArray:
    """Return how far a clock runs away from its mean rate, smooth over so many samples that jitter averages out."""
    near = np.flatnonzero(~_far(rest, period))
    blocks = len(near) // DRIFT
    if blocks < 2:
        return np.zeros(len(rest))
    where, height = np.array([(numbers[b].mean(), rest[b].mean()) for b in np.array_split(near, blocks)]).T
    spread = np.var(np.diff(rest[near])) / (2.0 * DRIFT)  # of the mean of a block, were there jitter alone
    if np.sum((height - height.mean()) ** 2) <= (blocks + SURE * np.sqrt(2.0 * blocks)) * spread:
        return np.zeros(len(rest))
    drift: FloatArray = np.interp(numbers, where, height)
    return drift


def _told_by_values(
    t: FloatArray, regular: FloatArray, far: BoolArray, run: RawRun, rough: frozenset[str], inputs: frozenset[str]
) -> tuple[float, FloatArray]:
    """Return what values say of when samples were taken, at t or at `regular` times.

    First the slope of the residuals about smooth curves on the motion between the two: 0 at regular times, 1 at t.
    Then by how much the misfit of each sample (n,) is less at t.

    Args:
        t: (n,) as recorded.
        regular: (n,) as a regular clock has them.
        far: (n,) which samples come late.
        run: the samples.
        rough: names of the columns that say nothing of time.
        inputs: names of those that say nothing of the slope, beside others.
    """
    silent = inputs if frozenset(run.names) - rough - inputs else frozenset[str]()
    shown = motions = 0.0
    gain = np.zeros(len(t))
    for k in (k for k, name in enumerate(run.names) if name not in rough):
        there = ~np.isnan(run.values[:, k])
        near = there & ~far
        at, y = regular[near], run.values[near, k]
        smooth = fit_smooth(at, y, np.ones(len(y)))
        rest = y - smooth(at)
        motion = smooth.derivative()(at) * (t - regular)[near]
        noise = max(float(rest @ rest), 1e-300)
        if run.names[k] not in silent:
            seen = motion - fit_between(at, motion, smooth)(at)  # the curve itself follows the rest of it
            shown += float(rest @ seen) / noise
            motions += float(seen @ seen) / noise
        misfit = [(run.values[there, k] - smooth(time[there])) ** 2 for time in (regular, t)]
        gain[there] += (misfit[0] - misfit[1]) / noise
    return (shown / motions if motions > 0.0 else 0.0), gain
