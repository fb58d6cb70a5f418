"""Relations divided by a function: a law times something says the same of a record as the law.

docs/method.md, The gauge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.expression import Term
from odescope.library.mechanism import Part, scale_groups
from odescope.likelihood.fit import Fit
from odescope.likelihood.search_space import SearchSpace

UNEVEN = 0.25  # relative error of the coefficients of a product of two sums


def divided(space: SearchSpace, found: Fit) -> FloatArray | None:
    """Return the coefficients of a fit with a relation divided by a function, or multiplied, that makes it simpler.

    A law times a function says the same of the record, be it one product or a sum of several. None where nothing makes
    it simpler, or the library lacks what would be left.
    """
    for group in scale_groups(space.mechanisms, found.present):
        parts = _plain(space, group)
        law = _law(parts, found.theta[list(group)])
        if np.count_nonzero(law) < len(parts):
            theta = found.theta.copy()
            theta[list(group)] = law
            return theta
        atoms = dict.fromkeys(atom for p in parts for atom, _ in p.product.term.factors)
        for by in (Term(((atom, power),)) for atom in atoms for power in (-1, 1)):
            places = _places(space, parts, by)
            if places.min() >= 0 and space.penalty[places].sum() < space.penalty[list(group)].sum():
                theta = found.theta.copy()
                theta[list(group)] = 0.0
                theta[places] = found.theta[list(group)]
                return theta
    return None


def divided_in_part(space: SearchSpace, coefficients: FloatArray) -> FloatArray | None:
    """Return the coefficients of relations divided by what their targets are multiplied by.

    Of a law times a state a library may hold a part, whose rest other terms imitate: what is no multiple of the
    divisor is left out. Of several divisors that which leaves most is taken. None where nothing is divided, nor where
    the target would be left alone.
    """
    theta = coefficients.copy()
    for group in scale_groups(space.mechanisms, np.flatnonzero(theta)):
        parts = _plain(space, group)
        above = [p.product.term for p in parts if p.product.factor is not None]
        if not all(term.factors for term in above):
            continue
        divisors = (term.inverse for term in above)
        divided_by = (_places(space, parts, by) for by in divisors)
        places = max(divided_by, key=lambda found: np.count_nonzero(found >= 0), default=np.zeros(0))
        there = places >= 0
        if np.count_nonzero(there) > 1:
            theta[list(group)] = 0.0
            theta[places[there]] = coefficients[list(group)][there]
    return None if np.array_equal(theta, coefficients) else theta


def _plain(space: SearchSpace, group: Sequence[int]) -> list[Part]:
    """Return the parts of a scale group that may be divided: one a mechanism, none if some are tied or given."""
    mechanisms = [space.mechanisms[k] for k in group]
    return [m.parts[0] for m in mechanisms] if all(len(m.parts) == 1 and m.known is None for m in mechanisms) else []


def _law(parts: Sequence[Part], coefficients: FloatArray) -> FloatArray:
    """Return the coefficients of a relation less a sum that divides it; as they are where none does.

    (1 + c x) (y' + a y) = 0 says y' + a y = 0, and where 1 + c x passes zero every term of it looks certain.

    Args:
        parts: of the relation.
        coefficients: theirs, none of them 0.
    """
    number = {p.product: i for i, p in enumerate(parts)}
    targets = [i for i, p in enumerate(parts) if p.product.factor is not None]
    for base in targets if len(targets) > 1 else ():
        inverse = parts[base].product.term.inverse
        divisor = [(parts[t].product.term * inverse, coefficients[t] / coefficients[base]) for t in targets]
        multiples = np.array([[number.get(p.product * by, -1) for by, _ in divisor] for p in parts])
        law = np.flatnonzero((multiples >= 0).all(axis=1))
        while law.size:
            shares = np.zeros((len(parts), law.size))  # of what each part of the relation has to be
            for column, rows in enumerate(multiples[law]):
                shares[rows, column] = [ratio for _, ratio in divisor]
            shares /= coefficients[:, None]
            theta = np.linalg.lstsq(shares, np.ones(len(parts)), rcond=None)[0]
            if np.abs(shares @ theta - 1.0).max() > UNEVEN:
                break
            idle = np.abs(shares * theta).max(axis=0) < UNEVEN
            if not idle.any():
                whole: FloatArray = np.zeros(len(parts))
                whole[law] = theta
                return whole
            law = law[~idle]
    return coefficients


def _places(space: SearchSpace, parts: Sequence[Part], by: Term) -> IntArray:
    """Return the numbers of the mechanisms that parts times a term are, -1 for what the library lacks."""
    return np.array([space.numbers.get((replace(p, product=p.product * by),), -1) for p in parts], dtype=np.int64)
