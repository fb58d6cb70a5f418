"""Array types; shapes stand in the docstrings: N samples, m candidate terms, T targets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class ArrowStream(Protocol):
    """A table with the Arrow interface: a dataframe of pandas or Polars, a table of PyArrow."""

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Return the table as a capsule that holds an Arrow stream."""


Table = ArrowStream | Mapping[str, ArrayLike]  # columns by name


def robust_deviation(values: FloatArray) -> float:
    """Return the standard deviation of normal values with the median absolute deviation of these (N,)."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def true_ranges(inside: BoolArray) -> list[tuple[int, int]]:
    """Return the first of every range of samples (N,) that are all inside, and the one after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))
