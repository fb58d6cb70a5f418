"""The initial states of the segments: eliminated, solved for, their covariances, and what these say of the noise.

They form a block-tridiagonal system with the parameters as border: all four are linear in the number of segments.
"""

from __future__ import annotations

import numpy as np

from odescope.parallel.kernels import kernel


@kernel("contract")
def factorise(sums, joined, defect_std, damping, cross, along, defect):
    """Return log-determinant, factor, border and carry of an `Expansion`, and whether there are any.

    There are none where the states' block is not positive definite. One function, because forward elimination uses
    each block while it is in cache.

    Args:
        sums: of the kernel; what stands there of parameters is not looked at.
        joined: (J,) whether the end of a segment is tied to the start of the next.
        defect_std: (n,) standard deviations of the defects between them.
        damping: added to 1 it multiplies the diagonal of the states' block.
        cross: (J, n, p) second derivatives with respect to states and parameters.
        along: (J, n, p) derivatives of the ends of segments with respect to parameters, in standard deviations.
        defect: (J, n) the defects, in standard deviations.
    """
    segments, n, p = cross.shape
    factor, border = np.empty((segments, n, n)), np.empty((segments, n, p + 1))
    carry = np.zeros((segments, n, n))  # couples segment j + 1 (rows) to j (columns)
    _assemble(sums, joined, defect_std, cross, along, defect, factor, border, carry)
    log_det = 0.0
    # Forward: factor each block, solve for its border and right-hand side, pass the rest on.
    for j in range(segments):
        block, edge = factor[j], border[j]
        for i in range(n):
            block[i, i] *= 1.0 + damping
        if j > 0 and joined[j - 1]:
            for i in range(n):
                for m in range(n):
                    cm = carry[j - 1, i, m]
                    for k in range(n):
                        block[i, k] -= cm * carry[j - 1, k, m]
                    for k in range(p + 1):
                        edge[i, k] -= cm * border[j - 1, m, k]
        for i in range(n):
            for k in range(i + 1):
                total = block[i, k]
                for m in range(k):
                    total -= block[i, m] * block[k, m]
                if i > k:
                    block[i, k] = total / block[k, k]
                elif not total > 0.0:
                    return 0.0, factor, border, carry, False
                else:
                    block[i, i] = np.sqrt(total)
                    log_det += 2.0 * np.log(block[i, i])
            block[i, i + 1 :] = 0.0
            for m in range(i):
                for k in range(p + 1):
                    edge[i, k] -= block[i, m] * edge[m, k]
            for k in range(p + 1):
                edge[i, k] /= block[i, i]
        if j + 1 < segments and joined[j]:
            for r in range(n):
                for i in range(n):
                    for m in range(i):
                        carry[j, r, i] -= block[i, m] * carry[j, r, m]
                    carry[j, r, i] /= block[i, i]
    return log_det, factor, border, carry, True


@kernel("contract")
def _assemble(sums, joined, defect_std, cross, along, defect, factor, border, carry):
    """Write the blocks of the system of the states."""
    segments, n, p = cross.shape
    for j in range(segments):
        for i in range(n):
            for k in range(n):
                factor[j, i, k] = sums.hessian[j, i, k]
            for c in range(p):
                border[j, i, c] = cross[j, i, c]
            border[j, i, p] = sums.gradient[j, i]
    for j in range(segments - 1):
        if not joined[j]:
            continue
        for r in range(n):
            inverse, d = 1.0 / defect_std[r], defect[j, r]
            for i in range(n):
                row = inverse * sums.jacobian[j, r, i]
                for k in range(n):
                    factor[j, i, k] += row * inverse * sums.jacobian[j, r, k]
                for c in range(p):
                    border[j, i, c] += row * along[j, r, c]
                border[j, i, p] += row * d
                carry[j, r, i] = -row * inverse
            factor[j + 1, r, r] += inverse * inverse
            for c in range(p):
                border[j + 1, r, c] -= inverse * along[j, r, c]
            border[j + 1, r, p] -= inverse * d


