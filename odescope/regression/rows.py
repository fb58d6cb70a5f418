"""What a regression fits: blocks of the record mapped to rows, plain samples or cosines weighted by their noise.

A relation holds at every sample, so it holds for any linear map of the samples. The noise of a k-th derivative grows
with frequency like w^k and ends at the cutoff, so plain samples let the worst frequencies decide. `NoiseWeighted` takes
the cosine transform of each block, keeps the bins below the lowest cutoff and divides them by the noise found there:
generalised least squares. docs/decisions/0002 has the figures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Protocol, TypeVar

import msgspec
import numpy as np
import scipy.fft

from odescope.arrays import FloatArray
from odescope.parallel.workers import Threads
from odescope.regression.factor import Factor, factorise, merge
from odescope.regression.proposers import MatchingPursuit
from odescope.signals.estimate import Signals
from odescope.signals.spectral import bin_frequencies

Result = TypeVar("Result")

FOLDS = 5  # blocks of the record held out in turn
LEAST_BINS_A_BLOCK = 40  # a block with fewer cosines below the cutoff is not cut further
LONGEST_BLOCK = 1 << 14  # samples: the library of a block stands in memory, that of a record need not
TAPER_PERIODS = 2.0  # of the cutoff, at each end of a block, and at most a tenth of it
SMOOTHING_BINS = 81  # neighbours averaged into the noise spectrum
ROWS_A_COLUMN = 5  # fewer rows than this for each term of a fit leave no residual to learn the noise from


@dataclass(frozen=True)
class Block:
    """A stretch of one record; blocks of one fold are held out together."""

    record: int
    start: int
    stop: int
    fold: int


class BlockValues(Protocol):
    """Values of candidates on every block, perhaps made anew each time they are asked for."""

    def __len__(self) -> int:
        """Return the number of blocks."""
        ...

    def __getitem__(self, block: int) -> FloatArray:
        """Return the values (m, samples of the block)."""
        ...


class RowMap(Protocol):
    """A linear map from the samples of a block to rows."""

    def rows(self, columns: FloatArray) -> FloatArray:
        """Return the rows (n, p) of columns (p, samples of the block)."""
        ...


class RowChoice(Protocol):
    """Chooses the map for one target from the values of its library."""

    def row_map(self, signals: Signals, order: int, blocks: Sequence[Block], values: BlockValues, left: int) -> RowMap:
        """Return the map.

        Args:
            signals: where the values come from.
            order: order of the target's equation.
            blocks: stretches of the record.
            values: library columns (m, n_b) on every block.
            left: the column of the target itself.
        """
        ...


def cut_blocks(signals: Signals, folds: Sequence[int] | None = None) -> tuple[Block, ...]:
    """Return the blocks that are held out in turn: stretches of long records, whole short ones.

    Args:
        signals: that are cut.
        folds: the fold of each record, all of its blocks alike; by default blocks take turns.
    """
    lowest = min(c.cutoff for c in signals.channels)
    pieces = []
    wanted = 1 if folds is not None else -(-FOLDS // len(signals.columns))
    for r, columns in enumerate(signals.columns):
        count = columns.shape[1]
        bins = 2.0 * count * signals.period * lowest
        parts = int(max(1, min(wanted, bins // LEAST_BINS_A_BLOCK), -(-count // LONGEST_BLOCK)))
        edges = np.linspace(0, count, parts + 1).astype(int)
        pieces += [(r, int(a), int(b)) for a, b in pairwise(edges)]
    return tuple(Block(r, a, b, k % FOLDS if folds is None else folds[r]) for k, (r, a, b) in enumerate(pieces))


@dataclass(frozen=True)
class SampleRows:
    """The samples themselves."""

    def rows(self, columns: FloatArray) -> FloatArray:
        """Return columns as rows."""
        return columns.T


@dataclass(frozen=True, eq=False)
class CosineRows:
    """Cosines of a tapered block below `cutoff` hertz, times the weight at their frequency.

    Shapes: frequency (F,) ascending, weight (F,), interpolated between.
    """

    period: float
    cutoff: float
    frequency: FloatArray
    weight: FloatArray

    def rows(self, columns: FloatArray) -> FloatArray:
        """Return the weighted cosines (bins, p)."""
        cosines, frequency = self.cosines(columns)
        return cosines * np.interp(frequency, self.frequency, self.weight)[:, None]

    def cosines(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the unweighted cosines (bins, p) and their frequencies (bins,)."""
        count = columns.shape[1]
        ramp = max(1, round(min(TAPER_PERIODS / (self.cutoff * self.period), count / 10)))
        taper = np.ones(count)
        taper[:ramp] = np.sin(0.5 * np.pi * (np.arange(ramp) + 0.5) / ramp) ** 2
        taper[-ramp:] = taper[:ramp][::-1]
        length = scipy.fft.next_fast_len(count, real=True)
        frequency = bin_frequencies(length, self.period)
        bins = int(np.searchsorted(frequency, self.cutoff, side="right"))
        spectrum = scipy.fft.dct(columns * taper, n=length, axis=1, norm="ortho")
        return np.ascontiguousarray(spectrum[:, :bins].T), frequency[:bins]


