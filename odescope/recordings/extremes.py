"""Where a column was in what was recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from odescope.arrays import BoolArray
from odescope.recordings.record import Stretch


def every(stretch: Stretch) -> BoolArray:
    """Return that every sample (N,) of a stretch is taken."""
    return np.ones(len(stretch.record), dtype=np.bool_)


def extremes(
    stretches: Iterable[Stretch], name: str, taken: Callable[[Stretch], BoolArray] = every
) -> tuple[float, float]:
    """Return the least and the greatest measured sample of a column; +inf and -inf where there is none.

    What was filled in, and what does not count, is none.

    Args:
        stretches: of recordings.
        name: of the column.
        taken: says which samples (N,) of a stretch are.
    """
    low, high = np.inf, -np.inf
    for stretch in stretches:
        inside = slice(stretch.first, stretch.stop)
        there = ((stretch.record.counted(name) > 0.0) & taken(stretch))[inside]
        values = stretch.record.column(name)[inside][there]
        low, high = min(low, float(values.min(initial=np.inf))), max(high, float(values.max(initial=-np.inf)))
    return low, high
