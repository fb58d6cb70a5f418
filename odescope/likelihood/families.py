"""Terms with free constants in a search: where to begin, and the scores of absent ones over a grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.constants import grid_of
from odescope.likelihood.evidence import project
from odescope.likelihood.expansion import Expansion
from odescope.likelihood.fit import Fit
from odescope.likelihood.gauge import SINGULAR
from odescope.likelihood.search_space import SearchSpace

STEPS = 6  # of a fit that says which start promises most
FEW = 4  # parameters a relation of a start that a search adds to


def best_on_grid(
    space: SearchSpace, here: Fit, scores: FloatArray, defect_std: FloatArray
) -> tuple[FloatArray, dict[int, Mapping[int, float]]]:
    """Return the scores with those of absent terms at their best constants, and where to begin with these, by number.

    A constant that some present term names is known; the others are where a term scores most, less what they have to
    earn as parameters.

    Args:
        space: candidates and data.
        here: where the search stands.
        scores: (mechanisms,) of all that is absent, constants nominal.
        defect_std: (n,) standard deviations of the defects between segments.
    """
    scores, begin = scores.copy(), dict[int, Mapping[int, float]]()
    groups = dict[frozenset[str], list[int]]()
    for k, m in enumerate(space.mechanisms):
        idle = frozenset(name for name, c in space.needed.items() if name in m.names and c not in here.present)
        if idle and k not in here.present:
            groups.setdefault(idle, []).append(k)
    for idle, members in groups.items():
        own = np.array([space.needed[name] for name in sorted(idle)], dtype=np.int64)
        constants = [space.frame.constants[name] for name in sorted(idle)]
        among = np.union1d(np.union1d(here.present, members), own)
        free = np.setdiff1d(among, np.union1d(here.held, own))
        program, best = space.program(among), np.full(len(members), -np.inf)
        for values in grid_of(constants):
            theta, coefficients = here.theta.copy(), [c.coefficient(values[c.name]) for c in constants]
            theta[own] = coefficients
            expansion = space.evaluator.expand(program, theta[among], np.searchsorted(among, free), here.x0, defect_std)
            if expansion is None or not expansion.finite:
                continue
            found, size = _scores(expansion, free, here.free, np.array(members))
            for place in np.flatnonzero(found > best):
                # Where its coefficient is 0 the data say nothing of a term's constants, and a fit could not begin.
                values_there = zip(own.tolist(), coefficients, strict=True)
                begin[members[place]] = {members[place]: float(size[place]), **dict(values_there)}
            best = np.maximum(best, found)
        scores[members] = np.maximum(best - space.penalty[own].sum(), 0.0)
    return scores, begin


def _scores(
    expansion: Expansion, free: IntArray, present: IntArray, members: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the scores and the estimates of absent mechanisms.

    Args:
        expansion: of the cost, with respect to those that are free.
        free: numbers of these, ascending.
        present: those of them that are in the model.
        members: those that are wanted.
    """
    here = np.isin(free, present)
    rest = project(expansion.information, expansion.gradient[None], here)
    places, told = np.searchsorted(free[~here], members), np.maximum(rest.left, SINGULAR)
    return rest.scores(rest.left)[places], (-rest.slopes.sum(axis=0) / told / rest.scale[~here])[places]


def promising(space: SearchSpace, begun: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the start of fewest terms, the best of few and the best of all, as they are fitted in loose segments.

    Constants that are a little off ask for terms in regression, and a search hardly drops these again, because the
    constants cannot move while they are there. From few terms it adds what is missing, with the constants free.
    """
    loose = np.full_like(space.segments.spread, np.inf)
    fits = [space.fit(t, np.flatnonzero(t), space.segments.initial, loose, iterations=STEPS) for t in begun]
    ranked = sorted((f for f in fits if f is not None), key=lambda f: f.cost + space.price(f))
    best = dict[tuple[int, ...], Fit]()
    for found in ranked:
        best.setdefault(tuple(found.present.tolist()), found)
    few = [k for k, f in best.items() if len(f.free) <= FEW * space.relations]
    least = sorted(best, key=len)[:1]
    return [best[k].theta for k in dict.fromkeys((*least, *few[:1], *list(best)[:1]))] or list(begun[:1])
