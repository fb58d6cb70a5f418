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
    moves = np.vstack([np.zeros(len(begin)), np.diag(DIFFERENCE * (high - low))])

    def around(x: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        signs = np.where(x + moves.sum(axis=0) > high, -1.0, 1.0)
        found = missed(x + signs * moves)
        slopes = (found[1:] - found[0]) / (signs * np.diag(moves[1:]))[:, None]
        return found[0], slopes, float(found[0] @ found[0])

    x = np.clip(begin, low, high)
    residual, slopes, squares = around(x)
    damping = DAMPING
    for _ in range(steps if len(x) else 0):
        downhill = -slopes @ residual
        free = ~((x <= low) & (downhill < 0.0) | (x >= high) & (downhill > 0.0)) & (np.sum(slopes**2, axis=1) > 0.0)
        if not free.any():
            break
        curvature = slopes[free] @ slopes[free].T
        step = np.zeros(len(x))
        step[free] = np.linalg.lstsq(curvature + damping * np.diag(np.diag(curvature)), downhill[free])[0]
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