class PlainRows(msgspec.Struct, frozen=True, tag="samples", tag_field="kind", forbid_unknown_fields=True):
    """The paper's rows: every sample counts alike."""

    def row_map(self, signals: Signals, order: int, blocks: Sequence[Block], values: BlockValues, left: int) -> RowMap:
        """Return the map that keeps the samples."""
        return SampleRows()


class NoiseWeighted(msgspec.Struct, frozen=True, tag="noise_weighted", tag_field="kind", forbid_unknown_fields=True):
    """Cosines below the lowest cutoff, weighted by the inverse of the noise of the relation.

    First w^-k, the noise of a k-th derivative under white measurement noise; then the spectrum, smoothed, of the
    residual of a fit with as many candidates as the rows allow: noise of other coordinates has another colour.

    Attributes:
        passes: how often the weights are found anew from residuals.
    """

    passes: Annotated[int, msgspec.Meta(ge=0, le=10)] = 1

    def row_map(self, signals: Signals, order: int, blocks: Sequence[Block], values: BlockValues, left: int) -> RowMap:
        """Return the weighted cosines for this library."""
        cutoff = min(c.cutoff for c in signals.channels)
        grid = np.linspace(0.0, cutoff, 512)
        # A twentieth of the cutoff keeps the slowest cosines from outweighing all others.
        rows = CosineRows(signals.period, cutoff, grid, (grid**2 + (cutoff / 20) ** 2) ** (-order / 2))
        for _ in range(self.passes):
            factor = merge(_on_each(values, lambda v, rows=rows: factorise([rows.rows(v)])))  # type: ignore[misc]
            xi = factor.solve(_rich(factor, left), left)
            parts = _on_each(values, lambda v, rows=rows, xi=xi: rows.cosines((xi @ v)[None, :]))  # type: ignore[misc]
            frequency = np.concatenate([f for _, f in parts])
            power = np.concatenate([c[:, 0] for c, _ in parts]) ** 2
            sequence = np.argsort(frequency, kind="stable")
            smooth = _moving_mean(power[sequence], SMOOTHING_BINS)
            floor = 1e-6 * float(np.median(smooth)) + 1e-300
            weight = 1.0 / np.sqrt(np.maximum(smooth, floor))
            rows = CosineRows(signals.period, cutoff, frequency[sequence], weight / weight.max())
        return rows


def _on_each(values: BlockValues, function: Callable[[FloatArray], Result]) -> list[Result]:
    """Return the function of the values of every block, evaluated where they are needed."""
    return list(Threads().map(lambda k: function(values[k]), range(len(values))))


def _rich(factor: Factor, left: int) -> Sequence[int]:
    """Return the columns of a fit that leaves little but noise: all, or where rows are few the best by pursuit."""
    everything = tuple(range(factor.width))
    if factor.rows >= ROWS_A_COLUMN * factor.width:
        return everything
    path = list(MatchingPursuit(max(1, factor.rows // (2 * ROWS_A_COLUMN))).supports(factor, left, everything))
    return (*path[-1], left) if path else (left,)


def _moving_mean(values: FloatArray, width: int) -> FloatArray:
    """Return the centred moving mean; near the ends over what there is."""
    half = min(width, len(values)) // 2
    sums = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    mean: FloatArray = (sums[high] - sums[low]) / (high - low)
    return mean


AnyRows = NoiseWeighted | PlainRows
