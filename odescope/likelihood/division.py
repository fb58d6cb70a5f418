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


def divided(space: SearchSpace, found: Fit) -> FloatArray | None:
    """Return the coefficients of a fit with a relation divided by a function, or multiplied, that makes it simpler.

    A law times a function says the same of the record. None where nothing makes it simpler, or the library lacks
    what would be left.
    """
    for group in scale_groups(space.mechanisms, found.present):
        parts = _plain(space, group)
        atoms = dict.fromkeys(atom for p in parts for atom, _ in p.product.term.factors)
        for by in (Term(((atom, power),)) for atom in atoms for power in (-1, 1)):
            places = _places(space, parts, by)
            if places.min() >= 0 and space.penalty[places].sum() < space.penalty[list(group)].sum():
                theta = found.theta.copy()
                theta[list(group)] = 0.0
                theta[places] = found.theta[list(group)]
                return theta
    return None


def divided_in_part(space: SearchSpace, found: Fit) -> FloatArray | None:
    """Return the coefficients of a fit with relations divided by what their targets are multiplied by.

    Of a law times a state a library may hold a part, whose rest other terms imitate: what is no multiple of the
    divisor is left out. None where nothing is divided, nor where the target would be left alone.
    """
    theta = found.theta.copy()
    for group in scale_groups(space.mechanisms, found.present):
        parts = _plain(space, group)
        above = [p.product.term for p in parts if p.product.factor is not None]
        if len(above) != 1 or not above[0].factors:
            continue
        by = Term(tuple((atom, -power) for atom, power in above[0].factors))
        places = _places(space, parts, by)
        there = places >= 0
        if np.count_nonzero(there) > 1:
            theta[list(group)] = 0.0
            theta[places[there]] = found.theta[list(group)][there]
    return None if np.array_equal(theta, found.theta) else theta


def _plain(space: SearchSpace, group: Sequence[int]) -> list[Part]:
    """Return the parts of a scale group that may be divided: one a mechanism, none if some are tied or given."""
    mechanisms = [space.mechanisms[k] for k in group]
    return [m.parts[0] for m in mechanisms] if all(len(m.parts) == 1 and m.known is None for m in mechanisms) else []


def _places(space: SearchSpace, parts: Sequence[Part], by: Term) -> IntArray:
    """Return the numbers of the mechanisms that parts times a term are, -1 for what the library lacks."""
    return np.array([space.numbers.get((replace(p, product=p.product * by),), -1) for p in parts], dtype=np.int64)
