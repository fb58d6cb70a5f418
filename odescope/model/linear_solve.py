"""The small dense systems of a model's relations, solved inside compiled kernels."""

from __future__ import annotations

from odescope.arrays import FloatArray
from odescope.parallel.kernels import kernel


@kernel()
def solve_in_place(a: FloatArray, b: FloatArray) -> None:
    """Solve a x = b by elimination with partial pivoting; a (n, n) is overwritten, b (n, m) becomes x.

    A singular matrix gives values that are not finite. For n of a few, where a call of LAPACK costs more than the work.
    """
    n, columns = b.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(a[i, k]) > abs(a[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(n):
                a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
            for c in range(columns):
                b[k, c], b[pivot, c] = b[pivot, c], b[k, c]
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            for j in range(k, n):
                a[i, j] -= factor * a[k, j]
            for c in range(columns):
                b[i, c] -= factor * b[k, c]
    for k in range(n - 1, -1, -1):
        for c in range(columns):
            for j in range(k + 1, n):
                b[k, c] -= a[k, j] * b[j, c]
            b[k, c] /= a[k, k]
