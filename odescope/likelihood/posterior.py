"""Covariances of the states at the joints, from the factor that eliminates them (METHOD section 9)."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True, error_model="numpy")
def joint_covariances(factor, carry, joined):
    """Return posterior covariances of the initial states: own (J, n, n), with the next segment's (J, n, n).

    The states' block is L L^T with `factor` on the diagonal of L and `carry` below it; only the blocks of the inverse
    that the pattern of L has are computed, last to first. next[j] is the covariance of x0[j + 1] (rows) with x0[j].
    """
    segments, n = factor.shape[0], factor.shape[1]
    own, following = np.zeros((segments, n, n)), np.zeros((segments, n, n))
    for j in range(segments - 1, -1, -1):
        inverse = np.zeros((n, n))  # of factor[j], lower triangular
        for c in range(n):
            for i in range(c, n):
                total = 1.0 if i == c else 0.0
                for m in range(c, i):
                    total -= factor[j, i, m] * inverse[m, c]
                inverse[i, c] = total / factor[j, i, i]
        middle = np.eye(n)
        if j + 1 < segments and joined[j]:
            passed = own[j + 1] @ carry[j]
            following[j] = -passed @ inverse
            middle += carry[j].T @ passed
        own[j] = inverse.T @ middle @ inverse
    return own, following
