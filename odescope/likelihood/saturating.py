"""Fractions of one variable as polynomials and saturations of it: their partial fractions.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import ONE, Name, Term
from odescope.library.families import HALF, Family
from odescope.library.product import Product
from odescope.likelihood.add_and_drop import HOPELESS
from odescope.likelihood.fit import Fit
from odescope.likelihood.function_space import FunctionSpace
from odescope.likelihood.imitation import Choice, Placed
from odescope.likelihood.standing import Standing


def partial_fractions(
    above: Mapping[Term, float], name: str, half: float
) -> tuple[dict[Term, float], dict[Term, float]]:
    """Return what sum(above) / (half + z) is: polynomials in z, and what z / (half + z) is multiplied by.

    z^p / (half + z) = z^(p - 1) - half z^(p - 1) / (half + z), and 1 / (half + z) = (1 - z / (half + z)) / half.

    Args:
        above: coefficients of the numerator by term.
        name: of the variable z.
        half: the constant of the denominator, not 0.
    """
    z, whole, saturated = Name(name), dict[Term, float](), dict[Term, float]()
    for term, coefficient in above.items():
        rest, left = Term(tuple(f for f in term.factors if f[0] != z)), coefficient
        for power in range(int(term.power_of(z)) - 1, -1, -1):
            of = Term.of((*rest.factors, (z, power)))
            whole[of] = whole.get(of, 0.0) + left
            left *= -half
        whole[rest] = whole.get(rest, 0.0) + left / half
        saturated[rest] = saturated.get(rest, 0.0) - left / half
    return whole, saturated


@dataclass(frozen=True, eq=False)
class Saturating(FunctionSpace):
    """The model with saturations in the place of fractions."""

    def saturating(self, found: Fit) -> Standing | None:
        """Return the model with saturations in the place of fractions, None where none of its fractions is one.

        (a + b z) / (K + z) is a number and z / (K + z), which other relations may hold, too.

        Args:
            found: the model before.
        """
        theta, placed, functions = found.theta, [Placed(Choice())] * len(self.suspected), list[int]()
        for k, suspected in enumerate(self.suspected):
            below = self.denominator(found, k)
            if below is not None:
                theta, there = self.with_saturations(theta, suspected.relation, *below)
                functions += there
                terms = tuple(self.space.mechanisms[j].parts[0].product.term for j in there)
                placed[k] = Placed(Choice(terms, below[0].constants), {below[0].constants[0].name: below[1]})
        fit = self.tightened(theta) if functions else None
        if fit is None or not fit.cost < HOPELESS * found.cost:
            return None
        fit = self.pruned(fit, functions)
        for k, (one, suspected) in enumerate(zip(placed, self.suspected, strict=True)):
            here = {p.term for _, p in self.present(fit, suspected.relation)}
            terms = tuple(t for t in one.choice.terms if t in here)
            placed[k] = Placed(Choice(terms, one.choice.constants), one.values) if terms else Placed(Choice())
        return Standing(fit, tuple(placed), found if self.exact else None)

    def with_saturations(
        self, theta: FloatArray, relation: int, family: Family, half: float
    ) -> tuple[FloatArray, list[int]]:
        """Return coefficients with a relation as polynomials and saturations, and the numbers of these.

        What is no candidate is left out: the fit says whether it goes without.

        Args:
            theta: (mechanisms,) coefficients, of a relation that is divided by a half constant and a variable.
            relation: its number.
            family: the saturation.
            half: its constant.
        """
        name, mechanisms = family.variable, self.space.mechanisms
        present = ((k, p) for k in np.flatnonzero(theta).tolist() for p in mechanisms[k].parts)
        parts = [(k, p.product) for k, p in present if p.relation == relation]
        grown = next(float(theta[k]) for k, p in parts if p.factor is not None and name in p.term.names)
        above = {p.term: float(theta[k]) / grown for k, p in parts if p.factor is None}
        whole, saturated = partial_fractions(above, name, half)
        result = theta.copy()
        result[[k for k, _ in parts]] = 0.0
        result[self.number[relation, Product(self.space.frame.targets[relation])]] = 1.0
        terms = {**whole, **{family.term * rest: value for rest, value in saturated.items()}}
        found = {self.number.get((relation, Product(None, term)), -1): value for term, value in terms.items()}
        found.pop(-1, None)
        for k, value in found.items():
            result[k] = value
        (constant,) = family.constants
        result[self.space.needed[constant.name]] = self.space.frame.constants[constant.name].coefficient(half)
        return result, [k for k in found if k >= self.own]

    def denominator(self, found: Fit, k: int) -> tuple[Family, float] | None:
        """Return the saturation that the fraction of a suspicion is, and its constant; None where it is another.

        Args:
            found: the model before.
            k: number of the suspicion.
        """
        name = self.suspected[k].variable
        products = self.present(found, self.suspected[k].relation)
        below = {p.term: float(found.theta[j]) for j, p in products if p.factor is not None}
        bare, grown = below.get(ONE, 0.0), below.get(Term(((Name(name), 1),)), 0.0)
        powers = [p.term.power_of(Name(name)) for _, p in products]
        families = (f for f in self.families.get(name, ()) for c in f.constants if c.name.startswith(f"{HALF}_"))
        family, seen = next(families, None), self.samples.values.get(name, np.zeros(1))
        if family is None or seen.max() < -seen.min() or len(below) != 2 or not bare * grown > 0.0:
            return None
        if any(power < 0 or power % 1 for power in powers):
            return None
        (constant,), half = family.constants, bare / grown
        return (family, half) if constant.low < half < constant.high else None
