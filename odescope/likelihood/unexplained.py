"""What functions leave of a target beside what is there already: linear least squares, at many constants at once."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.parallel.kernels import kernel
from odescope.regression.solve import dot

SMALLEST = 1e-150  # length of a function that has a direction: squares of shorter ones underflow
NOTHING_LEFT = 1e-10  # share of a function that others do not say


@kernel("contract")
def _take_out(direction: FloatArray, a: FloatArray) -> None:
    along = dot(direction, a)
    for k in range(a.shape[0]):
        a[k] -= along * direction[k]


@kernel()
def unexplained(rest: FloatArray, beside: FloatArray, functions: FloatArray) -> FloatArray:
    """Return what functions leave (points, N), all of the rest where one of them says nothing of its own.

    Args:
        rest: (N,) what is left of the target beside them.
        beside: (b, N) orthonormal: what is there already.
        functions: (points, f, N) values, at several values of their constants.
    """
    points, many, samples = functions.shape
    left, own = np.empty((points, samples)), np.empty((many, samples))
    for point in range(points):
        for i in range(samples):
            left[point, i] = rest[i]
        told = True
        for k in range(many):
            for i in range(samples):
                own[k, i] = functions[point, k, i]
            whole = dot(own[k], own[k])
            for row in range(beside.shape[0]):
                _take_out(beside[row], own[k])
            told = told and dot(own[k], own[k]) > NOTHING_LEFT * whole
            for other in range(k):
                _take_out(own[other], own[k])
            size = max(np.sqrt(dot(own[k], own[k])), SMALLEST)
            for i in range(samples):
                own[k, i] /= size
        if told:
            for k in range(many):
                _take_out(own[k], left[point])
    return left
