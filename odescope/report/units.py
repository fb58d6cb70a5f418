"""Units of coefficients, worked out from the units that the study states."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction

from odescope.errors import InputError
from odescope.library.functions import FUNCTIONS
from odescope.library.mechanism import FORCE_ON
from odescope.library.parse import Scope, parse_term
from odescope.library.printer import Language, print_product, print_term
from odescope.model.model import Model
from odescope.model.quantity_units import Dimension, times
from odescope.model.quantity_units import quantity_units as quantity_units
from odescope.model.quantity_units import shown as shown
from odescope.model.relation import FoundMechanism, Relation

_NUMBER: Dimension = (("", Fraction(0)),)  # of the empty product, which takes the unit of what it stands beside


def coefficient_units(relation: Relation, units: dict[str, Dimension | None]) -> tuple[str, ...]:
    """Return the unit of every coefficient of a relation, whose first has none; "" where it is not known.

    Units are one more language (see `library.printer`), in which what is said of a term is its unit.
    """
    terms = [print_product(_language(units), t.factor, t.term) for t in relation.terms]
    whole = terms[0]
    return tuple(shown(_product((whole, _raised(term, -1.0)))) for term in terms)


def mechanism_units(model: Model) -> dict[FoundMechanism, str]:
    """Return the unit of the coefficient of every mechanism; "" where it is not known.

    Energies are in the unit of the work of the force with coefficient 1, without one in that of the kinetic energy
    whose coefficient is 1/2; fluxes of reactions are in that of the amounts, over time.
    """
    units = quantity_units(model)
    scope = Scope.of(model.variables)
    held = {m: _of_term(m.term, scope, units) for m in model.mechanisms}
    second: Dimension = (("s", Fraction(1)),)
    energy: Dimension | None = None
    for m in model.mechanisms:
        if m.std_error is None and m.kind == "force" and m.coefficient == 1.0:
            energy = _product((held[m], units.get(_acted_on(m))))
        elif m.std_error is None and m.kind == "kinetic" and m.coefficient == 0.5 and energy is None:
            energy = held[m]
    amounts = {units[c.name] for c in model.coordinates}
    amount = amounts.pop() if len(amounts) == 1 else None
    wholes = {
        "kinetic": energy,
        "potential": energy,
        "dissipation": _product((energy, _raised(second, -1.0))),
        "reaction": _product((amount, _raised(second, -1.0))),
    }
    found = dict[FoundMechanism, str]()
    for m in model.mechanisms:
        whole = wholes.get(m.kind)
        if m.kind == "force":
            whole = _product((energy, _raised(units.get(_acted_on(m)), -1.0)))
        found[m] = shown(_product((whole, _raised(held[m], -1.0))))
    return found


def _acted_on(force: FoundMechanism) -> str:
    return force.name.rpartition(FORCE_ON)[2]


def _of_term(text: str, scope: Scope, units: dict[str, Dimension | None]) -> Dimension | None:
    try:
        return print_term(_language(units), parse_term(text, scope))
    except InputError:  # of a file that anyone may have written
        return None


def _language(units: dict[str, Dimension | None]) -> Language[Dimension | None]:
    """Return the language in which what is said of a term is its unit."""
    return Language(
        name=lambda name, power: _raised(units[name], power), call=_call, group=_raised, product=_product, sum=_sum
    )


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
        product = times(product, factor)
    return product


def _sum(parts: Iterable[tuple[float, Dimension | None]]) -> Dimension | None:
    # Numbers inside a sum, such as the 3 of (x - 3), carry the unit of what they stand beside.
    found = {None if own is None else tuple(sorted(own)) for _, own in parts if own != _NUMBER}
    return found.pop() if len(found) == 1 else None
