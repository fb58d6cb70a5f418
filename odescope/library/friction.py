"""Friction of rates and of differences of rates: its functions by default, and those that a basis names."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations

from odescope.library.expression import Atom, Call, Term
from odescope.library.parse import Scope, parse_term
from odescope.library.rules import Unmultiplied
from odescope.recordings.coordinate import Coordinate


def friction_rates(coordinates: Sequence[Coordinate], of: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return the rates that friction may depend on: those of some positions, and differences with like others.

    Args:
        coordinates: all.
        of: one coordinate of each difference, which are of what is `alike`, is among these. What is not of order 2 has
            no friction.
    """
    second = [c for c in coordinates if c.order == 2]
    # Names in order: the sign that a sum begins with is that of the first name.
    between = [
        sorted((a.derivative(1), b.derivative(1)))
        for a, b in combinations(second, 2)
        if alike(a, b) and (a in of or b in of)
    ]
    return (*(c.derivative(1) for c in second if c in of), *(f"{a} - {b}" for a, b in between))


def alike(a: Coordinate, b: Coordinate) -> bool:
    """Say whether the difference of two positions means something: of angles, or of what may be in one unit."""
    units = {c.unit for c in (a, b)} - {None}
    return a.angle == b.angle and (a.angle or len(units) <= 1)


def speeds(coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return the states that may be speeds that were measured: those of order 1 that are no angle and not cyclic."""
    return tuple(c.name for c in coordinates if c.order == 1 and not (c.angle or c.cyclic))


def default_friction(coordinates: Sequence[Coordinate], targets: Sequence[str]) -> tuple[str, ...]:
    """Return dry and quadratic friction for the relations of some targets.

    Viscous friction is not among them: it is a rate. What is of order 1 may be a speed that was measured, and has the
    friction of one; beside what is of order 2 it may be that of a wheel, which acts on what holds it.

    Args:
        coordinates: all.
        targets: their coordinates' rates, and differences with like ones, are meant.
    """
    own = [c for c in coordinates if c.target in targets]
    turning = speeds(coordinates if any(c.order == 2 for c in own) else own)
    found = (*friction_rates(coordinates, own), *turning)
    # To the first power, which keeps a difference from being multiplied out.
    return (*(f"sign({v})" for v in found), *(f"({v})**1*abs({v})" for v in found))


def rubs(term: Term) -> frozenset[str]:
    """Return the names whose sign or size a term holds, as friction does."""
    held = (a for a, _ in term.factors if isinstance(a, Call) and a.function in ("sign", "abs"))
    return next((a.argument.names for a in held), frozenset())


def friction_rule(coordinates: Sequence[Coordinate], basis: Sequence[str], scope: Scope) -> Unmultiplied | None:
    """Return the rule that keeps friction functions of a basis from being multiplied; None where there is none.

    What is left are the functions themselves, what the basis names as a whole (a normal force times one), and v*abs(v).

    Args:
        coordinates: what is not of order 2 has no friction.
        basis: the functions, as text.
        scope: the names that they may use.
    """
    moving = {c.derivative(1) for c in coordinates if c.order == 2}
    terms = [parse_term(text, scope) for text in basis]
    found = dict.fromkeys(
        a for t in terms for a, _ in t.factors if _is_dry(a, moving, scope, alone=len(t.factors) == 1)
    )
    if not found:
        return None
    named = [term for term in terms if any(term.power_of(atom) for atom in found)]
    drag = [f"{v}*abs({v})" for v in sorted(moving) if f"abs({v})" in {term.text for term in named}]
    return Unmultiplied(tuple(atom.text for atom in found), (*(term.text for term in named), *drag))


def _is_dry(atom: Atom, moving: Collection[str], scope: Scope, alone: bool) -> bool:
    """Say whether an atom is the sign of a sum of rates, a smooth one, or its size where nothing else is named with it.

    Args:
        atom: of a term of the basis. A constant may be added to the rates, as the speed of a belt.
        moving: the rates.
        scope: whose constants may scale them.
        alone: whether the term has no other factor: with one, as in v*abs(v), a size is no dry friction.
    """
    if not isinstance(atom, Call) or atom.function not in (("sign", "tanh", "abs") if alone else ("sign", "tanh")):
        return False
    constants = scope.constants or frozenset()
    parts = [t for _, t in atom.argument.parts if t.names - constants]
    return bool(parts) and all(_less(t, constants).text in moving for t in parts)


def _less(term: Term, constants: Collection[str]) -> Term:
    """Return a term without its factors that are constants."""
    return Term(tuple(f for f in term.factors if f[0].text not in constants))
