"""Least squares in functions of a few constants, each within a range: variable projection in one compiled kernel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.tape import LANES, Instructions, run_blocks
from odescope.likelihood.unexplained import unexplained
from odescope.model.linear_solve import solve_in_place
from odescope.parallel.kernels import kernel
from odescope.regression.solve import dot

DIFFERENCE = 1e-8  # of a difference quotient, in ranges of a constant
DAMPING = 1e-3  # of the first step, relative to the curvature
MOST_DAMPED = 1e8  # a step that is damped so much and still no better is none
CONVERGED = 1e-4  # relative fall of the squares that ends it
LARGEST = 1e100  # value of a function that says something: squares of larger ones overflow


class Curves(NamedTuple):
    """Functions of variables and constants at some samples, as compiled kernels take them.

    Shapes: variables (v, N); outputs (f,) slots of the functions; nominal, reach, low, high (k,) of the
    constants, whose coefficients are those of `Constant`, with a reach of 0 where one is varied by factors.
    """

    variables: FloatArray
    instructions: Instructions
    outputs: IntArray
    nominal: FloatArray
    reach: FloatArray
    low: FloatArray
    high: FloatArray


@kernel()
def _values(curves: Curves, at: FloatArray, columns: FloatArray, found: FloatArray) -> None:
    """Write the functions at some coefficients of their constants.

    Args:
        curves: the functions.
        at: (m, k) coefficients.
        columns: (v + k, N) the variables, and room for the constants.
        found: (m, f, N) of the functions; 0 where they say nothing.
    """
    variables, instructions, outputs, nominal, reach, low, high = curves
    samples = columns.shape[1]
    for point in range(len(at)):
        for k in range(len(nominal)):
            coefficient = at[point, k]
            value = nominal[k] + coefficient * reach[k] if reach[k] > 0.0 else nominal[k] * np.exp(coefficient)
            value = min(max(value, low[k]), high[k])
            for i in range(samples):
                columns[len(variables) + k, i] = value
        run_blocks(instructions, outputs, columns, found[point], LANES)
        for j in range(len(outputs)):
            for i in range(samples):
                if not abs(found[point, j, i]) < LARGEST:
                    found[point, j, i] = 0.0


@kernel()
def _around(
    rest: FloatArray, beside: FloatArray, curves: Curves, x: FloatArray, limits: FloatArray, columns: FloatArray
) -> FloatArray:
    """Return the residual at some coefficients, and its slope in each of them (1 + k, N).

    Args:
        rest: (N,) what is left beside what is there already.
        beside: (b, N) orthonormal: what that is.
        curves: the functions.
        x: (k,) coefficients.
        limits: (k, 2) the least and the largest of each.
        columns: (v + k, N) the variables, and room for the constants.
    """
    count = len(x)
    at = np.empty((1 + count, count))
    for point in range(1 + count):
        for k in range(count):
            at[point, k] = x[k]
    for k in range(count):
        size = DIFFERENCE * (limits[k, 1] - limits[k, 0])
        at[1 + k, k] += -size if x[k] + size > limits[k, 1] else size
    found = np.empty((1 + count, len(curves[2]), len(rest)))
    _values(curves, at, columns, found)
    left = unexplained(rest, beside, found)
    for k in range(count):
        move = at[1 + k, k] - x[k]
        for i in range(len(rest)):
            left[1 + k, i] = (left[1 + k, i] - left[0, i]) / move
    return left


@kernel()
def _step(left: FloatArray, x: FloatArray, limits: FloatArray, damping: float) -> tuple[FloatArray, bool]:
    """Return the coefficients after a step of Levenberg and Marquardt, and whether any of them can move.

    Args:
        left: (1 + k, N) residual and slopes.
        x: (k,) coefficients; one at a limit beyond which it would fall stays there.
        limits: (k, 2) the least and the largest of each.
        damping: relative to the curvature.
    """
    count, able = len(x), False
    matrix, step = np.empty((count, count)), np.empty((count, 1))
    for k in range(count):
        downhill = -dot(left[1 + k], left[0])
        at_end = (x[k] <= limits[k, 0] and downhill < 0.0) or (x[k] >= limits[k, 1] and downhill > 0.0)
        step[k, 0] = 0.0 if at_end else downhill
        able = able or step[k, 0] != 0.0
    for k in range(count):
        for j in range(count):
            free = step[k, 0] != 0.0 and step[j, 0] != 0.0
            matrix[k, j] = dot(left[1 + k], left[1 + j]) if free else 0.0
        matrix[k, k] = (1.0 + damping) * matrix[k, k] if step[k, 0] != 0.0 else 1.0
    solve_in_place(matrix, step)
    ahead = np.empty(count)
    for k in range(count):
        ahead[k] = min(max(x[k] + step[k, 0], limits[k, 0]), limits[k, 1])
    return ahead, able


@kernel()
def least_within(
    rest: FloatArray, beside: FloatArray, curves: Curves, begin: FloatArray, limits: FloatArray, steps: int
) -> tuple[FloatArray, float]:
    """Return the coefficients (k,) of least squares near where they begin, and the sum of these squares.

    Steps of Levenberg and Marquardt, Marquardt (1963), https://doi.org/10.1137/0111030, that end at the limits.
    What stands linearly is eliminated at each, Golub and Pereyra (1973), https://doi.org/10.1137/0710036.

    Args:
        rest: (N,) what is left of a target beside what is there already.
        beside: (b, N) orthonormal: what that is.
        curves: functions, of whose constants these are the coefficients.
        begin: (k,) coefficients.
        limits: (k, 2) the least and the largest of each.
        steps: at most.
    """
    variables, count = curves[0], len(begin)
    columns = np.empty((len(variables) + count, len(rest)))
    for row in range(len(variables)):
        for i in range(len(rest)):
            columns[row, i] = variables[row, i]
    x = np.empty(count)
    for k in range(count):
        x[k] = min(max(begin[k], limits[k, 0]), limits[k, 1])
    left = _around(rest, beside, curves, x, limits, columns)
    squares, damping = dot(left[0], left[0]), DAMPING
    for _ in range(steps):
        ahead, able = _step(left, x, limits, damping)
        if not able:
            break
        other = _around(rest, beside, curves, ahead, limits, columns)
        fallen = squares - dot(other[0], other[0])
        if fallen > 0.0:
            x, left, damping = ahead, other, 0.1 * damping
            squares -= fallen
            if fallen <= CONVERGED * (squares + fallen):
                break
        else:
            damping *= 10.0
            if damping > MOST_DAMPED:
                break
    return x, squares
