"""Terms that can go: what is next to nothing in every relation, and what is not worth its price.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import norm

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.fit_without import fit_without
from odescope.likelihood.held_out import free_run_error
from odescope.likelihood.search import THIN, Outcome, fitted_again
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.smoothed_targets import rates

SHARE = 1e-3  # of the largest term of a relation, root mean squares over the record
UNRESOLVED = 1e-5  # of the same: no integration and no sensor's scale is so true, however small the noise is
RUNS_AS_WELL = 1.01  # mean squared error of free runs over that with the term, and
UNSEEN = 1.0  # variances of the noise that it may be larger by


def without_negligible(space: SearchSpace, outcome: Outcome) -> Outcome:
    """Return the end of a search without terms that are next to nothing everywhere, one after the other.

    A term goes if it makes less than a thousandth of the largest of every relation that it stands in and earned less
    than a few times its penalty, or makes less than a hundred thousandth whatever it earned, and if free runs go as
    well without it.

    Args:
        space: the data and candidates.
        outcome: of a search that ended with joined segments.
    """
    here, trail = outcome.fit, list(outcome.trail)
    defect_std = space.segments.spread * outcome.width
    while (leaner := one_less(space, here, here.wald / max(outcome.scale, 1.0), defect_std)) is not None:
        here, k, statistic = leaner
        trail.append(space.move(outcome.width, "drop", k, statistic, here))
    return fitted_again(space, replace(outcome, trail=tuple(trail)), here)


def one_less(space: SearchSpace, here: Fit, wald: FloatArray, defect_std: FloatArray) -> tuple[Fit, int, float] | None:
    """Return the fit without the weakest term that is next to nothing, its number and Wald statistic, None if none is.

    Args:
        space: the data and candidates.
        here: a fit.
        wald: (p,) statistics of its parameters.
        defect_std: (n,) standard deviations of the defects between segments.
    """
    shares = contributions(space, here.theta)
    slight = [
        (w, k)
        for k, w in zip(here.free.tolist(), wald.tolist(), strict=True)
        if space.mechanisms[k].parts and shares[k] < (SHARE if w < THIN * space.penalty[k] else UNRESOLVED)
    ]
    if not slight:
        return None
    statistic, k = min(slight)
    lean = fit_without(space, here, k, defect_std)
    if lean is None or not lean.converged:
        return None
    unseen = UNSEEN * float(np.mean((space.segments.noise / space.segments.measured.std(axis=0)) ** 2))
    if free_run_error(space, lean.theta) > RUNS_AS_WELL * free_run_error(space, here.theta) + unseen:
        return None
    return lean, k, statistic


def contributions(space: SearchSpace, theta: FloatArray) -> FloatArray:
    """Return what each mechanism makes of the relation in which it makes most (mechanisms,), over its largest term.

    Root mean squares over the smoothed states; targets are their differences. What a mechanism makes of a relation is
    the sum of its parts there: a spring between two shafts pulls with their difference, however far they have turned.
    """
    frame = space.frame
    present = np.flatnonzero(theta).tolist()
    owned = [(k, p) for k in present for p in space.mechanisms[k].parts]
    evaluated = space.evaluated([p.product.term for _, p in owned], theta)
    target = dict(zip(frame.targets, rates(space), strict=True))
    made = dict[tuple[int, int], FloatArray]()
    for (k, part), values in zip(owned, evaluated, strict=True):
        whole = values if part.product.factor is None else values * target[part.product.factor]
        made[k, part.relation] = made.get((k, part.relation), 0.0) + theta[k] * part.share * whole
    sizes = np.zeros((len(space.mechanisms), len(frame.targets)))
    for place, values in made.items():
        sizes[place] = norm(values)  # of which no square overflows, whatever scale the coefficients ran away to
    shares: FloatArray = (sizes / np.maximum(sizes.max(axis=0), 1e-300)).max(axis=1)
    return shares


@np.errstate(all="ignore")  # of terms that the data cannot tell apart
def worthless(space: SearchSpace, fit: Fit, plain: Sequence[int]) -> IntArray:
    """Return what could go, one after the other, for less than its price, were the cost as its expansion says.

    Args:
        space: whose penalties are the prices.
        fit: of all.
        plain: numbers of those parameters that may go.
    """
    among, covariance, theta, left = fit.free.tolist(), fit.covariance, fit.theta[fit.free], list(plain)
    gone = list[int]()
    while left:
        places = [among.index(k) for k in left]
        rise = theta[places] ** 2 / np.maximum(np.diag(covariance)[places], 1e-300) - space.penalty[left]
        least = int(np.argmin(rise))
        if rise[least] >= 0.0:
            break
        j = places[least]
        theta = np.delete(theta - covariance[:, j] * theta[j] / covariance[j, j], j)
        rest = covariance - np.outer(covariance[:, j], covariance[j]) / covariance[j, j]
        covariance = np.delete(np.delete(rest, j, axis=0), j, axis=1)
        gone.append(among.pop(j))
        left.pop(least)
    return np.array(sorted(gone), dtype=np.int64)
