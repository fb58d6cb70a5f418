"""Units of coefficients, worked out from the units that the study states."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction

from odescope.library.functions import FUNCTIONS
from odescope.library.printer import Language, print_product
from odescope.model.model import Model
from odescope.model.relation import Relation
from odescope.report.numerals import raised

Dimension = tuple[tuple[str, Fraction], ...]  # powers of units, each unit as the study spells it

_NUMBER: Dimension = (("", Fraction(0)),)  # of the empty product, which takes the unit of what it stands beside


def quantity_units(model: Model) -> dict[str, Dimension | None]:
    """Return the unit of every state, target and input; None where the study states none."""
    units: dict[str, Dimension | None] = {i.name: _of(i.unit) for i in model.inputs}
    for c in model.coordinates:
        own = _of(c.unit or ("rad" if c.angle else None))
        for k in range(c.order + 1):
            units[c.derivative(k)] = None if own is None else _times(own, (("s", Fraction(-k)),))
    return units


def coefficient_units(relation: Relation, units: dict[str, Dimension | None]) -> tuple[str, ...]:
    """Return the unit of every coefficient of a relation, whose first has none; "" where it is not known.

    Units are one more language (see `library.printer`), in which what is said of a term is its unit.
    """
    language = Language(
        name=lambda name, power: _raised(units[name], power), call=_call, group=_raised, product=_product, sum=_sum
    )
    terms = [print_product(language, t.factor, t.term) for t in relation.terms]
    whole = terms[0]
    return tuple(shown(_product((whole, _raised(term, -1.0)))) for term in terms)


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


def _raised(dimension: Dimension | None, power: float) -> Dimension | None:
    if dimension is None:
        return None
    exact = Fraction(power).limit_denominator(64)
    return tuple((unit, own * exact) for unit, own in dimension)


def _call(function: str, inside: Dimension | None, power: float) -> Dimension | None:
    carried = FUNCTIONS[function].unit_power
    return () if carried == 0.0 else _raised(inside, carried * power)


def _product(factors: Iterable[Dimension | None]) -> Dimension | None:
    product: Dimension = _NUMBER
    for factor in factors:
        if factor is None:
            return None
        product = _times(product, factor)
    return product


def _sum(parts: Iterable[tuple[float, Dimension | None]]) -> Dimension | None:
    # Numbers inside a sum, such as the 3 of (x - 3), carry the unit of what they stand beside.
    found = {None if own is None else tuple(sorted(own)) for _, own in parts if own != _NUMBER}
    return found.pop() if len(found) == 1 else None
