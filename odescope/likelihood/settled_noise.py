"""Searches once more with the noise that their model leaves of a record, where smoothing had shown another.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.followed import followed
from odescope.likelihood.search import CHANCE, Outcome
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import SHORT_RECORD, joined, searches
from odescope.likelihood.segments import Segments
from odescope.parallel.workers import Workers
from odescope.signals.noise import SOLVER
from odescope.signals.relative_noise import SURE, noise_of_recordings, relative_noise

ROUNDS = 4  # searches anew, at most
APART = 1.25  # times as far off the noise of one channel as that of another: errors and terms are worth other weights
SMOOTH = 0.5  # correlation of neighbours, above which what a model leaves is no noise


def with_noise_settled(
    space: SearchSpace, best: Outcome | None, begun: Sequence[FloatArray], workers: Workers
) -> tuple[SearchSpace, Outcome | None]:
    """Return space and end of the searches with the noise that their model leaves.

    Of few samples no filter tells noise from signal well. With too much noise terms are missed, with too little, or
    with the same everywhere where it grows with the readings, others come in to follow it. Where no model follows the
    record under noise that grows, what the filter left may not have been noise: it is then the same everywhere. Where
    the filter let noise pass, the right law does not follow the record either: what a model then leaves is noise where
    it is white with all segments joined. Of a longer record it matters where channels are off by different factors.

    Args:
        space: with the noise that the filter left.
        best: the best end of the searches, if one could be followed.
        begun: (mechanisms,) coefficients of each start.
        workers: where it is searched.
    """
    if space.segments.samples > SHORT_RECORD:
        return _with_channels_apart(space, best, workers)
    if best is None or not joined(best):
        even = with_even_noise(space)
        other, again = (space, None) if even is None else _searched(space.on(even), begun, workers)
        if again is None and best is not None:
            other, again = _searched_with_more_noise(space, best, begun, workers)
        if again is None:
            return space, best
        space, best = other, again
    for _ in range(ROUNDS):
        segments = None if space.budget.over else with_noise_left(space, best.fit)
        starts = [best.fit.theta, *begun]
        other, again = (space, None) if segments is None else _searched(space.on(segments), starts, workers)
        if again is None:
            break
        space, best = other, again
    return space, best


def _with_channels_apart(
    space: SearchSpace, best: Outcome | None, workers: Workers
) -> tuple[SearchSpace, Outcome | None]:
    """Return space and end of a search from a model on, with its channels' noises, where one stands out.

    What is off in all of them alike is a scale of the errors, and the search has it.

    Args:
        space: with the noise that the filter left.
        best: the best end of the searches, if one could be followed.
        workers: where it is searched.
    """
    if best is None or not joined(best) or space.budget.over:
        return space, best
    segments = with_noise_left(space, best.fit)
    ratio = np.ones(1) if segments is None else segments.noise / space.segments.noise
    if segments is None or ratio.max() < APART * ratio.min():
        return space, best
    other, again = _searched(space.on(segments), [best.fit.theta], workers)
    return (space, best) if again is None else (other, again)


def _searched(space: SearchSpace, begun: Sequence[FloatArray], workers: Workers) -> tuple[SearchSpace, Outcome | None]:
    """Return the space and the best end of searches in it, None where that does not follow the record."""
    outcomes = searches(space, begun, None, space.budget.monitor, workers)
    space.budget.spent += sum(o.spent for o in outcomes)
    best = min(outcomes, key=lambda o: o.rank, default=None)
    if best is None or not joined(best):
        return space, None
    return space.with_constants(best.constants), best


def _searched_with_more_noise(
    space: SearchSpace, best: Outcome, begun: Sequence[FloatArray], workers: Workers
) -> tuple[SearchSpace, Outcome | None]:
    """Return space and end of searches with the noise that a model leaves, None where what is then left is no noise.

    Args:
        space: with less noise.
        best: the end of the searches in it, which does not follow the record.
        begun: (mechanisms,) coefficients of each start.
        workers: where it is searched.
    """
    segments = None if space.budget.over else with_noise_left(space, best.fit, sure=0.0)
    if segments is None or np.all(segments.noise <= space.segments.noise):
        return space, None
    louder, found = _searched(space.on(segments), [best.fit.theta, *begun], workers)
    return (louder, found) if found is not None and _leaves_white_noise(louder, found.fit) else (space, None)


def _leaves_white_noise(space: SearchSpace, found: Fit) -> bool:
    """Say whether neighbours in what a fit leaves of each channel go together no more than by chance."""
    _, rest, there = _left(space, found)
    columns = (r[t] for r, t in zip(rest.T, there.T, strict=True))
    return all(_correlation(r) <= CHANCE / np.sqrt(max(len(r), 1)) for r in columns)


def with_even_noise(space: SearchSpace) -> Segments | None:
    """Return the segments with noise that is the same everywhere, None where it is."""
    segments, share, weight = space.segments, space.segments.share, space.segments.weight
    if weight is None or share is None or np.array_equal(weight, share):
        return None
    # In units of its root mean square noise is largest where the weight falls most short of the number of samples.
    largest = np.divide(share, weight, out=np.zeros_like(share), where=share > 0.0).max(axis=0)
    return replace(segments, weight=share, spread=_spread(space, 1.0 / largest))


def _spread(space: SearchSpace, ratio: FloatArray) -> FloatArray:
    """Return the smoothing errors (n,) of all states where the noise of each channel (c,) is so many times as large."""
    spread = space.segments.spread.copy()
    for state, times in zip(space.frame.measured.tolist(), ratio.tolist(), strict=True):
        while state >= 0:
            spread[state] *= times
            state = int(space.frame.following[state])
    return spread


def with_noise_left(space: SearchSpace, found: Fit, sure: float = SURE) -> Segments | None:
    """Return the segments with the noise that a fit leaves, None where they are as likely with that which they have.

    Args:
        space: of the fit.
        found: what leaves it.
        sure: fall of -2 ln(likelihood) that is asked for.
    """
    segments, (signal, rests, seen) = space.segments, _left(space, found)
    share = _share(segments)
    weight = np.ones_like(share) if segments.weight is None else segments.weight
    # A log that was solved for and not measured may be off by so much, and a filter has hidden that.
    least = np.maximum(0.0 if segments.floor is None else segments.floor, SOLVER * segments.measured.std(axis=0))
    taken = len(found.free) + found.x0.shape[1] * int((~segments.joined).sum())
    free = max(segments.samples - taken, 1) / segments.samples
    noise, weights, ratio, gain = segments.noise.copy(), weight.copy(), np.ones(len(segments.noise)), 0.0
    for c in range(len(noise)):
        rest, there = rests[:, c], seen[:, c]
        before = segments.noise[c] * share[there, c] / weight[there, c]
        level = max(float(np.sqrt(np.mean(rest[there] ** 2) / free)), float(least[c]))
        if level < segments.noise[c] and _smooth(rest[there]):
            return None
        grows = None
        if c not in segments.steady:
            grows = relative_noise(rest, signal[:, c], there, level * np.sqrt(1.0 - free))
        each = np.full(len(rest), level) if grows is None else level * grows.level * grows.deviations
        differs = noise_of_recordings(rest / each, there, segments.runs, free, float(least[c]) / level)
        after = (each if differs is None else each * differs)[there]
        noise[c] = np.sqrt(np.mean(after**2)) if np.ptp(after) else level
        weights[there, c] = share[there, c] * noise[c] / after
        ratio[c] = after.max() / before.max()
        gain += float(np.sum(2.0 * np.log(before / after) + (rest[there] / before) ** 2 - (rest[there] / after) ** 2))
    if gain < sure:
        return None
    return replace(segments, noise=noise, weight=weights, spread=_spread(space, ratio))


def _smooth(rest: FloatArray) -> bool:
    """Say whether a residual (n,) is no noise: what solvers, filters and steps of integration err by is smooth."""
    return _correlation(rest) > SMOOTH


def _correlation(rest: FloatArray) -> float:
    """Return the correlation of neighbours in a residual (n,)."""
    return float(rest[1:] @ rest[:-1]) / max(float(rest @ rest), 1e-300)


def _share(segments: Segments) -> FloatArray:
    """Return the share (N, c) of the weight of every average that follows from its number of samples."""
    return np.ones_like(segments.measured) if segments.share is None else segments.share


def _left(space: SearchSpace, found: Fit) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return what a fit says of every average (N, c), what it leaves of it, and whether it was measured and followed.

    What it leaves is in units of what the number of samples lets expect.

    Args:
        space: of the fit.
        found: it.
    """
    (signal, seen), share = followed(space, found), _share(space.segments)
    return signal, share * (space.segments.measured - signal), seen[:, None] & (share > 0.0)