@kernel()
def substitute(factor, border, carry, joined, change):
    """Return the change (J, n) of the initial states that goes with a change of the parameters.

    Args:
        factor: (J, n, n) of `factorise`.
        border: (J, n, p + 1) of `factorise`.
        carry: (J, n, n) of `factorise`.
        joined: (J,) as for `factorise`.
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
def responses(factor, border, carry, joined):
    """Return how the most likely initial states follow the parameters, (J, n, p).

    Args:
        factor: (J, n, n) of `factorise`.
        border: (J, n, p + 1) of `factorise`.
        carry: (J, n, n) of `factorise`.
        joined: (J,) as for `factorise`.
    """
    segments, n, p = border.shape[0], border.shape[1], border.shape[2] - 1
    result = np.empty((segments, n, p))
    for j in range(segments - 1, -1, -1):
        for i in range(n - 1, -1, -1):
            for c in range(p):
                total = -border[j, i, c]
                if j + 1 < segments and joined[j]:
                    for r in range(n):
                        total -= carry[j, r, i] * result[j + 1, r, c]
                for m in range(i + 1, n):
                    total -= factor[j, m, i] * result[j, m, c]
                result[j, i, c] = total / factor[j, i, i]
    return result


@kernel()
def state_covariances(factor, carry, joined):
    """Return posterior covariances of the initial states: own (J, n, n), with the next segment's (J, n, n).

    The states' block is L L^T with `factor` on the diagonal of L and `carry` below it; only the blocks of the inverse
    that the pattern of L has are computed, last to first. next[j] is the covariance of x0[j + 1] (rows) with x0[j].

    Args:
        factor: (J, n, n) of `factorise`.
        carry: (J, n, n) of `factorise`.
        joined: (J,) as for `factorise`.
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


@kernel("contract")
def noise_sums(precision, cost, gradient, hessian, jacobian, defect, joined, change, factor, carry, own, following):
    """Return what every noise weighs: sums of squares (k,), of variances (k,), and what states can make good (k, k).

    One function, because each block is used while it is in cache. All are in units of the noise, at the most likely
    states; the last multiplies what each noise leaves of the gradient through the inverse of the states' block.

    Args:
        precision: (k,) 1 / variance of the averages of c channels, then of the defects of n states.
        cost: (c,) of averages of unit noise.
        gradient: (c, J, n) of these.
        hessian: (c, J, n, n) of these.
        jacobian: (J, n, n) of the ends of segments.
        defect: (J, n) between an end and the next begin.
        joined: (J,) whether that counts.
        change: (J, n) to the most likely states.
        factor: (J, n, n) of `factorise`.
        carry: (J, n, n) of `factorise`.
        own: (J, n, n) of `state_covariances`.
        following: (J, n, n) of `state_covariances`.
    """
    channels, segments, n = gradient.shape
    noises = channels + n
    squares, known, through = np.zeros(noises), np.zeros(noises), np.zeros((noises, noises))
    pull, before, left = np.zeros((n, noises)), np.zeros((n, noises)), np.zeros(n)
    for c in range(channels):
        squares[c] = precision[c] * cost[c]
    for j in range(segments):
        pull[:] = 0.0
        if j > 0 and joined[j - 1]:
            for i in range(n):
                pull[i, channels + i] = -precision[channels + i] * left[i]
        for c in range(channels):
            for i in range(n):
                bent = 0.0
                for k in range(n):
                    bent += hessian[c, j, i, k] * change[j, k]
                    known[c] += precision[c] * hessian[c, j, i, k] * own[j, k, i]
                squares[c] += precision[c] * (2.0 * gradient[c, j, i] + bent) * change[j, i]
                pull[i, c] = precision[c] * (gradient[c, j, i] + bent)
        if joined[j]:
            for i in range(n):
                w = precision[channels + i]
                left[i] = defect[j, i] - change[j + 1, i]
                spread = own[j + 1, i, i]
                for k in range(n):
                    left[i] += jacobian[j, i, k] * change[j, k]
                    spread -= 2.0 * jacobian[j, i, k] * following[j, i, k]
                    for m in range(n):
                        spread += jacobian[j, i, k] * own[j, k, m] * jacobian[j, i, m]
                squares[channels + i] += w * left[i] * left[i]
                known[channels + i] += w * spread
                for k in range(n):
                    pull[k, channels + i] += w * left[i] * jacobian[j, i, k]
        if j > 0 and joined[j - 1]:
            for i in range(n):
                for m in range(n):
                    for c in range(noises):
                        pull[i, c] -= carry[j - 1, i, m] * before[m, c]
        for i in range(n):
            for m in range(i):
                for c in range(noises):
                    pull[i, c] -= factor[j, i, m] * pull[m, c]
            for c in range(noises):
                pull[i, c] /= factor[j, i, i]
        for i in range(n):
            for c in range(noises):
                before[i, c] = pull[i, c]
                for b in range(noises):
                    through[c, b] += pull[i, c] * pull[i, b]
    return squares, known, through


@kernel(inline=True)
def _product(left, right, result):
    for i in range(left.shape[0]):
        for k in range(right.shape[1]):
            total = 0.0
            for m in range(left.shape[1]):
                total += left[i, m] * right[m, k]
            result[i, k] = total
