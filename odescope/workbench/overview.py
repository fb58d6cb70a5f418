"""A long line as a picture shows it: the lowest and the highest point of every pixel, whatever part is looked at."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Literal

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.report.downsample import min_max

BLOCK = 64  # points of which the lowest and the highest are kept
MOST_POINTS = 400_000  # that are looked through one by one; of more the blocks are


@dataclass(frozen=True, eq=False)
class Overview:
    """A line in pieces as they were read, not one of them copied, and the extremes of blocks of points.

    Attributes:
        ts: abscissas of the pieces, (n,) each, ascending throughout.
        ys: ordinates of the same shapes; NaN where there is none.
        edges: first point of every piece, and the number of all.
        at: (m,) numbers of the points that are lowest or highest in their block, ascending; the ends of pieces, too.
        t: (m,) their abscissas.
        y: (m,) their ordinates.
    """

    ts: tuple[FloatArray, ...]
    ys: tuple[FloatArray, ...]
    edges: tuple[int, ...]
    at: IntArray
    t: FloatArray
    y: FloatArray

    @staticmethod
    def of(ts: Sequence[FloatArray], ys: Sequence[FloatArray]) -> Overview:
        """Return the overview of a line.

        Args:
            ts: abscissas of its pieces, (n,) each, ascending throughout.
            ys: ordinates.
        """
        filled = [k for k, t in enumerate(ts) if len(t)]
        ts, ys = [ts[k] for k in filled], [ys[k] for k in filled]
        edges = (0, *accumulate(len(t) for t in ts))
        kept = [extremes(y) for y in ys]
        empty = np.empty(0)
        return Overview(
            tuple(ts),
            tuple(ys),
            edges,
            np.concatenate([k + first for k, first in zip(kept, edges, strict=False)] or [np.empty(0, np.int64)]),
            np.concatenate([t[k] for t, k in zip(ts, kept, strict=True)] or [empty]),
            np.concatenate([y[k] for y, k in zip(ys, kept, strict=True)] or [empty]),
        )

    @property
    def span(self) -> tuple[float, float]:
        """The first and the last abscissa."""
        return (float(self.ts[0][0]), float(self.ts[-1][-1])) if self.ts else (0.0, 1.0)

    def window(self, begin: float, end: float, pixels: int) -> tuple[FloatArray, FloatArray]:
        """Return the points (k,) worth drawing between two abscissas, and the next one on either side.

        Args:
            begin: where the picture begins.
            end: where it ends.
            pixels: its width.
        """
        first, stop = max(self._number(begin, "left") - 1, 0), min(self._number(end, "right") + 1, self.edges[-1])
        if stop - first > MOST_POINTS:
            inner = slice(*np.searchsorted(self.at, (first, stop)).tolist())
            t, y = self.t[inner], self.y[inner]
        else:
            t, y = self._points(first, stop)
        there = np.isfinite(y) & np.isfinite(t)
        t, y = t[there], y[there]
        kept = min_max(t, y, pixels)
        return t[kept], y[kept]

    def _number(self, abscissa: float, side: Literal["left", "right"]) -> int:
        """Return how many points lie left of an abscissa, on its "right" those at it too."""
        if not self.ts:
            return 0
        piece = max(bisect_right([t[0] for t in self.ts], abscissa) - 1, 0)
        while side == "left" and piece and self.ts[piece][0] >= abscissa:
            piece -= 1
        return self.edges[piece] + int(np.searchsorted(self.ts[piece], abscissa, side))

    def _points(self, first: int, stop: int) -> tuple[FloatArray, FloatArray]:
        ts, ys = [np.empty(0)], [np.empty(0)]
        for t, y, edge in zip(self.ts, self.ys, self.edges, strict=False):
            low, high = max(first - edge, 0), min(stop - edge, len(t))
            if low < high:
                ts.append(t[low:high])
                ys.append(y[low:high])
        return np.concatenate(ts), np.concatenate(ys)


def extremes(y: FloatArray) -> IntArray:
    """Return the numbers of the lowest and the highest of every block of points (n,), of both ends, ascending."""
    whole = len(y) // BLOCK * BLOCK
    blocks = y[:whole].reshape(-1, BLOCK)
    starts = np.arange(0, whole, BLOCK)
    low, high = blocks.argmin(axis=1), blocks.argmax(axis=1)
    lacking = np.flatnonzero(np.isnan(blocks[np.arange(len(blocks)), low]))  # the least of numbers with NaN is NaN
    low[lacking] = np.where(np.isnan(blocks[lacking]), np.inf, blocks[lacking]).argmin(axis=1)
    high[lacking] = np.where(np.isnan(blocks[lacking]), -np.inf, blocks[lacking]).argmax(axis=1)
    both = np.stack([starts + np.minimum(low, high), starts + np.maximum(low, high)], axis=1).ravel()
    found: IntArray = np.concatenate([np.zeros(min(len(y), 1), np.int64), both, np.arange(max(whole - 1, 0), len(y))])
    return found[np.diff(found, prepend=-1) > 0]
