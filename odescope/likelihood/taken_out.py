"""Terms outside of a fraction: those that stand in its numerator with every term of its denominator, in proportion.

What flows into a reactor or grows by itself is divided by nothing, and a rate that saturates beside it is: multiplied
out, the relation holds it times every term of the denominator, with coefficients of their own. Where the record does
not contradict that these are products of others, they are made so. docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.product import Product
from odescope.likelihood.fit import Fit
from odescope.likelihood.search_space import SearchSpace

ROUNDS = 12  # linearisations of the proportions
SAME = 1e-9  # of a product of two coefficients: less is rounding
LIMIT = 1e-12  # of a coefficient, that the last of them moves it by


@dataclass(frozen=True)
class _Proportion:
    """Four coefficients by number: outside is to unit as inside is to below.

    Unit multiplies the target alone, below its product with a term, and inside the product of what is outside with it.
    """

    outside: int
    unit: int
    inside: int
    below: int


@np.errstate(over="ignore")  # of coefficients that ran away
def with_terms_outside(space: SearchSpace, found: Fit, covariance: FloatArray) -> tuple[Fit, FloatArray]:
    """Return a fit in which what stands in proportion to a denominator does so exactly, and its covariance.

    It is the fit of least cost that does, as far as the cost is a parabola. A proportion costs no more than the price
    of the coefficient that it does without; of coefficients that are not told from nothing none is asked.

    Args:
        space: of the fit.
        found: the fit.
        covariance: (p, p) of its parameters.
    """
    unsure = set(found.free[~(np.diag(covariance) < found.theta[found.free] ** 2)].tolist())
    groups = [g for g in _groups(space, found) if all(unsure.isdisjoint(astuple(p)) for p in g)]
    if not groups or not np.isfinite(covariance).all():  # of coefficients that ran away
        return found, covariance
    sizes, free = space.sizes(found.theta), found.free
    theta, scale = found.theta * sizes, np.outer(sizes[free], sizes[free])
    scaled = covariance * scale
    chosen = list[tuple[_Proportion, ...]]()
    taken = set[int]()
    ranked = [(_projected(theta, free, scaled, group), group) for group in groups]
    for (_, _, cost), group in sorted(ranked, key=lambda pair: pair[0][2]):
        held = {k for p in group for k in (p.outside, p.inside)}
        if cost <= _price(space, group) and held.isdisjoint(taken):
            chosen.append(group)
            taken |= held
    while chosen:
        every = [p for group in chosen for p in group]
        moved, narrowed, cost = _projected(theta, free, scaled, every)
        if cost <= _price(space, every):
            return replace(found, theta=_exactly(moved, every) / sizes), narrowed / scale
        chosen.pop()
    return found, covariance


def outside(space: SearchSpace, found: Fit) -> set[int]:
    """Return the numbers of what stands outside of fractions in a fit, and of its products with what is below."""
    groups = list(_groups(space, found))
    theta = found.theta * space.sizes(found.theta) if groups else found.theta
    exact = (group for group in groups if all(_holds(theta, p) for p in group))
    return {k for group in exact for p in group for k in (p.outside, p.inside)}


def _holds(theta: FloatArray, p: _Proportion) -> bool:
    product = theta[p.inside] * theta[p.unit]
    return bool(abs(theta[p.outside] * theta[p.below] - product) <= SAME * abs(product))


def _groups(space: SearchSpace, found: Fit) -> Iterator[tuple[_Proportion, ...]]:
    """Yield the proportions of every term that a model holds times each term of a denominator."""
    single = [(k, space.mechanisms[k].parts[0]) for k in found.present.tolist() if space.mechanisms[k].kind == "term"]
    number = {(p.relation, p.product): k for k, p in single}
    for r, target in enumerate(space.frame.targets):
        unit = number.get((r, Product(target)))
        below = {p.product: k for k, p in single if p.relation == r and p.product.factor is not None and k != unit}
        if unit is None or not below or any(p.factor != target for p in below):
            continue
        for (_, product), k in ((place, k) for place, k in number.items() if place[0] == r):
            inside = {number.get((r, product * p.term)): place for p, place in below.items()}
            plain = product.factor is None and product.term.names.isdisjoint(space.frame.constants)
            if plain and None not in inside and len(inside) == len(below):
                yield tuple(_Proportion(k, unit, i, place) for i, place in inside.items() if i is not None)


def _price(space: SearchSpace, proportions: Sequence[_Proportion]) -> float:
    return float(space.penalty[[p.inside for p in proportions]].sum())


def _projected(
    theta: FloatArray, free: IntArray, covariance: FloatArray, proportions: Sequence[_Proportion]
) -> tuple[FloatArray, FloatArray, float]:
    """Return the nearest coefficients (mechanisms,) in proportion, the covariance of the free ones, and the cost.

    Args:
        theta: (mechanisms,) coefficients.
        free: (p,) those that may move.
        covariance: (p, p) of these, which says what is near.
        proportions: what is to hold.
    """
    moved = theta.copy()
    for _ in range(ROUNDS):
        slopes = np.zeros((len(proportions), len(theta)))
        missed = np.empty(len(proportions))
        for row, p in enumerate(proportions):
            missed[row] = moved[p.outside] * moved[p.below] - moved[p.inside] * moved[p.unit]
            slopes[row, p.outside] += moved[p.below]
            slopes[row, p.below] += moved[p.outside]
            slopes[row, p.inside] -= moved[p.unit]
            slopes[row, p.unit] -= moved[p.inside]
        own = slopes[:, free]
        rest = missed + own @ (theta - moved)[free]
        gain = np.linalg.pinv(own @ covariance @ own.T, hermitian=True)
        before = moved[free].copy()
        moved[free] = theta[free] - covariance @ own.T @ (gain @ rest)
        if np.all(np.abs(moved[free] - before) <= LIMIT * np.abs(moved[free])):
            break
    across = covariance @ own.T
    return moved, covariance - across @ gain @ across.T, float(rest @ gain @ rest)


def _exactly(theta: FloatArray, proportions: Sequence[_Proportion]) -> FloatArray:
    """Return coefficients whose proportions hold to rounding."""
    exact = theta.copy()
    for p in proportions:
        exact[p.inside] = exact[p.outside] * exact[p.below] / exact[p.unit]
    return exact
