"""Fits without one of the mechanisms of another."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.fit import ITERATIONS, Fit
from odescope.likelihood.search_space import SearchSpace


def fit_without(
    space: SearchSpace,
    here: Fit,
    k: int,
    defect_std: FloatArray,
    iterations: int = ITERATIONS,
    limit: float = np.inf,
) -> Fit | None:
    """Return the fit without a mechanism, None where none can be begun.

    It begins with the coefficients of the others as they are; where these held each other up nothing can be followed
    with them, and it begins with those that the fit foresees.

    Args:
        space: data and candidates.
        here: the fit with it.
        k: its number.
        defect_std: (n,) standard deviations of the defects between segments.
        iterations: steps at most.
        limit: a cost above which the fit is of no use.
    """
    left, theta = here.present[here.present != k], here.theta.copy()
    theta[k] = 0.0
    begun = [theta] if k in here.held else [theta, here.foreseen_without(k)]
    how = here.x0, defect_std, here.strength, iterations
    fits = (space.fit(start, left, *how, limit=limit) for start in begun)
    return next((found for found in fits if found is not None), None)
