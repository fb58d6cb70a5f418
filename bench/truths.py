"""Truths of the benchmarks: mechanisms with their coefficients, from terms of energies, reactions or relations.

The equations of motion are derived here, apart from the library of the package; bench/machines.py holds them against
equations of motion written by hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from odescope.library.derivative import derivative
from odescope.library.expression import ONE, Call, Combination, Name, Term
from odescope.library.mechanism import Kind, Mechanism, Part, candidate, merged
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.assembled import relations_of
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate, Input, state_names

SLIDING = 1000.0  # dry friction is simulated as tanh(SLIDING * rate): it sticks below a thousandth of a unit a second


@dataclass(frozen=True, eq=False)
class Truth:
    """Mechanisms and their coefficients; `held` are those that set the scale: one a group, or all that are known."""

    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]
    mechanisms: tuple[Mechanism, ...]
    theta: np.ndarray
    held: frozenset[int]

    @property
    def targets(self) -> tuple[str, ...]:
        """The highest derivative of each coordinate."""
        return tuple(c.target for c in self.coordinates)

    @cached_property
    def scope(self) -> Scope:
        """What a text may name."""
        return names_of(self.coordinates, self.inputs)

    @property
    def free(self) -> list[int]:
        """The mechanisms whose coefficient is to be found."""
        return [k for k in range(len(self.theta)) if k not in self.held]

    @cached_property
    def model(self) -> Model:
        """The equations of motion."""
        return self.stated(None)

    def stated(self, covariance: np.ndarray | None) -> Model:
        """Return the model with the standard errors that a covariance (k, k) of the coefficients leaves it."""
        return self._built(self.mechanisms, self.theta, covariance)

    def simulated(self, theta: np.ndarray | None = None) -> Model:
        """Return the model as it was simulated, with other coefficients perhaps: dry friction is steep, not a step."""
        return self._built(self._steep, self.theta if theta is None else theta, None)

    @cached_property
    def _steep(self) -> tuple[Mechanism, ...]:
        return tuple(replace(m, parts=tuple(map(_steep, m.parts))) for m in self.mechanisms)

    def _built(self, mechanisms: Sequence[Mechanism], theta: np.ndarray, covariance: np.ndarray | None) -> Model:
        relations = relations_of(mechanisms, theta, covariance, self.targets)
        return Model(self.coordinates, self.inputs, relations)


def _steep(part: Part) -> Part:
    factors = []
    for atom, power in part.product.term.factors:
        if isinstance(atom, Call) and atom.function == "sign":
            atom = Call("tanh", Combination(tuple((SLIDING * c, t) for c, t in atom.argument.parts)))
        factors.append((atom, power))
    return replace(part, product=Product(part.product.factor, Term.of(factors)))


def names_of(coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> Scope:
    return Scope.of([*state_names(coordinates), *(i.name for i in inputs)])


def relations(
    coordinates: tuple[Coordinate, ...],
    inputs: tuple[Input, ...],
    terms: Mapping[str, Sequence[tuple[str | None, str, float]]],
) -> Truth:
    """Return the truth of (factor, term, coefficient) by target, the first of every relation held."""
    scope, found, theta, held = names_of(coordinates, inputs), [], [], set()
    for r, (target, rows) in enumerate(terms.items()):
        held.add(len(found))
        found += [candidate(r, Product(factor, parse_term(text, scope)), target) for factor, text, _ in rows]
        theta += [c for _, _, c in rows]
    return Truth(coordinates, inputs, tuple(found), np.array(theta), frozenset(held))


def lagrangian(
    coordinates: tuple[Coordinate, ...],
    inputs: tuple[Input, ...],
    kinetic: Mapping[str, float],
    potential: Mapping[str, float],
    dissipation: Mapping[str, float],
    forces: Mapping[str, Mapping[str, float]],
) -> Truth:
    """Return the truth d/dt T_v - T_q + V_q + R_v = forces, the first term of the kinetic energy held.

    Args:
        coordinates: of second order.
        inputs: what may drive.
        kinetic: coefficients of the terms of T; likewise V and R.
        potential: of V.
        dissipation: of R, half the power lost where it is viscous.
        forces: coefficients by term, by coordinate.
    """
    scope = names_of(coordinates, inputs)
    found, theta = list[Mechanism](), list[float]()

    def add(kind: Kind, term: Term, c: float, parts: Sequence[tuple[int, str | None, float, Term]], where: str) -> None:
        spread = [Part(r, Product(f, t), s * k) for r, f, s, whole in parts for k, t in _multiplied(whole)]
        found.append(Mechanism(kind, term.text, where, merged(spread), 1.0))
        theta.append(c)

    def slopes(term: Term, name: str) -> tuple[tuple[float, Term], ...]:
        return derivative(term, name).parts

    for text, c in kinetic.items():
        term, parts = parse_term(text, scope), list[tuple[int, str | None, float, Term]]()
        for r, own in enumerate(coordinates):
            for s, momentum in slopes(term, own.derivative(1)):
                for other in coordinates:
                    parts += [(r, other.target, s * k, t) for k, t in slopes(momentum, other.derivative(1))]
                    rate = Term(((Name(other.derivative(1)), 1),))
                    parts += [(r, None, s * k, t * rate) for k, t in slopes(momentum, other.name)]
            parts += [(r, None, -s, t) for s, t in slopes(term, own.name)]
        add("kinetic", term, c, parts, "kinetic")
    for kind, terms, order in (("potential", potential, 0), ("dissipation", dissipation, 1)):
        for text, c in terms.items():
            term = parse_term(text, scope)
            parts = [
                (r, None, s, t) for r, own in enumerate(coordinates) for s, t in slopes(term, own.derivative(order))
            ]
            add(kind, term, c, parts, kind)
    for r, own in enumerate(coordinates):
        for text, c in forces.get(own.name, {}).items():
            term = parse_term(text, scope)
            add("force", term, c, [(r, None, -1.0, term)], own.name)
    return Truth(coordinates, inputs, tuple(found), np.array(theta), frozenset({0}))


def reactions(coordinates: tuple[Coordinate, ...], rates: Mapping[str, float]) -> Truth:
    """Return the truth of reactions such as "S + E -> C" with rates by mass action; every bare target is held."""
    found = [candidate(r, Product(c.target), c.target) for r, c in enumerate(coordinates)]
    species = [c.name for c in coordinates]
    for text in rates:
        before, after = ([s.strip() for s in side.split("+")] for side in text.split("->"))
        flux = Term.of([(Name(s), 1) for s in before])
        gains = [(species.index(s), -1.0) for s in before] + [(species.index(s), 1.0) for s in after]
        # What it brings a species stands on the left, beside the target.
        parts = merged(Part(r, Product(None, flux), -gain) for r, gain in gains)
        found.append(Mechanism("reaction", flux.text, "reaction", parts, 1.0, text))
    theta = np.array([*np.ones(len(species)), *rates.values()])
    return Truth(coordinates, (), tuple(found), theta, frozenset(range(len(species))))


def _multiplied(term: Term) -> list[tuple[float, Term]]:
    """Return a term as a sum of terms without a sum to the first power in it."""
    for atom, power in term.factors:
        if isinstance(atom, Call) and not atom.function and power == 1:
            rest = Term.of(f for f in term.factors if f[0] != atom)
            return [(c * k, t) for c, part in atom.argument.parts for k, t in _multiplied(rest * part)]
    return [(1.0, term)]


def canonical(term: Term) -> tuple[float, frozenset]:
    """Return sign and factors of a term, in which cos(b - a) is cos(a - b), and sin(b - a) its opposite."""
    sign, factors = 1.0, set()
    for atom, power in term.factors:
        if isinstance(atom, Call) and atom.function and atom.argument.parts[0][0] < 0.0:
            other = Call(atom.function, Combination(tuple((-c, t) for c, t in atom.argument.parts)))
            if atom.function in ("cos", "abs"):
                atom = other
            elif atom.function in ("sin", "sign", "tanh"):
                atom, sign = other, sign * (-1.0) ** power
        elif isinstance(atom, Call) and not atom.function and atom.argument.parts[0][0] < 0.0:
            atom = Call("", Combination(tuple((-c, t) for c, t in atom.argument.parts)))
            sign *= (-1.0) ** power
        factors.add((atom, power))
    return sign, frozenset(factors)


def multiplied_out(relation: Relation) -> Relation:
    """Return a relation with saturations, such as x*y/(K + x), as the same one without: times 1 + x/K.

    One at a time, and those alone whose denominator is a number and one term more. Coefficients lose their errors.
    """
    atoms = dict.fromkeys(a for t in relation.terms for a, power in t.term.factors if _saturates(a, power))
    for atom in atoms:
        by = {term: c for c, term in atom.argument.parts}
        lead = by[ONE]
        sums = dict[tuple[str | None, Term], float]()
        for t in relation.terms:
            divided = (atom, -1) in t.term.factors
            times = (
                [(1.0 / lead, t.term * Term(((atom, 1),)))]
                if divided
                else [(c / lead, t.term * e) for e, c in by.items()]
            )
            for c, term in times:
                key = t.factor, term
                sums[key] = sums.get(key, 0.0) + c * t.coefficient
        relation = Relation(tuple(RelationTerm(Product(f, term), c) for (f, term), c in sums.items()))
    return relation


def _saturates(atom: Name | Call, power: float) -> bool:
    whole = isinstance(atom, Call) and not atom.function and power == -1
    return whole and len(atom.argument.parts) == len("ab") and any(term == ONE for _, term in atom.argument.parts)


def chemistry(name: str) -> tuple[tuple[str, ...], ...]:
    """Return both sides of a reaction, each in order; nothing for a name that is none."""
    if "->" not in name:
        return ()
    return tuple(tuple(sorted(s.strip() for s in side.split("+"))) for side in name.split("->"))
