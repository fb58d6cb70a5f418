"""Samples that are wrong, told by the filtered signal.

Clipping them is Huber's loss, by pseudo-observations (Huber and Ronchetti 2009, section 7.8). Those that are far off
are taken for not measured at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import BoolArray, FloatArray, robust_deviation, true_ranges
from odescope.errors import NoModelError
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records, Stretch
from odescope.recordings.repeats import PLATEAU
from odescope.signals.appearance import appearance
from odescope.signals.differentiators import Differentiator, derivatives_like
from odescope.signals.filling import BANDS, LEFT, filled
from odescope.signals.kinks import about_jumps, kinks
from odescope.signals.relative_noise import FAR, recording_levels, usual_deviations
from odescope.signals.taken_out import taken_out

STEPS = 0.25  # root mean squares of the motion from sample to sample: what is nearer may be a kink of the signal
SIGNAL_LEFT = 0.5  # correlation of neighbours in what a filter leaves, beyond which that is no noise
PULLED = 0.25  # of what it is off, that a wrong sample is at least off a filter that is not robust
MOST = 0.5  # of the samples of a coordinate: where more are far off, none is usual
USUAL = 0.95  # of the steps between samples that differ are no leaps of outliers
COUNTS = 1.5  # of a sensor: what runs into the end of its range comes by more a sample
BEND = 3.0  # standard deviations beyond which a residual counts no more than this
ROUNDS = 8
MANY = 300  # samples of a log, which is then fast beside its motion
KINK = 0.35  # of what a sample is off the filtered signal, that it may be off the line of others at a kink
BENT = 2.0  # times as far off either that a sample may be about where a held input jumps
IN_A_ROW = 4  # spikes: of two beside each other the nearer to the others is clipped first
SHARP = 0.4  # of what a spike is off, that it is at least off the mean of the two samples beside it
NEIGHBOURS = (1, 2, 3, 4, 5, 7, 9)  # samples away, on either side: of four spikes in a row most say what the others are


@dataclass(frozen=True)
class Clipping:
    """How each coordinate is clipped: for every round the cutoff in hertz, and the bound in the coordinate's unit.

    `period` is that of the samples, in seconds.
    """

    rounds: Mapping[str, tuple[tuple[float, float], ...]]
    period: float


def settle_clipping(records: Records, coordinates: Sequence[Coordinate], differentiator: Differentiator) -> Clipping:
    """Return how residuals about the filtered coordinates are to be clipped.

    Filtering what is clipped minimises Huber's loss of what was recorded; the deviation is the median one, which
    outliers do not move. Cutoff and deviation settle in a few rounds, each beginning from the record itself.

    Args:
        records: uniformly sampled, at one period.
        coordinates: what was measured.
        differentiator: filters them.
    """
    rounds = {
        c.name: _robustly_filtered(records, c, differentiator, ROUNDS, [run.column(c.name) for run in records])[0]
        for c in coordinates
    }
    return Clipping(rounds, records.runs[0].sample_period)


def _robustly_filtered(
    records: Records,
    coordinate: Coordinate,
    differentiator: Differentiator,
    rounds: int,
    clipped: list[FloatArray],
    growing: bool = False,
) -> tuple[tuple[tuple[float, float], ...], list[FloatArray]]:
    """Return cutoff and bound of every round of clipping, at most so many, and the filtered signal of the last.

    Args:
        records: uniformly sampled, at one period.
        coordinate: what was measured.
        differentiator: filters it.
        rounds: at most.
        clipped: (N,) the samples of every record that the first round filters.
        growing: whether the bound may grow with the signal.
    """
    recorded = [run.column(coordinate.name) for run in records]
    measured = [run.counted(coordinate.name) > 0.0 for run in records]
    taken, smooth = list[tuple[float, float]](), recorded
    for _ in range(rounds):
        cutoff, smooth = _filtered(clipped, measured, records.runs[0].sample_period, coordinate, differentiator)
        left = [(y - s)[n] for y, s, n in zip(recorded, smooth, measured, strict=True)]
        levels = recording_levels(left)
        bound = BEND * robust_deviation(np.concatenate([r / level for r, level in zip(left, levels, strict=True)]))
        if bound == 0.0:  # more than half of the samples are on the filtered signal: nothing says what is usual
            break
        taken.append((cutoff, bound))
        if growing:
            width = usual_deviations(left, [s[n] for s, n in zip(smooth, measured, strict=True)])
            grown = [BEND * wide for wide in width(smooth)]
        else:
            grown = [np.full(len(s), level * bound) for s, level in zip(smooth, levels, strict=True)]
        again = [_clipped(y, s, b) for y, s, b in zip(recorded, smooth, grown, strict=True)]
        moved = max(float(np.abs(a - b).max()) for a, b in zip(again, clipped, strict=True))
        clipped = again
        if moved < 0.01 * bound:
            break
    return tuple(taken), smooth


def _filtered(
    clipped: Sequence[FloatArray],
    measured: Sequence[BoolArray],
    period: float,
    coordinate: Coordinate,
    differentiator: Differentiator,
) -> tuple[float, list[FloatArray]]:
    """Return the cutoff, and the filtered signal (N,) of every record.

    Between samples of which there are few stands what was filled in: the cutoff that seems best there goes through
    every sample, and nothing is left to tell a wrong one by. It is no higher than half of their band.

    Args:
        clipped: (N,) the samples of every record.
        measured: (N,) which of them were.
        period: of the samples, in seconds.
        coordinate: what was measured.
        differentiator: filters it.
    """
    found = differentiator.derivatives(clipped, period, coordinate.order)
    highest = float(np.mean(np.concatenate(measured))) / (BANDS * period)
    if all(map(np.all, measured)) or found.cutoff <= highest:
        return found.cutoff, [s[0] for s in found.values]
    like = derivatives_like(differentiator, highest, clipped, [False] * len(clipped), period, coordinate.order)
    return highest, [s[0] for s in like]


def _without_spikes(recorded: Sequence[FloatArray]) -> list[FloatArray]:
    """Return samples (N,) clipped about their neighbours, of which the first cutoff is found.

    Spikes in one of several records stand above the noise of all at every frequency: taken for signal they would have
    the first cutoff so high that no round of clipping comes back from there. What is usual is told by the middle one
    of the means of the neighbours at one to nine samples on either side, as four spikes in a row leave that alone.
    In a log of few samples the motion turns within as many: there a knee would be clipped.
    """
    if sum(map(len, recorded)) < MANY:
        return list(recorded)
    found, between = list(recorded), [_between_neighbours(y) for y in recorded]
    off = [y - m for y, (m, _) in zip(found, between, strict=True)]
    levels = recording_levels(off)
    usual = robust_deviation(np.concatenate([o / level for o, level in zip(off, levels, strict=True)]))
    bounds = [FAR * level * usual for level in levels]
    for _ in range(IN_A_ROW if usual > 0.0 else 0):
        spikes = [_spikes(y, *those, bound) for y, those, bound in zip(found, between, bounds, strict=True)]
        if not any(map(np.any, spikes)):
            break
        far = zip(found, spikes, between, bounds, strict=True)
        found = [np.where(there, _clipped(y, m, bound), y) for y, there, (m, _), bound in far]
        between = [_between_neighbours(y) for y in found]
    return found


def _spikes(y: FloatArray, middle: FloatArray, apart: FloatArray, bound: float) -> BoolArray:
    """Return which samples (N,) are spikes: a peak of the signal goes up and down over several.

    Args:
        y: (N,) the samples.
        middle: (N,) what their neighbours say.
        apart: (N,) how far that is apart.
        bound: from which on a sample is off.
    """
    beside = np.concatenate([y[1:2], 0.5 * (y[2:] + y[:-2]), y[-2:-1]])
    off = np.abs(y - middle)
    spikes: BoolArray = (off > np.maximum(apart, bound)) & (np.abs(y - beside) > SHARP * off)
    return spikes


def _between_neighbours(y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the middle of what neighbours say (N,) of every sample, and how far that is apart.

    They say their mean, near the ends what lies on a line through two of them. A motion that bends moves that further
    apart than a sample is from the middle.
    """
    found, apart, reach = y.copy(), np.zeros(len(y)), max(NEIGHBOURS)
    if len(y) > 3 * reach:
        inside = slice(reach, len(y) - reach)
        means = [0.5 * (np.roll(y, k) + np.roll(y, -k))[inside] for k in NEIGHBOURS]
        found[inside], apart[inside] = np.median(means, axis=0), np.ptp(means, axis=0)
        for along, middle, width in ((y, found, apart), (y[::-1], found[::-1], apart[::-1])):
            lines = [2.0 * along[k : k + reach] - along[2 * k : 2 * k + reach] for k in NEIGHBOURS]
            middle[:reach], width[:reach] = np.median(lines, axis=0), np.ptp(lines, axis=0)
    return found, apart


