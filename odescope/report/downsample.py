"""Downsampling of long lines to the minimum and maximum of every pixel, so that no peak is lost."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.report.data import Line, Role

DIGITS = 5  # of the span of a line: far finer than a pixel


def min_max(x: FloatArray, y: FloatArray, pixels: int) -> IntArray:
    """Return the indices, ascending, of the points worth drawing on that many pixels.

    Of every pixel the lowest and the highest point stay, and both ends of the line: what is drawn covers the same ink.

    Args:
        x: (N,) ascending.
        y: (N,) finite.
        pixels: width of the drawing.
    """
    if len(x) <= 2 * pixels:
        return np.arange(len(x), dtype=np.int64)
    inner = np.searchsorted(x, np.linspace(x[0], x[-1], pixels + 1)[1:-1])
    edges = np.unique(np.concatenate([[0], inner, [len(x)]]))
    kept = {0, len(x) - 1}
    for start, stop in pairwise(edges.tolist()):
        kept |= {start + int(np.argmin(y[start:stop])), start + int(np.argmax(y[start:stop]))}
    return np.array(sorted(kept), dtype=np.int64)


def line_of(
    label: str, role: Role, xs: Sequence[FloatArray], ys: Sequence[FloatArray], pixels: int, log: bool = False
) -> Line:
    """Return pieces of a line, one after the other on the axis, as one downsampled line, interrupted between them.

    Args:
        label: of the legend.
        role: how it is drawn.
        xs: abscissas of each piece, ascending from piece to piece too.
        ys: ordinates.
        pixels: width of the drawing.
        log: whether the abscissa is drawn on a logarithmic axis.
    """
    x, y = np.concatenate(xs), np.concatenate(ys)
    if not len(x):
        return Line(label=label, role=role, x=(), y=())
    kept = min_max(np.log(x) if log else x, y, pixels)
    piece = np.searchsorted(np.cumsum([len(p) for p in xs]), kept, side="right")
    breaks = np.flatnonzero(np.diff(piece)) + 1
    across = np.insert(x[kept] if log else _rounded(x[kept]), breaks, np.nan)
    up = np.insert(y[kept] if log else _rounded(y[kept]), breaks, np.nan)
    return Line(label=label, role=role, x=_listed(across), y=_listed(up))


def _rounded(values: FloatArray) -> FloatArray:
    span = float(np.ptp(values)) or float(np.abs(values).max())
    if span == 0.0:
        return values
    rounded: FloatArray = np.round(values, DIGITS - int(np.floor(np.log10(span))) - 1)
    return rounded


def _listed(values: FloatArray) -> tuple[float | None, ...]:
    return tuple(None if v != v else v for v in values.tolist())
