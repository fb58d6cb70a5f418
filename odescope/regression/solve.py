"""The compiled least-squares kernels behind every proposer: small fits on columns of R, thousands of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.parallel.kernels import kernel

PIVOT_TOLERANCE = 1e-9  # of a unit column: below it the normal equations have lost half the digits of r
RANK_TOLERANCE = 1e-12  # a unit column with less than this left of it adds nothing that rounding did not


@kernel()
def least_squares(r: FloatArray, support: IntArray, left: int) -> tuple[FloatArray, float]:
    """Return the coefficients (s,) that best explain column `left` of r by the columns `support`, and |residual|^2.

    Householder QR without pivoting; a column that depends on those before it gets the coefficient 0.
    Columns of r are zero below the diagonal, so only the rows down to the last column used take part.

    Args:
        r: (m, m) of the factor.
        support: columns that explain.
        left: column that is explained.
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


@kernel()
def _grown(array: NDArray[Any]) -> NDArray[Any]:
    larger = np.empty((2 * array.shape[0], array.shape[1]), dtype=array.dtype)
    for i in range(array.shape[0]):
        for j in range(array.shape[1]):
            larger[i, j] = array[i, j]
    return larger


@kernel("reassoc", "contract")
def dot(a: FloatArray, b: FloatArray) -> float:
    """Return the sum of products of a (N,) and b (N,): in any order, which alone runs in vector registers."""
    total = 0.0
    for k in range(a.shape[0]):
        total += a[k] * b[k]
    return total


@kernel()
def normal_fit(r: FloatArray, gram: FloatArray, support: IntArray, left: int) -> FloatArray:
    """Return the coefficients (s,) of `least_squares`, by Cholesky of the Gram matrix and one refinement on r.

    The corrected normal equations are as accurate as a QR while the support is not too ill-conditioned; a pivot that
    says otherwise hands over to the QR.

    Args:
        r: (m, m) of the factor.
        gram: r' r.
        support: columns that explain.
        left: column that is explained.
    """
    s = support.shape[0]
    a, x = np.empty((s, s)), np.empty(s)
    for i in range(s):
        for j in range(i + 1):
            total = gram[support[i], support[j]] - dot(a[i, :j], a[j, :j])
            if i == j:
                if not total > PIVOT_TOLERANCE:
                    return least_squares(r, support, left)[0]
                a[i, i] = np.sqrt(total)
            else:
                a[i, j] = total / a[j, j]
        x[i] = gram[support[i], left]
    _solve_cholesky(a, x)
    residual = r[:, left].copy()
    for j in range(s):
        for i in range(support[j] + 1):
            residual[i] -= r[i, support[j]] * x[j]
    change = np.empty(s)
    for j in range(s):
        above = support[j] + 1
        change[j] = dot(r[:above, support[j]], residual[:above])
    _solve_cholesky(a, change)
    return x + change


@kernel()
def _solve_cholesky(a: FloatArray, x: FloatArray) -> None:
    s = x.shape[0]
    for i in range(s):
        x[i] = (x[i] - dot(a[i, :i], x[:i])) / a[i, i]
    for i in range(s - 1, -1, -1):
        for k in range(i + 1, s):
            x[i] -= a[k, i] * x[k]
        x[i] /= a[i, i]


@np.errstate(over="ignore", invalid="ignore")  # of columns that nearly depend on each other: refused below
def full_fits(r: FloatArray) -> FloatArray | None:
    """Return the fit of every column of r on all others at once, (m, m): column i holds the coefficients for guess i.

    With P = (R'R)^-1, the coefficients are -P[:, i] / P[i, i]. None where r is singular.
    """
    triangle = np.linalg.qr(r, mode="r")
    inverse, singular = dtrtri(triangle)
    p = inverse @ inverse.T
    # Frobenius norms bound the condition number, and cost a thirtieth of it.
    if singular or not np.linalg.norm(inverse) * np.linalg.norm(triangle) < 1.0 / RANK_TOLERANCE:
        return None
    return np.asarray(-p / np.diag(p))


