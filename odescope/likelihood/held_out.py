"""What searches do not see, and how free runs of it go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import SHORT, Segments

FIFTH = 5  # one record in so many is held out; of fewer records, that part of each
FEW = 3  # stretches of which no spread can be told
SEARCHED = 12_000  # averages of a long record that a search works on: they tell structures apart, the rest adds digits
STRETCHES = 10  # of a long record that it sees a part of
WINDOWS = 4  # free runs a stretch that is held out


def stretches(segments: Segments) -> list[tuple[int, int]]:
    """Return begin and end, in averages, of every record, or of the fifths of each if these are few.

    A record of few averages beside others has no fifths.
    """
    if len(segments.runs) >= FIFTH:
        return list(segments.runs)
    fifths = ((end, (end - begin) // FIFTH) for begin, end in segments.runs if end - begin >= FIFTH)
    return [(end - (k + 1) * length, end - k * length) for end, length in fifths for k in reversed(range(FIFTH))]


def held_out(segments: Segments) -> list[tuple[int, int]]:
    """Return begin and end, in averages, of what searches do not see: every fifth record, or the end of each if few."""
    return stretches(segments)[FIFTH - 1 :: FIFTH]


def without_held_out(segments: Segments) -> Segments:
    """Return the segments that have nothing in common with what is held out, shorter ones where all have."""
    keep = _seen(segments)
    if not keep.any():
        segments = segments.cut_anew(SHORT)
        keep = _seen(segments)
    return _kept(segments, keep)


def _seen(segments: Segments) -> BoolArray:
    """Return which segments (J,) have nothing in common with what is held out."""
    begin, end = segments.start, segments.start + segments.count
    keep = np.ones(len(begin), dtype=np.bool_)
    for low, high in held_out(segments):
        keep &= (end <= low) | (begin >= high)
    return keep


def thinned(segments: Segments) -> Segments:
    """Return stretches spread evenly over a record that is more than twice as long as a search needs."""
    total = int(segments.count.sum())
    if total <= 2 * SEARCHED:
        return segments
    stretch = total / STRETCHES
    keep = np.mod(np.cumsum(segments.count) - segments.count, stretch) < SEARCHED / STRETCHES
    return _kept(segments, keep)


def _kept(segments: Segments, keep: BoolArray) -> Segments:
    """Return some of the segments, joined where neighbours are kept."""
    joined = segments.joined & np.append(keep[1:], False)
    return replace(segments, start=segments.start[keep], count=segments.count[keep], joined=joined[keep])


def free_run_errors(
    space: SearchSpace, theta: FloatArray, over: Sequence[tuple[int, int]] | None = None, pieces: int = 0
) -> FloatArray:
    """Return the mean squared error of free runs over every stretch that is held out, each saturating at 1.

    Of few stretches every free run counts as one. They begin at smoothed states within the stretch, by the zeros of the
    model's sensors, away from its edges where smoothing is poor, and last until its end; errors are in units of the
    channel's variance over all records.

    Args:
        space: the data and candidates.
        theta: (mechanisms,) coefficients.
        over: begin and end of stretches instead of those.
        pieces: instead of to the end of its stretch, so many runs follow each other.
    """
    segments, over = space.segments, held_out(space.segments) if over is None else over
    measured, count = segments.measured, pieces or WINDOWS
    begins = [[low + (2 * k + 1) * (high - low) // (2 * count + 2) for k in range(count)] for low, high in over]
    ends = [[*b[1:], high] if pieces else [high] * count for b, (_, high) in zip(begins, over, strict=True)]
    start, end = np.array(begins, dtype=np.int64).ravel(), np.array(ends, dtype=np.int64).ravel()
    loose = replace(
        segments,
        start=start,
        count=end - start,
        joined=np.zeros(len(start), dtype=np.bool_),
        noise=np.maximum(measured.std(axis=0), 1e-300),
    )
    present = np.flatnonzero(theta)
    evaluator, program, none = space.on(loose).evaluator, space.program(present), np.zeros(0, dtype=np.int64)
    offsets, begun = program.offsets, segments.filtered[start]
    begun[:, program.frame.measured] -= np.where(offsets < 0, 0.0, theta[present][offsets])
    cost = evaluator.integrate(program, theta[present], none, begun).cost
    weight = np.ones_like(measured) if segments.weight is None else segments.weight
    total = np.array([np.sum(weight[low:high] ** 2) for low, high in zip(start, end, strict=True)])
    error = cost / np.maximum(total, 1e-300)
    bounded = np.divide(error, 1.0 + error, out=np.ones_like(error), where=np.isfinite(error))
    errors: FloatArray = bounded.reshape(-1, count).mean(axis=1)
    return errors if len(errors) >= FEW else bounded


def free_run_error(space: SearchSpace, theta: FloatArray) -> float:
    """Return the mean of `free_run_errors`."""
    return float(free_run_errors(space, theta).mean())
