"""Where a signal has a kink, which a filter rounds: a sample there is no outlier, however far off the filter it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.recordings.between_samples import looks_held
from odescope.recordings.record import Record

SIDE = 3  # samples on one side of a kink, through which a line is drawn
NEAR = 8  # usual distances of samples, at most, to the farthest of them
AROUND = 3  # samples on either side of where a held input jumps: a kink is likely there


def about_jumps(run: Record, inputs: Sequence[str]) -> BoolArray:
    """Return which samples (N,) are about where a held input jumps, so that what follows it has a kink."""
    jumps = np.zeros(len(run), dtype=np.bool_)
    for column in filter(looks_held, map(run.column, inputs)):
        jumps |= np.diff(column, prepend=column[0]) != 0.0
    found: BoolArray = np.convolve(jumps, np.ones(2 * AROUND), mode="full")[AROUND : AROUND + len(run)] > 0.0
    return found


def kinks(y: FloatArray, near: FloatArray, far: BoolArray, measured: BoolArray) -> BoolArray:
    """Return which samples (N,) far from the filtered signal are where it has a kink, as where an input jumps.

    A filter rounds kinks. There a sample lies on the line of those before or after it, or, where the signal is steep
    for a few samples, between the samples beside it and between the lines that either side draws; a wrong sample is off
    either line, and where the signal runs on, these say the same.

    Args:
        y: (N,) the samples of one record.
        near: (N,) how near to such a line is on it.
        far: (N,) which samples are far from the filtered signal.
        measured: (N,) whether they were.
    """
    found = np.zeros(len(y), dtype=np.bool_)
    usual, asked = np.flatnonzero(measured & ~far), np.flatnonzero(measured & far)
    if len(usual) < SIDE:
        return found
    value, close = y[asked], near[asked]
    on_line = np.abs(value - _lines(y, usual, asked, SIDE)) < close
    steep = _lines(y, usual, asked, 2)
    before = np.searchsorted(usual, asked) - 1
    beside = y[usual[np.stack([np.maximum(before, 0), np.minimum(before + 1, len(usual) - 1)])]]
    passes = [(value > side.min(axis=0) - close) & (value < side.max(axis=0) + close) for side in (beside, steep)]
    found[asked] = on_line.any(axis=0) | (passes[0] & passes[1])
    return found


def _lines(y: FloatArray, usual: IntArray, asked: IntArray, points: int) -> FloatArray:
    """Return what lines through so many samples before and after say of others, (2, asked); NaN where none is near.

    Args:
        y: (N,) the samples of one record.
        usual: which of them a line may go through.
        asked: which of them it is asked for.
        points: samples of a line.
    """
    found, after = np.full((2, len(asked)), np.nan), np.searchsorted(usual, asked)
    reach = NEAR * float(np.median(np.diff(usual)))
    for line, first in zip(found, (after - points, after), strict=True):
        there = np.flatnonzero((first >= 0) & (first + points <= len(usual)))
        at = usual[first[there][:, None] + np.arange(points)]
        away = (at - asked[there][:, None]).astype(float)
        centred = away - away.mean(axis=1, keepdims=True)
        slope = (centred * y[at]).sum(axis=1) / (centred**2).sum(axis=1)
        drawn = y[at].mean(axis=1) - slope * away.mean(axis=1)
        line[there] = np.where(np.abs(away).max(axis=1) <= reach, drawn, np.nan)
    return found
