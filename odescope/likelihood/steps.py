"""The length of the steps of RK4, and the width of dry friction: halved until that no longer matters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.narrowing import narrowed
from odescope.likelihood.search import Outcome, fitted_again, settle_again
from odescope.likelihood.search_space import SearchSpace

FINEST = 8  # steps of RK4 a block average, at most, while a search is on
HALVINGS = 4  # of the width of dry friction at the end, at most
STEP_ERROR = 1.0  # change of the cost, in units of chi-squared, that does not ask for shorter steps
STEP_SHARE = 0.01  # of the cost, and
STEP_MOVE = 0.5  # standard errors of any coefficient: changes of a refit that do not ask for shorter steps still


def with_fine_steps(space: SearchSpace, starts: Sequence[FloatArray]) -> SearchSpace:
    """Halve the steps of RK4 until that no longer matters to the first start that can be followed in loose segments."""
    loose = np.full_like(space.segments.spread, np.inf)
    for theta in starts:
        found = space.begin(theta, loose)
        if found is not None:
            return halve_steps(space, found, loose)[0]
    return space


def with_finer_steps(space: SearchSpace, outcome: Outcome) -> tuple[SearchSpace, Outcome]:
    """Halve the steps until that no longer matters at the end of a search; what coarse steps asked for may go then.

    What the budget ended is finished then, too.
    """
    finer, found = halve_steps(space, outcome.fit, space.segments.spread * outcome.width)
    if finer.evaluator.substeps == space.evaluator.substeps and (outcome.finished or space.budget.over):
        return finer, fitted_again(finer, outcome, found)
    return finer, settle_again(finer, outcome, found)


def with_narrow_friction(space: SearchSpace, outcome: Outcome) -> tuple[SearchSpace, Outcome]:
    """Return space and outcome with dry friction of the width at which the record is followed best, halved at a time.

    Terms whose case is thin then are tested again.
    """
    if not space.fixed_constants(outcome.fit):
        return space, outcome
    defect_std = space.segments.spread * outcome.width
    narrow, found = narrowed(space, outcome.fit, defect_std, HALVINGS)
    end = fitted_again(narrow, outcome, found)
    return narrow, end if end.clear else settle_again(narrow, end, found)


def halve_steps(space: SearchSpace, found: Fit, defect_std: FloatArray) -> tuple[SearchSpace, Fit]:
    """Return space and fit with steps so short that halving them moves no coefficient by its standard error.

    Where the cost itself hardly changes nothing is refitted. It always does where a term jumps, such as abs(v).

    Args:
        space: data, candidates and steps.
        found: a fit in it.
        defect_std: (n,) that it was fitted with.
    """
    while space.evaluator.substeps < FINEST:
        finer = space.finer(2 * space.evaluator.substeps)
        again = finer.again(found, found.x0, defect_std, iterations=0)
        if again is not None and abs(again.cost - found.cost) < STEP_ERROR:
            break
        refitted = finer.again(found, found.x0, defect_std)
        if refitted is None:
            break
        moved = (refitted.theta - found.theta)[refitted.free] ** 2
        variances = refitted.variances * max(refitted.data_cost / space.segments.samples, 1.0)
        same = abs(refitted.cost - found.cost) < STEP_SHARE * found.cost
        space, found = finer, refitted
        if same and bool(np.all(moved < STEP_MOVE**2 * variances)):
            break
    return space, found