def gate_outliers(records: Records, coordinates: Sequence[Coordinate], differentiator: Differentiator) -> Records:
    """Return records in which samples far from the signal count as not measured.

    Late reads, stale values and outliers are further from the filtered signal than noise or a kink of the signal can
    be; samples at the end of a sensor's range say nothing of what is beyond. The signal is filtered robustly first.

    Args:
        records: uniformly sampled, at one period.
        coordinates: what was measured.
        differentiator: filters them.

    Raises:
        NoModelError: so many samples are far off that none is usual.
    """
    inputs = [name for name in records.names if name not in {c.name for c in coordinates}]
    jumps = [about_jumps(run, inputs) for run in records]
    gone = list[dict[str, BoolArray]]({} for _ in records)
    for c in coordinates:
        measured = [run.counted(c.name) > 0.0 for run in records]
        far = [f & m for f, m in zip(_far(records, c, differentiator, jumps), measured, strict=True)]
        found = sum(int(f.sum()) for f in far)
        if found >= MOST * sum(int(m.sum()) for m in measured):
            raise NoModelError(
                "signals",
                f"{found} of {records.samples} samples of {c.name} are at the end of the sensor's range or far"
                f" from any smooth signal: {appearance([run.column(c.name) for run in records])}",
            )
        for out, f in zip(gone, far if found else (), strict=bool(found)):
            out[c.name] = f
    if not any(gone):
        return records
    return filled(Records.of(map(taken_out, records, gone)), coordinates, differentiator)


