"""Terms that the record hardly tells from others that could stand in their place.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

import numpy as np

from odescope.likelihood.evidence import project
from odescope.likelihood.exchange import rise
from odescope.likelihood.refine import Refinement

TEN_TO_ONE = 2.0 * float(np.log(10.0))  # of cost and price: less decides between no two terms


def look_alikes(refinement: Refinement) -> list[tuple[int, int]]:
    """Return the present mechanisms that an absent one could replace almost as well, and the best such, by number.

    To second order about the model, all others fitted again. Constants, delays and offsets stand in no place; a model
    with noise of the process is not asked.

    Args:
        refinement: the end of a likelihood stage.
    """
    space, fit = refinement.space, refinement.fit
    if not refinement.exact:
        return []
    free, defect_std = space.free(fit), space.segments.spread * refinement.outcome.width
    expansion = space.evaluator.expand(space.whole, fit.theta, free, fit.x0, defect_std)
    if expansion is None or not expansion.finite:
        return []
    present = np.isin(free, fit.free)
    rest = project(expansion.information, expansion.gradient[None], present)
    now, new = free[present], free[~present]
    change = np.einsum("kii->ki", rise(rest, fit.theta[now] * rest.scale[present])) / refinement.scale
    earned = space.penalty[now] + space.bound_to(fit) - space.penalty[new][:, None] - change
    able = np.array([bool(m.parts) and m.names.isdisjoint(space.needed) for m in space.mechanisms])
    earned[~able[new]] = -np.inf
    earned[:, ~able[now]] = -np.inf
    if not len(new):
        return []
    best = earned.argmax(axis=0)
    told = [(j, k) for j, k in enumerate(best.tolist()) if earned[k, j] > -TEN_TO_ONE]
    return [(int(now[j]), int(new[k])) for j, k in told]
