"""The initial states of the segments: eliminated, solved for, and their covariances.

They form a block-tridiagonal system with the parameters as border: all three are linear in the number of segments.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.likelihood.kernel import Sums
from odescope.parallel.kernels import kernel


class Eliminated(NamedTuple):
    """What elimination leaves.

    Shapes: cost of the defects; information (p, p) about the parameters and gradient (p,); factor, carry (J, n, n) and
    border (J, n, p + 1) for back-substitution; log_det of the states' block; whether that is positive definite.
    """

    cost: float
    information: FloatArray
    gradient: FloatArray
    factor: FloatArray
    border: FloatArray
    carry: FloatArray
    log_det: float
    positive: bool


def eliminate(
    sums: Sums,
    x0: FloatArray,
    joined: BoolArray,
    defect_std: FloatArray,
    damping: float,
    columns: int | None = None,
) -> Eliminated:
    """Eliminate the initial states: block-tridiagonal Cholesky with the parameters as border.

    Args:
        sums: of the kernel.
        x0: (J, n) initial states.
        joined: (J,) whether the end of a segment is tied to the start of the next.
        defect_std: (n,) the defect between them is weighted by 1 / defect_std^2 a state.
        damping: added to 1 it multiplies the diagonal (Levenberg-Marquardt).
        columns: of the information: the first so many, and its diagonal; what is not asked for is zero.
    """
    p = sums.gradient.shape[1] - x0.shape[1]
    weight = np.where(np.isfinite(defect_std), 1.0 / defect_std**2, 0.0)
    found = Eliminated(*_eliminate(sums, x0, joined, weight, damping, p if columns is None else columns))
    half = found.information
    return found._replace(information=half + np.tril(half, -1).T)


@kernel("contract")
def _eliminate(sums, x0, joined, weight, damping, columns):
    """Return what `eliminate` does, of the information the lower half: each block is used while it is in cache.

    Args:
        sums: of the kernel.
        x0: (J, n) initial states.
        joined: (J,) as for `eliminate`.
        weight: (n,) of the squares of defects.
        damping: as for `eliminate`.
        columns: number of them.
    """
    segments, n = x0.shape
    width = sums.gradient.shape[1]
    p = width - n
    last, jacobian, hessian, gradient = sums.last, sums.jacobian, sums.hessian, sums.gradient
    factor = np.zeros((segments, n, n))
    carry = np.zeros((segments, n, n))
    border = np.empty((segments, n, p + 1))
    reduced, reduced_g, raised = np.zeros((p, p)), np.zeros(p), np.zeros(p)
    block = np.empty((n, n))
    cost, log_det = 0.0, 0.0
    for j in range(segments):
        before, after = j > 0 and joined[j - 1], j + 1 < segments and joined[j]
        edge = border[j]
        for i in range(n):
            for k in range(n):
                block[i, k] = hessian[j, i, k]
            for c in range(p):
                edge[i, c] = hessian[j, i, n + c]
            edge[i, p] = gradient[j, i]
        if before:
            for i in range(n):
                w, ends = weight[i], jacobian[j - 1, i]
                block[i, i] += w
                for c in range(p):
                    edge[i, c] -= w * ends[n + c]
                edge[i, p] -= w * (last[j - 1, i] - x0[j, i])
        if after:
            for r in range(n):
                w, ends = weight[r], jacobian[j, r]
                d = last[j, r] - x0[j + 1, r]
                cost += w * d * d
                for i in range(n):
                    f = w * ends[i]
                    for k in range(n):
                        block[i, k] += f * ends[k]
                    for c in range(p):
                        edge[i, c] += f * ends[n + c]
                    edge[i, p] += f * d
        for i in range(n):
            block[i, i] *= 1.0 + damping
        if before:
            for i in range(n):
                for m in range(n):
                    cm, passed = carry[j - 1, i, m], border[j - 1, m]
                    for k in range(n):
                        block[i, k] -= cm * carry[j - 1, k, m]
                    for c in range(p + 1):
                        edge[i, c] -= cm * passed[c]
        for i in range(n):
            for k in range(i + 1):
                total = block[i, k]
                for m in range(k):
                    total -= factor[j, i, m] * factor[j, k, m]
                if i == k:
                    if not total > 0.0:
                        return cost, reduced, reduced_g, factor, border, carry, 0.0, False
                    factor[j, i, i] = np.sqrt(total)
                    log_det += 2.0 * np.log(factor[j, i, i])
                else:
                    factor[j, i, k] = total / factor[j, k, k]
        for i in range(n):
            for m in range(i):
                f, above = factor[j, i, m], edge[m]
                for c in range(p + 1):
                    edge[i, c] -= f * above[c]
            over = 1.0 / factor[j, i, i]
            for c in range(p + 1):
                edge[i, c] *= over
        if after:
            for r in range(n):
                w = weight[r]
                for i in range(n):
                    total = -w * jacobian[j, r, i]
                    for m in range(i):
                        total -= factor[j, i, m] * carry[j, r, m]
                    carry[j, r, i] = total / factor[j, i, i]
        for c in range(p):
            raised[c] += hessian[j, n + c, n + c]
            reduced_g[c] += gradient[j, n + c]
            row, own = reduced[c], hessian[j, n + c]
            for b in range(min(c, columns)):
                row[b] += own[n + b]
            for i in range(n):
                above = edge[i]
                f = above[c]
                row[c] -= f * f
                reduced_g[c] -= f * above[p]
                for b in range(min(c, columns)):
                    row[b] -= f * above[b]
            if after:
                for r in range(n):
                    ends = jacobian[j, r]
                    f = weight[r] * ends[n + c]
                    raised[c] += f * ends[n + c]
                    reduced_g[c] += f * (last[j, r] - x0[j + 1, r])
                    for b in range(min(c, columns)):
                        row[b] += f * ends[n + b]
    for c in range(p):
        reduced[c, c] += (1.0 + damping) * raised[c]
    return cost, reduced, reduced_g, factor, border, carry, log_det, True


@kernel()
def substitute(factor, border, carry, joined, change):
    """Return the change (J, n) of the initial states that goes with a change of the parameters.

    Args:
        factor: (J, n, n) of `eliminate`.
        border: (J, n, p + 1) of `eliminate`.
        carry: (J, n, n) of `eliminate`.
        joined: (J,) as for `eliminate`.
        change: (p,) of the parameters.
    """
    segments, n = factor.shape[0], factor.shape[1]
    p = change.shape[0]
    result = np.zeros((segments, n))
    for j in range(segments - 1, -1, -1):
        z = np.empty(n)
        for i in range(n):
            z[i] = -border[j, i, p]
            for c in range(p):
                z[i] -= border[j, i, c] * change[c]
            if j + 1 < segments and joined[j]:
                for r in range(n):
                    z[i] -= carry[j, r, i] * result[j + 1, r]
        for i in range(n - 1, -1, -1):
            total = z[i]
            for m in range(i + 1, n):
                total -= factor[j, m, i] * result[j, m]
            result[j, i] = total / factor[j, i, i]
    return result


@kernel()
def state_covariances(factor, carry, joined):
    """Return posterior covariances of the initial states: own (J, n, n), with the next segment's (J, n, n).

    The states' block is L L^T with `factor` on the diagonal of L and `carry` below it; only the blocks of the inverse
    that the pattern of L has are computed, last to first. next[j] is the covariance of x0[j + 1] (rows) with x0[j].

    Args:
        factor: (J, n, n) of `eliminate`.
        carry: (J, n, n) of `eliminate`.
        joined: (J,) as for `eliminate`.
    """
    segments, n = factor.shape[0], factor.shape[1]
    own, following = np.zeros((segments, n, n)), np.zeros((segments, n, n))
    inverse, passed = np.zeros((n, n)), np.zeros((n, n))  # of factor[j], lower triangular; own[j + 1] times carry[j]
    middle = np.zeros((n, n))
    for j in range(segments - 1, -1, -1):
        for c in range(n):
            for i in range(c, n):
                total = 1.0 if i == c else 0.0
                for m in range(c, i):
                    total -= factor[j, i, m] * inverse[m, c]
                inverse[i, c] = total / factor[j, i, i]
        for i in range(n):
            for k in range(n):
                middle[i, k] = 1.0 if i == k else 0.0
        if j + 1 < segments and joined[j]:
            _product(own[j + 1], carry[j], passed)
            _product(passed, inverse, following[j])
            following[j] *= -1.0
            _product(carry[j].T, passed, middle)
            for i in range(n):
                middle[i, i] += 1.0
        _product(middle, inverse, passed)
        _product(inverse.T, passed, own[j])
    return own, following


@kernel(inline=True)
def _product(left, right, result):
    for i in range(left.shape[0]):
        for k in range(right.shape[1]):
            total = 0.0
            for m in range(left.shape[1]):
                total += left[i, m] * right[m, k]
            result[i, k] = total
