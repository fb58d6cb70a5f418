"""Units of states, targets and inputs, worked out from those of coordinates and inputs."""

from __future__ import annotations

from fractions import Fraction

from odescope.library.numerals import raised
from odescope.model.model import Model

Dimension = tuple[tuple[str, Fraction], ...]  # powers of units, each unit as the study spells it


def quantity_units(model: Model) -> dict[str, Dimension | None]:
    """Return the unit of every state, target and input; None where the study states none."""
    units: dict[str, Dimension | None] = {i.name: _of(i.unit) for i in model.inputs}
    for c in model.coordinates:
        own = _of(c.unit or ("rad" if c.angle else None))
        for k in range(c.order + 1):
            units[c.derivative(k)] = None if own is None else times(own, (("s", Fraction(-k)),))
    return units


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


def times(first: Dimension, second: Dimension) -> Dimension:
    """Return the unit of a product."""
    powers: dict[str, Fraction] = {}
    for unit, power in (*first, *second):
        powers[unit] = powers.get(unit, Fraction(0)) + power
    return tuple((unit, power) for unit, power in powers.items() if power)
