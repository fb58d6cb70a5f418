"""Units of coefficients, worked out from the units that the study states."""

from __future__ import annotations

from fractions import Fraction

from odescope.library.expression import Call, Combination, Name, Term
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.report.numerals import raised

Dimension = tuple[tuple[str, Fraction], ...]  # powers of units, each unit as the study spells it

_WITHOUT = {"sin", "cos", "tan", "exp", "log", "sign", "tanh"}


def quantity_units(model: Model) -> dict[str, Dimension | None]:
    """Return the unit of every state, target and input; None where the study states none."""
    units: dict[str, Dimension | None] = {i.name: _of(i.unit) for i in model.inputs}
    for c in model.coordinates:
        own = _of(c.unit or ("rad" if c.angle else None))
        for k in range(c.order + 1):
            units[c.derivative(k)] = None if own is None else _times(own, (("s", Fraction(-k)),))
    return units


def coefficient_units(relation: Relation, units: dict[str, Dimension | None]) -> tuple[str, ...]:
    """Return the unit of every coefficient of a relation, whose first has none; "" where it is not known."""
    terms = [_product(t, units) for t in relation.terms]
    whole = terms[0]
    return tuple("" if whole is None or term is None else shown(_times(whole, _raised(term, -1.0))) for term in terms)


def _product(term: RelationTerm, units: dict[str, Dimension | None]) -> Dimension | None:
    factor, rest = () if term.factor is None else units[term.factor], _term(term.term, units)
    return None if factor is None or rest is None else _times(factor, rest)


def shown(dimension: Dimension | None) -> str:
    """Return a unit as text, "1" for none; "" for an unknown one."""
    if dimension is None:
        return ""
    parts = []
    for unit, power in sorted(dimension, key=lambda p: (p[1] < 0, p[0] == "s", p[0])):
        base = unit if unit.isalnum() or power == 1 else f"({unit})"
        up = raised(power.numerator) if power.denominator == 1 else f"^({power})"
        parts.append(base if power == 1 else base + up)
    return " ".join(parts) or "1"


def _of(unit: str | None) -> Dimension | None:
    if unit is None:
        return None
    text = " ".join(unit.split())
    return () if text in ("", "1", "-") else ((text, Fraction(1)),)


def _times(first: Dimension, second: Dimension) -> Dimension:
    powers: dict[str, Fraction] = {}
    for unit, power in (*first, *second):
        powers[unit] = powers.get(unit, Fraction(0)) + power
    return tuple((unit, power) for unit, power in powers.items() if power)


def _raised(dimension: Dimension, power: float) -> Dimension:
    exact = Fraction(power).limit_denominator(64)
    return tuple((unit, own * exact) for unit, own in dimension)


def _term(term: Term, units: dict[str, Dimension | None]) -> Dimension | None:
    product: Dimension = ()
    for atom, power in term.factors:
        own = units[atom.name] if isinstance(atom, Name) else _call(atom, units)
        if own is None:
            return None
        product = _times(product, _raised(own, power))
    return product


def _call(call: Call, units: dict[str, Dimension | None]) -> Dimension | None:
    if call.function in _WITHOUT:
        return ()
    inside = _combination(call.argument, units)
    return inside if inside is None or call.function != "sqrt" else _raised(inside, 0.5)


def _combination(combination: Combination, units: dict[str, Dimension | None]) -> Dimension | None:
    # Numbers inside a sum, such as the 3 of (x - 3), carry the unit of what they stand beside.
    found = {
        None if (own := _term(t, units)) is None else tuple(sorted(own)) for _, t in combination.parts if t.factors
    }
    return found.pop() if len(found) == 1 else None
