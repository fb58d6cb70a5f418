"""Coefficients that are most likely whatever the states were: the fit of the marginal likelihood.

Where gaps between segments stay open, coefficients and states that fit together best are not the most likely
coefficients: how well these leave the states known changes with them. docs/method.md, Process noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.block_cholesky import responses
from odescope.likelihood.evaluator import Expansion
from odescope.likelihood.fit import Fit, fit
from odescope.likelihood.program import Program
from odescope.likelihood.search_space import SearchSpace

STEPS = 6  # of the coefficients
WORTH = 0.02  # fall of the marginal cost, in units of chi-squared, that is worth another step
FITS = 4  # Levenberg-Marquardt steps of the states after each
DIFFERENCE = 0.01  # standard errors: of the difference quotients

NONE = np.zeros(0, dtype=np.int64)


def determinant_slopes(
    space: SearchSpace, program: Program, theta: FloatArray, free: IntArray, x0: FloatArray, here: Expansion
) -> FloatArray:
    """Return how half the log determinant of the states' block changes with coefficients (p,), states along.

    Args:
        space: data, with their noises.
        program: the mechanisms of a model.
        theta: (mechanisms,) of the model.
        free: (p,) which are parameters.
        x0: (J, n) initial states.
        here: the expansion there.
    """
    evaluator, spread = space.evaluator, space.segments.spread
    follow = responses(here.factor, here.border, here.carry, space.segments.joined)
    slopes = np.zeros(len(free))
    for p, k in enumerate(free.tolist()):
        step = DIFFERENCE / np.sqrt(max(float(here.information[p, p]), 1e-300))
        moved = theta.copy()
        moved[k] += step
        there = evaluator.expand(program, moved, NONE, x0 + step * follow[:, :, p], spread)
        if there is not None and np.isfinite(there.log_det):
            slopes[p] = 0.5 * (there.log_det - here.log_det) / step
    return slopes


def marginal_fit(space: SearchSpace, found: Fit) -> Fit:
    """Return a fit with the coefficients of the least marginal cost, at the noises that the segments have.

    Args:
        space: data, with their noises, and candidates.
        found: the fit of coefficients and states together; it is returned where no step from it is better.
    """
    program, spread = space.program(found.present), space.segments.spread
    free, every = np.searchsorted(found.present, found.free), np.arange(len(found.present))
    least, largest = (limit[free] for limit in program.limits)

    def expanded(theta: FloatArray, x0: FloatArray) -> Expansion | None:
        at = space.evaluator.expand(program, theta, free, x0, spread)
        return at if at is not None and at.finite else None

    theta, x0 = found.theta[found.present], found.x0
    here = expanded(theta, x0)
    if here is None or not len(free):
        return found
    for _ in range(STEPS):
        slopes = determinant_slopes(space, program, theta, free, x0, here)
        pulled = replace(here, gradient=here.gradient + slopes)
        change = space.evaluator.change(pulled, spread, least - theta[free], largest - theta[free])
        if change is None:
            break
        moved = theta.copy()
        moved[free] += change[0]
        settled = fit(space.evaluator, program, moved, every, x0 + change[1], spread, FITS)
        there = None if settled is None else expanded(moved, settled.x0)
        if settled is None or there is None:
            break
        fall = here.cost + here.log_det - there.cost - there.log_det
        if not fall > 0.0:
            break
        theta, x0, here = moved, settled.x0, there
        if fall < WORTH:
            break
    whole = np.zeros(len(found.theta))
    whole[found.present] = theta
    return replace(found, theta=whole, x0=x0, cost=here.cost, data_cost=here.data_cost, information=here.information)
