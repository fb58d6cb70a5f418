"""Terms that the record hardly tells from others that could stand in their place.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.add_and_drop import Moves
from odescope.likelihood.evidence import project
from odescope.likelihood.exchange import rise
from odescope.likelihood.expansion import Expansion
from odescope.likelihood.fit import Fit
from odescope.likelihood.search import TRIALS, Outcome, WhiteResiduals, fitted_again
from odescope.likelihood.search_space import SearchSpace

TEN_TO_ONE = 2.0 * float(np.log(10.0))  # of cost and price: less decides between no two terms


def look_alikes(space: SearchSpace, outcome: Outcome) -> list[tuple[int, int]]:
    """Return the present mechanisms that an absent one could replace almost as well, and the best such, by number.

    To second order about the model, all others fitted again. Constants, delays and offsets stand in no place, and what
    is of a higher degree in none of a simpler term.

    Args:
        space: the candidates.
        outcome: the end of a search that follows the record without noise of the process.
    """
    judge = WhiteResiduals(space, space.segments.spread * outcome.width)
    now, new, earned = _exchanged(space, outcome.fit, judge.expansion(outcome.fit), outcome.scale)
    if not earned.size:
        return []
    dearer = [[_simpler(space, int(k), int(j)) for j in new] for k in now]
    earned[np.array(dearer)] = -np.inf
    told = ((i, j) for i, j in enumerate(earned.argmax(axis=1).tolist()) if earned[i, j] > -TEN_TO_ONE)
    return [(int(now[i]), int(new[j])) for i, j in told]


def with_simpler_terms(space: SearchSpace, outcome: Outcome) -> Outcome:
    """Return the end of a search with simpler terms in the place of look-alikes of a higher degree.

    What the record does not decide the degree does: the product of an input with one that hardly changes is the input.
    A few that are foreseen in vain end it.

    Args:
        space: the candidates.
        outcome: the end of a search that follows the record without noise of the process.
    """
    here, trail = outcome.fit, list(outcome.trail)
    judge = WhiteResiduals(space, space.segments.spread * outcome.width)
    moves, refused = Moves(space, judge, outcome.width, max(outcome.scale, 1.0), trail), set[tuple[int, int]]()
    while len(refused) < TRIALS and not space.budget.late:
        expansion = judge.expansion(here)
        now, new, earned = _exchanged(space, here, expansion, outcome.scale)
        near = ((earned[i, j], int(now[i]), int(new[j])) for i, j in np.argwhere(earned > -TEN_TO_ONE))
        simpler = [n for n in near if n[1:] not in refused and _simpler(space, n[2], n[1])]
        if expansion is None or not simpler:
            break
        gain, gone, came = max(simpler)
        trial = moves.exchanged(here, expansion, np.array([gone]), came)
        if trial is not None and moves.penalised(trial) < moves.penalised(outcome.fit) + TEN_TO_ONE:
            trail += [space.move(outcome.width, *moved, -gain, trial) for moved in (("drop", gone), ("add", came))]
            here = trial
        else:
            refused.add((gone, came))
    return outcome if here is outcome.fit else fitted_again(space, replace(outcome, trail=tuple(trail)), here)


def _simpler(space: SearchSpace, one: int, other: int) -> bool:
    """Say whether a candidate is of lower degree than another, in the same relation and beside no target."""
    both = space.mechanisms[one].parts, space.mechanisms[other].parts
    if any(len(parts) != 1 or parts[0].product.factor is not None for parts in both):
        return False
    (simple,), (part,) = both
    return simple.relation == part.relation and simple.product.degree < part.product.degree


def _exchanged(
    space: SearchSpace, fit: Fit, expansion: Expansion | None, scale: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the numbers of what is present (p,) and absent (a,), and by how much cost and price fall exchanged (p, a).

    Args:
        space: the candidates.
        fit: a model.
        expansion: of its cost with all candidates.
        scale: its residual variance over the noise variance.
    """
    none = np.zeros(0, dtype=np.int64)
    if expansion is None or not expansion.finite:
        return none, none, np.zeros((0, 0))
    free = space.free(fit)
    present = np.isin(free, fit.free)
    rest = project(expansion.information, expansion.gradient[None], present)
    now, new = free[present], free[~present]
    change = np.einsum("kii->ki", rise(rest, fit.theta[now] * rest.scale[present])) / scale
    earned = space.penalty[now] + space.bound_to(fit) - space.penalty[new][:, None] - change
    able = np.array([bool(m.parts) and m.names.isdisjoint(space.needed) for m in space.mechanisms])
    earned[~able[new]] = -np.inf
    earned[:, ~able[now]] = -np.inf
    return now, new, earned.T
