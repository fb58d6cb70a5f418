"""The likeliest path through the rows of a clock, of which some are lost and some come late: compiled.

Apart from `lost_rows`, because few logs lose rows, and what compiles is slow to import.
"""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.parallel.kernels import kernel

LOSS = 4.0  # in log-likelihood: rows are lost at one place of fifty
LATE_ROW = 8.0  # in log-likelihood: a stamp that is further off than four standard deviations of the jitter is late
LATER = 0.1  # in log-likelihood for every period that it is further off
PATHS = 16  # that are followed at a time, at most
MOST_LATE = 32  # rows in a row that may come late, and are made up for
FOLLOWING = 16  # rows over which the clock's phase is averaged


@kernel()
def lost_before(late: FloatArray, jitter: float) -> IntArray:
    """Return how many rows (n,) are lost before each.

    A path says how many were lost so far, and what the clock's phase is. At each row there is one path for every number
    of lost rows that may be right (Viterbi's algorithm), in rising order. Few can become more, at the price of a loss,
    and never less: a path is given up where one of fewer is cheaper by that.

    Args:
        late: (n,) how many periods later each row comes than if none were lost.
        jitter: standard deviation of the stamps in periods.
    """
    n, levels = late.shape[0], np.zeros(PATHS + 3, np.int64)
    lost, before = np.zeros((n, PATHS), np.int32), np.zeros((n, PATHS), np.int8)
    cost, phase, paths, cheapest = np.zeros(PATHS), np.full(PATHS, late[0]), 1, 0
    next_cost, next_phase = np.zeros(PATHS), np.zeros(PATHS)
    for i in range(1, n):
        for k in range(paths):
            levels[k] = lost[i - 1, k]
        nearest = int(np.rint(late[i] - phase[cheapest]))
        for k in range(3):
            levels[paths + k] = nearest - 1 + k
        count, last, least = 0, -1, np.inf
        for level in np.sort(levels[: paths + 3]):
            if level == last:
                continue
            last = level
            price, path, at = _cheapest_way(late[i] - level, level - lost[i - 1, :paths], cost, phase, jitter, i)
            if price >= least + LOSS:
                continue
            if price < least:
                # Paths so much dearer have taken too many rows for late ones; the first goes where there is no room.
                kept = 0
                for k in range(count):
                    if next_cost[k] < price + LATE_ROW * MOST_LATE and (k > 0 or count < PATHS):
                        next_cost[kept], next_phase[kept] = next_cost[k], next_phase[k]
                        lost[i, kept], before[i, kept] = lost[i, k], before[i, k]
                        kept += 1
                cheapest, least, count = kept, price, kept
            if count < PATHS:
                next_cost[count], next_phase[count] = price, at
                lost[i, count], before[i, count] = level, path
                count += 1
        paths = count
        for k in range(paths):
            cost[k], phase[k] = next_cost[k], next_phase[k]
    found, path = np.zeros(n, np.int64), cheapest
    for i in range(n - 1, -1, -1):
        found[i] = lost[i, path]
        path = before[i, path]
    return found


@kernel()
def _cheapest_way(
    late: float, losses: IntArray, cost: FloatArray, phase: FloatArray, jitter: float, row: int
) -> tuple[float, int, float]:
    """Return what the cheapest path to a number of lost rows costs, infinity if there is none, its number, its phase.

    Args:
        late: by how many periods the row comes late under that number.
        losses: (paths,) how many rows each path would lose before this one; none gets any back.
        cost: of each path.
        phase: of each path, in periods.
        jitter: standard deviation of the stamps in periods.
        row: its number.
    """
    least, best, at = np.inf, -1, 0.0
    for path in range(losses.shape[0]):
        if losses[path] < 0:
            continue
        off = late - phase[path]
        total = cost[path] + min(0.5 * (off / jitter) ** 2, LATE_ROW + LATER * abs(off))
        if losses[path] > 0:
            total += LOSS
        if total < least:
            moved = min(max(off, -2.0 * jitter), 2.0 * jitter) / min(row + 1, FOLLOWING)
            least, best, at = total, path, phase[path] + moved
    return least, best, at