def _far(
    records: Records, coordinate: Coordinate, differentiator: Differentiator, jumps: Sequence[BoolArray]
) -> list[BoolArray]:
    """Return which samples (N,) of every record are far from the signal, or at an end of the sensor's range.

    Args:
        records: uniformly sampled, at one period.
        coordinate: what was measured.
        differentiator: filters it.
        jumps: where (N,) a kink is likely.
    """
    recorded = [run.column(coordinate.name) for run in records]
    measured = [run.counted(coordinate.name) > 0.0 for run in records]
    saturated = _saturated(recorded, measured)
    # A wrong sample pulls a filter that is not robust: where even then none is off its share, none is far.
    first = _without_spikes(recorded)
    _, limits, rest = _residuals(records, coordinate, differentiator, 1, PULLED * STEPS, first)
    if not any((np.abs(r) > limit).any() for r, limit in zip(rest, limits, strict=True)):
        return saturated
    bound, limits, rest = _residuals(records, coordinate, differentiator, ROUNDS, STEPS, first)
    if _left_signal([np.clip(r, -bound, bound) for r in rest]) > SIGNAL_LEFT:
        return saturated
    more = [np.where(j, BENT, 1.0) for j in jumps]
    far = [np.abs(r) > limit * m for r, limit, m in zip(rest, limits, more, strict=True)]
    near = [KINK * m * np.abs(r) for r, m in zip(rest, more, strict=True)]
    bent = map(kinks, recorded, near, far, measured)
    return [s | (f & ~k) for s, f, k in zip(saturated, far, bent, strict=True)]


def _residuals(
    records: Records,
    coordinate: Coordinate,
    differentiator: Differentiator,
    rounds: int,
    steps: float,
    first: list[FloatArray],
) -> tuple[float, list[FloatArray], list[FloatArray]]:
    """Return the bound of the last round of clipping, the residuals from which on samples are far, and residuals.

    Args:
        records: uniformly sampled, at one period.
        coordinate: what was measured.
        differentiator: filters it.
        rounds: of clipping, at most.
        steps: root mean square steps of the signal from which on a sample may be far.
        first: (N,) the samples of every record that the first round filters.
    """
    recorded = [run.column(coordinate.name) for run in records]
    taken, smooth = _robustly_filtered(records, coordinate, differentiator, rounds, first, True)
    bound = taken[-1][1] if taken else 0.0
    motion = np.concatenate([np.diff(s) for s in smooth])
    rest = [y - s for y, s in zip(recorded, smooth, strict=True)]
    if not taken:
        return bound, [np.full(len(r), np.inf) for r in rest], rest
    measured = [run.counted(coordinate.name) > 0.0 for run in records]
    left, there = ([v[n] for v, n in zip(values, measured, strict=True)] for values in (rest, smooth))
    width, least = usual_deviations(left, there), steps * float(np.sqrt(np.mean(motion**2)))
    # A filter takes its share of the noise with it: two parameters a period of its cutoff.
    taken_with = 2.0 * taken[-1][0] * records.runs[0].sample_period * sum(map(len, rest)) / sum(map(len, left))
    far = FAR / np.sqrt(max(1.0 - taken_with, LEFT))
    each = zip(width(smooth), recording_levels(left), strict=True)
    return bound, [np.maximum(far * np.maximum(wide, level * bound / BEND), least) for wide, level in each], rest


