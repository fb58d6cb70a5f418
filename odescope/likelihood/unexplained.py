"""What functions leave of a target beside what is there already: linear least squares, at many constants at once."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.parallel.kernels import kernel

SMALLEST = 1e-150  # length of a function that has a direction: squares of shorter ones underflow
NOTHING_LEFT = 1e-10  # share of a function that others do not say


@kernel("reassoc", "contract", inline=True)
def _squares(a: FloatArray) -> float:
    total = 0.0
    for k in range(a.shape[0]):
        total += a[k] * a[k]
    return total


@kernel("reassoc", "contract")
def _take_out(direction: FloatArray, a: FloatArray) -> None:
    along = 0.0
    for k in range(a.shape[0]):
        along += direction[k] * a[k]
    for k in range(a.shape[0]):
        a[k] -= along * direction[k]


@kernel("reassoc", "contract")
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
        left[point] = rest
        told = True
        for k in range(many):
            own[k] = functions[point, k]
            whole = _squares(own[k])
            for row in range(beside.shape[0]):
                _take_out(beside[row], own[k])
            told = told and _squares(own[k]) > NOTHING_LEFT * whole
            for other in range(k):
                _take_out(own[other], own[k])
            own[k] /= max(np.sqrt(_squares(own[k])), SMALLEST)
        if told:
            for k in range(many):
                _take_out(own[k], left[point])
    return left
