"""The compiled least-squares kernel behind every proposer: a small QR on columns of R."""

from __future__ import annotations

import numba
import numpy as np

from odescope.arrays import FloatArray, IntArray

RANK_TOLERANCE = 1e-12  # a unit column with less than this left of it adds nothing that rounding did not


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def least_squares(r: FloatArray, support: IntArray, left: int) -> tuple[FloatArray, float]:
    """Return the coefficients (s,) that best explain column `left` of r by the columns `support`, and |residual|^2.

    Householder QR without pivoting; a column that depends on those before it gets the coefficient 0.
    Columns of r are zero below the diagonal, so only the rows down to the last column used take part.
    """
    s = support.shape[0]
    rows = left + 1
    for j in range(s):
        rows = max(rows, support[j] + 1)
    a = np.empty((s + 1, rows))
    for j in range(s + 1):
        column = support[j] if j < s else left
        for i in range(rows):
            a[j, i] = r[i, column]
    diagonal = np.zeros(s)
    row = 0
    place = np.full(s, -1)
    for j in range(s):
        if row >= rows:
            break
        norm = 0.0
        for i in range(row, rows):
            norm += a[j, i] * a[j, i]
        norm = np.sqrt(norm)
        if norm < RANK_TOLERANCE:
            continue
        alpha = -norm if a[j, row] > 0 else norm
        a[j, row] -= alpha
        length = 0.0
        for i in range(row, rows):
            length += a[j, i] * a[j, i]
        for k in range(j + 1, s + 1):
            dot = 0.0
            for i in range(row, rows):
                dot += a[j, i] * a[k, i]
            factor = 2.0 * dot / length
            for i in range(row, rows):
                a[k, i] -= factor * a[j, i]
        diagonal[j] = alpha
        place[j] = row
        row += 1
    x = np.zeros(s)
    for j in range(s - 1, -1, -1):
        if place[j] < 0:
            continue
        total = a[s, place[j]]
        for k in range(j + 1, s):
            if place[k] >= 0:
                total -= a[k, place[j]] * x[k]
        x[j] = total / diagonal[j]
    rest = 0.0
    for i in range(row, rows):
        rest += a[s, i] * a[s, i]
    return x, rest