def _left_signal(rest: Sequence[FloatArray]) -> float:
    """Return the correlation of neighbours in what a filter leaves: that of white noise is about nothing."""
    power = sum(float(r @ r) for r in rest)
    return sum(float(r[1:] @ r[:-1]) for r in rest) / power if power > 0.0 else 0.0


def _saturated(columns: Sequence[FloatArray], measured: Sequence[BoolArray]) -> list[BoolArray]:
    """Return which samples (N,) of every record stand at an end of the sensor's range, into which it ran moving.

    Args:
        columns: the samples.
        measured: which were: what is filled in between the others goes beyond the end.
    """
    found = [np.zeros(len(y), dtype=np.bool_) for y in columns]
    read = [y[there] for y, there in zip(columns, measured, strict=True)]
    ends = [(float(y.min()), float(y.max())) for y in read if len(y)]
    low, high = min((a for a, _ in ends), default=0.0), max((b for _, b in ends), default=0.0)
    for own, y, there in zip(found, read, measured, strict=True):
        own[there] = _at_ends(y, low, high)
    return found


def _at_ends(y: FloatArray, low: float, high: float) -> BoolArray:
    """Return which samples (N,) stand at an end of a range, into which they ran moving."""
    far, pace = np.zeros(len(y), dtype=np.bool_), np.abs(np.diff(y))
    if not pace.any():
        return far
    moves = pace[pace > 0.0]
    usual = float(np.sqrt(np.mean(np.minimum(pace, np.quantile(moves, USUAL)) ** 2)))
    # An encoder that comes to rest moves by single counts; a switch, whose only step is its range, has none.
    count = float(moves.min()) if moves.min() < 0.1 * (high - low) else 0.0
    least = max(STEPS * usual, COUNTS * count)
    for end in (high, low):
        for first, stop in true_ranges(y == end):
            around = np.concatenate([pace[max(first - 2, 0) : first], pace[stop - 1 : stop + 1]])
            if stop - first >= PLATEAU and len(around) and around.mean() > least:
                far |= y == end  # where the sensor is seen to end, shorter stays are no readings either
                break
    return far


def clip_outliers(
    stretches: Sequence[Stretch],
    coordinates: Sequence[Coordinate],
    differentiator: Differentiator,
    clipping: Clipping,
) -> tuple[Stretch, ...]:
    """Return records clipped as was settled.

    Args:
        stretches: uniformly sampled.
        coordinates: what was measured.
        differentiator: with which the clipping was settled.
        clipping: see `settle_clipping`.
    """
    columns, cut = {}, [s.cut for s in stretches]
    for c in coordinates:
        recorded = clipped = [s.record.column(c.name) for s in stretches]
        for cutoff, bound in clipping.rounds[c.name]:
            smooth = derivatives_like(differentiator, cutoff, clipped, cut, clipping.period, c.order)
            clipped = [_clipped(y, s[0], bound) for y, s in zip(recorded, smooth, strict=True)]
        columns[c.name] = clipped
    return tuple(replace(s, record=_replaced(s.record, columns, k)) for k, s in enumerate(stretches))


def count_clipped(
    before: Sequence[Stretch], after: Sequence[Stretch], coordinates: Sequence[Coordinate]
) -> dict[str, int]:
    """Return how many samples of each coordinate differ.

    Args:
        before: the records as they were.
        after: as they were clipped.
        coordinates: what was measured.
    """
    pairs = [(a.record, b.record) for a, b in zip(before, after, strict=True)]
    return {c.name: sum(int((a.column(c.name) != b.column(c.name)).sum()) for a, b in pairs) for c in coordinates}


def _clipped(recorded: FloatArray, smooth: FloatArray, bound: float | FloatArray) -> FloatArray:
    residual = recorded - smooth
    clipped: FloatArray = np.where(np.abs(residual) > bound, smooth + np.sign(residual) * bound, recorded)
    return clipped


def _replaced(run: Record, columns: dict[str, list[np.ndarray]], k: int) -> Record:
    values = run.values.copy()
    for name, clipped in columns.items():
        values[:, run.names.index(name)] = clipped[k]
    return replace(run, values=values)
