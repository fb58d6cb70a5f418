"""Dry friction that is made narrower as long as that pays. docs/method.md, Parameters beside coefficients."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.search_space import SearchSpace

GAIN = 1.0  # fall of the cost, in units of chi-squared, at which half the width is taken


def narrowed(space: SearchSpace, found: Fit, defect_std: FloatArray, halvings: int = 1) -> tuple[SearchSpace, Fit]:
    """Return space and fit with dry friction of the widths at which the record is followed best, halved one at a time.

    A joint that sticks creeps under tanh(v/w), the more the wider w is, and a record of little noise shows that; under
    one as narrow as a jump a fit from afar ends in one of many minima. So fits begin wide.

    Args:
        space: data, candidates and constants.
        found: a fit in it.
        defect_std: (n,) that it was fitted with.
        halvings: of every width, at most.
    """
    for name in space.fixed_constants(found):
        for _ in range(halvings):
            narrower = space.with_constants({name: space.frame.constants[name].halved})
            if space.budget.late or narrower.too_narrow(found):
                break
            half = narrower.again(found, found.x0, defect_std)
            if half is not None and half.cost < found.cost - GAIN:
                space, found = narrower, half
                continue
            between = _between(narrower, name, space.frame.constants[name].nominal, found, defect_std)
            # What half the width costs is what the record says of it: the widths so far are its choice, too.
            jump = found if half is None else half
            if between is not None and between.cost + space.price(between) < jump.cost + space.price(jump):
                space, found = narrower, between
            break
    return space, found


def _between(narrower: SearchSpace, name: str, width: float, found: Fit, defect_std: FloatArray) -> Fit | None:
    """Return the fit with a width of its own, begun where it was before it was halved.

    Args:
        narrower: the space with half the width.
        name: of the width.
        width: that it was.
        found: the fit before.
        defect_std: (n,) that it was fitted with.
    """
    (k,) = (k for k, m in enumerate(narrower.mechanisms) if m.kind == "constant" and m.place == name)
    theta = found.theta.copy()
    theta[k] = narrower.frame.constants[name].coefficient(width)
    return narrower.fit(theta, np.union1d(found.present, [k]), found.x0, defect_std, found.strength)
