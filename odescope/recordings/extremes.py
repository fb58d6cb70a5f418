"""Where a column was in what was recorded."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from odescope.recordings.record import Stretch


def extremes(stretches: Iterable[Stretch], name: str) -> tuple[float, float]:
    """Return the least and the greatest measured sample of a column; +inf and -inf where there is none.

    What was filled in, and what does not count, is none.
    """
    low, high = np.inf, -np.inf
    for stretch in stretches:
        inside = slice(stretch.first, stretch.stop)
        values = stretch.record.column(name)[inside][stretch.record.counted(name)[inside] > 0.0]
        low, high = min(low, float(values.min(initial=np.inf))), max(high, float(values.max(initial=-np.inf)))
    return low, high
