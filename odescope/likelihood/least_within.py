"""Least squares in a few parameters, each within a range."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from odescope.arrays import FloatArray

DIFFERENCE = 1e-8  # of a difference quotient, in ranges of a parameter
DAMPING = 1e-3  # of the first step, relative to the curvature
MOST_DAMPED = 1e8  # a step that is damped so much and still no better is none
CONVERGED = 1e-4  # relative fall of the squares that ends it


def least_within(
    missed: Callable[[FloatArray], FloatArray], begin: FloatArray, limits: FloatArray, steps: int
) -> tuple[FloatArray, float]:
    """Return the parameters (k,) of least squares near where it begins, and the sum of these squares.

    Steps of Levenberg and Marquardt, Marquardt (1963), https://doi.org/10.1137/0111030, that end at the limits; a
    parameter at a limit beyond which it would fall stays there. Slopes are difference quotients, which are evaluated
    together with their point: `missed` is called once a step.

    Args:
        missed: residuals (m, N) at each of m parameters (m, k).
        begin: (k,) parameters.
        limits: (k, 2) the least and the largest of each.
        steps: at most.
    """
    low, high = limits.T
    size = DIFFERENCE * (high - low)

    def around(x: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        moves = np.where(x + size > high, -size, size)
        points = np.repeat(x[None], len(x) + 1, axis=0)
        np.fill_diagonal(points[1:], x + moves)
        found = missed(points)
        return found[0], (found[1:] - found[0]) / moves[:, None], float(found[0] @ found[0])

    x = np.clip(begin, low, high)
    residual, slopes, squares = around(x)
    damping = DAMPING
    for _ in range(steps if len(x) else 0):
        downhill = -slopes @ residual
        free = ~((x <= low) & (downhill < 0.0) | (x >= high) & (downhill > 0.0)) & (np.sum(slopes**2, axis=1) > 0.0)
        if not free.any():
            break
        curvature = slopes[free] @ slopes[free].T
        curvature.flat[:: len(curvature) + 1] *= 1.0 + damping
        step = np.zeros(len(x))
        step[free] = np.linalg.solve(curvature, downhill[free])
        trial = np.clip(x + step, low, high)
        other = around(trial)
        fallen = squares - other[2]
        if fallen > 0.0:
            x, (residual, slopes, squares), damping = trial, other, 0.1 * damping
            if fallen <= CONVERGED * squares:
                break
        elif (damping := 10.0 * damping) > MOST_DAMPED:
            break
    return x, squares
