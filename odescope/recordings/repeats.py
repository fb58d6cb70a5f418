"""Values that a sensor did not measure anew, told by their being the same to the last digit."""

from __future__ import annotations

import numpy as np

from odescope.arrays import BoolArray, FloatArray, true_ranges

PLATEAU = 5  # equal samples at the end of a sensor's range that are no chance
LONGEST = 3  # equal samples in a row: more are of what rests, or of a sensor that is slow
WIDE = 20.0  # least steps that a value moves by before and after it is repeated: what creeps moves by one
NEAR = 10  # least steps: how often values differ by up to so many tells how often they are the same by chance
FEW = 3.0  # repeats beside that, and times as many as by chance, that are none


def stays_at_end(y: FloatArray) -> BoolArray:
    """Return which samples (n,) are at an end of their range, where so many in a row are that they are no chance.

    Args:
        y: (n,) samples, in order.
    """
    found = np.zeros(len(y), dtype=np.bool_)
    for end in (y.min(), y.max()):
        if any(stop - first >= PLATEAU for first, stop in true_ranges(y == end)):
            found |= y == end
    return found


def stale(y: FloatArray) -> BoolArray:
    """Return which samples (n,) repeat the one beside them, where neither resolution nor rest makes that likely.

    What is read before it is measured again has the value of the sample before, what is written too late that of the
    sample after: which of the two it is in a log is told by what lies nearer to the line between their neighbours.

    Args:
        y: (n,) samples, in order.
    """
    gone, steps = np.zeros(len(y), dtype=np.bool_), np.abs(np.diff(y))
    moves = steps[steps > 0.0]
    if not len(moves):
        return gone
    least = float(moves.min())
    chance = np.count_nonzero(moves < (NEAR + 0.5) * least) / (2.0 * NEAR)
    inside = [(a, b) for a, b in true_ranges(steps == 0.0) if a > 0 and b < len(steps) and b - a < LONGEST]
    rows = np.array([(a, b) for a, b in inside if min(steps[a - 1], steps[b]) >= WIDE * least], dtype=np.int64)
    if len(rows) == 0 or np.sum(rows[:, 1] - rows[:, 0]) <= FEW * chance + FEW:
        return gone
    first, last = rows.T
    slope = (y[last + 1] - y[first - 1]) / (last + 2 - first)
    off = y[first] - y[first - 1] - slope  # at the first of the equal samples, from the line between their neighbours
    before = np.sum(off**2) <= np.sum((off - slope * (last - first)) ** 2)
    for a, b in rows.tolist():
        gone[a + before : b + before] = True
    return gone