def threshold_supports(
    r: FloatArray,
    gram: FloatArray,
    columns: IntArray,
    left: int,
    weight: FloatArray,
    relative: bool,
    low: float,
    high: float,
    terms: int | None = None,
    first: FloatArray | None = None,
) -> BoolArray:
    """Return the supports that sequential thresholding ends in, for all thresholds in (low, high] at once, (K, m).

    A term stays while |x_j| weight_j, divided by the largest of the fit and squared if `relative`, is no less than the
    threshold. The outcome is a step function of the threshold. Between two neighbouring sizes the next support is
    known; a support that maps to itself is final there.

    Args:
        r: (m, m) of the factor.
        gram: r' r.
        columns: where to choose from, ascending.
        left: the guess.
        weight: (m,) see above.
        relative: see above.
        low: of the thresholds.
        high: of the thresholds.
        terms: thresholds are walked down from `high`, no further than the first support of more than this many terms.
        first: coefficients (m,) of the fit on all columns, if known.
    """
    first = np.empty(0) if first is None else first
    found: BoolArray = _walk_thresholds(
        np.asfortranarray(r), gram, columns, left, weight, relative, low, high, terms or r.shape[1], first
    )
    return found


@kernel()
def _walk_thresholds(
    r: FloatArray,
    gram: FloatArray,
    columns: IntArray,
    left: int,
    weight: FloatArray,
    relative: bool,
    low: float,
    high: float,
    terms: int,
    first: FloatArray,
) -> BoolArray:
    """Walk a stack of supports with their intervals, highest thresholds first; the intervals are disjoint.

    One function, because a recursion over arrays would allocate them anew at every support. Of two intervals with one
    support, of which every second one is, the second takes the fit of the first.
    """
    m = r.shape[1]
    fitted: BoolArray = np.zeros((64, m), dtype=np.bool_)
    keys: IntArray = np.zeros((64, 1), dtype=np.int64)
    sizes: FloatArray = np.empty((64, m))
    fits = 0
    active: BoolArray = np.zeros((64, m), dtype=np.bool_)
    bounds: FloatArray = np.empty((64, 2))
    final: BoolArray = np.zeros((64, m), dtype=np.bool_)
    count = 0
    for j in columns:
        active[0, j] = j != left
    bounds[0, 0], bounds[0, 1] = low, high
    depth = 1
    while depth > 0:
        depth -= 1
        here, lo, hi = active[depth].copy(), bounds[depth, 0], bounds[depth, 1]
        support = np.flatnonzero(here)
        lower, base = depth, depth  # entries below this one on the stack stand for lower thresholds
        key: int = 0
        for j in support:
            key += int(j + 1) ** 3
        place = 0
        while place < fits and not (keys[place, 0] == key and np.array_equal(fitted[place], here)):
            place += 1
        if place == fits:
            if fits == fitted.shape[0]:
                fitted, keys, sizes = _grown(fitted), _grown(keys), _grown(sizes)
            known = fits == 0 and first.shape[0] > 0
            x = first[support] if known else normal_fit(r, gram, support, left)
            size = np.abs(x) * weight[support]
            if relative:
                largest = size.max()
                size = (size / largest) ** 2 if largest > 0.0 else size
            fitted[fits], keys[fits, 0] = here, key
            sizes[fits, : len(size)] = size
            fits += 1
        size = sizes[place, : support.shape[0]]
        edges = np.sort(np.append(size, hi))
        bottom = lo
        for top in edges:
            if not top > bottom or top > hi:
                continue
            same, kept = True, 0
            for i in range(support.shape[0]):
                if size[i] >= top:
                    kept += 1
                else:
                    same = False
            if same and kept > terms:
                lower = 0
            elif same:
                if count == final.shape[0]:
                    final = _grown(final)
                for j in range(m):
                    final[count, j] = here[j]
                count += 1
            elif kept > 0:
                if depth == active.shape[0]:
                    active, bounds = _grown(active), _grown(bounds)
                active[depth] = False
                for i in range(support.shape[0]):
                    active[depth, support[i]] = size[i] >= top
                bounds[depth, 0], bounds[depth, 1] = bottom, top
                depth += 1
            bottom = top
        if lower < base:
            for k in range(base, depth):
                bounds[k - base, 0], bounds[k - base, 1] = bounds[k, 0], bounds[k, 1]
                for j in range(m):
                    active[k - base, j] = active[k, j]
            depth -= base
    return final[:count]
