"""Mechanisms of mechanics: terms of the energies, the dissipation and the forces in Lagrange's equations.

Relation i is that of coordinate i: d/dt T_{q_i'} - T_{q_i} + V_{q_i} + R_{q_i'} - F_i = 0, where the kinetic energy T,
the potential V, the dissipation function R of Rayleigh and the forces F_i are sums of coefficients times terms.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal

from odescope.errors import InputError, nearest
from odescope.library.derivative import derivative, slope
from odescope.library.expansion import expanded
from odescope.library.expression import Call, Combination, Name, Term
from odescope.library.lagrangian_defaults import default_dissipation, default_energies, default_forces
from odescope.library.mechanism import FORCE_ON, Mechanism, Part, merged
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.recordings.coordinate import Coordinate, Input

Function = Literal["kinetic", "potential", "dissipation"]

TURNING = 2  # times its powers: an angle that is in no sine
BETWEEN = 2  # factors more: a harmonic of a difference in the potential
TAKEN_FOR_GRANTED = {"kinetic": 2, "potential": 0, "dissipation": 1}  # powers that the simplest term has anyway


def lagrangian(
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    scope: Scope,
    *,
    kinetic: Sequence[str] | None = None,
    potential: Sequence[str] | None = None,
    dissipation: Sequence[str] | None = None,
    forces: Mapping[str, Sequence[str]] | None = None,
) -> tuple[Mechanism, ...]:
    """Return the mechanisms of Lagrange's equations: kinetic, potential, dissipation, forces, in this order.

    Args:
        coordinates: generalized coordinates; relation i is that of the i-th.
        inputs: may stand in forces only.
        scope: the names and functions that texts may use: states, targets and inputs.
        kinetic: terms of the kinetic energy; None for the default, here as below (see `lagrangian_defaults`).
        potential: terms of the potential.
        dissipation: terms of the dissipation function.
        forces: terms of the force on each coordinate, by its name.

    Raises:
        InputError: a coordinate is not of order 2, a term cannot be what it is said to be or adds nothing to any
            relation, a force is on no coordinate, or a coordinate is without kinetic energy.
    """
    for c in coordinates:
        if c.order != 2:
            raise InputError(
                f"Lagrange's equations are of order 2, but the coordinate {c.name!r} has order {c.order}:"
                " set its order to 2, or use another form"
            )
    default_kinetic, default_potential = default_energies(coordinates, bool(inputs))
    functions: dict[Function, Sequence[str]] = {
        "kinetic": default_kinetic if kinetic is None else kinetic,
        "potential": default_potential if potential is None else potential,
        "dissipation": default_dissipation(coordinates, bool(inputs)) if dissipation is None else dissipation,
    }
    terms = {kind: dict.fromkeys(parse_term(text, scope) for text in texts) for kind, texts in functions.items()}
    found = [_of_function(kind, term, coordinates, inputs) for kind in functions for term in terms[kind]]
    _check_inertia(found, coordinates)
    forces = default_forces(coordinates, inputs) if forces is None else forces
    known = {c.name: r for r, c in enumerate(coordinates)}
    for name, texts in forces.items():
        if name not in known:
            raise InputError(f"there is no coordinate {name!r} for a force to act on; {nearest(name, known)}")
        acting = dict.fromkeys(parse_term(text, scope) for text in texts)
        found += [_force(known[name], term, coordinates) for term in acting]
    return tuple(found)


def _of_function(kind: Function, term: Term, coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> Mechanism:
    what = f"the {kind} term {term}"
    _check_names(what, term, coordinates)
    driven = term.names & {i.name for i in inputs}
    if driven:
        raise InputError(f"{what} holds the input {min(driven)}: name what an input does under forces")
    rates = {_rate(c) for c in coordinates}
    moving = term.names & rates
    if kind == "potential" and moving:
        raise InputError(f"{what} holds the velocity {min(moving)}: a potential is a function of positions; drop it")
    if kind != "potential" and not moving:
        shown = ", ".join(sorted(rates))
        raise InputError(f"{what} holds no velocity: multiply it by one of {shown}, or name it under potential")
    parts = _parts(what, _raw_parts(kind, term, coordinates))
    if not parts:
        raise InputError(f"{what} adds nothing to any equation: drop it")
    return Mechanism(kind, term.text, kind, parts, _size(kind, term, coordinates))


def _force(relation: int, term: Term, coordinates: Sequence[Coordinate]) -> Mechanism:
    place = f"force on {coordinates[relation].name}"
    what = f"the term {term} of the {place}"
    _check_names(what, term, coordinates)
    parts = _parts(what, [(relation, None, Combination(((-1.0, term),)))])
    name = f"{term}{FORCE_ON}{coordinates[relation].name}"
    return Mechanism("force", term.text, place, parts, _size("force", term, coordinates), name)


def _check_names(what: str, term: Term, coordinates: Sequence[Coordinate]) -> None:
    for c in coordinates:
        if c.target in term.names:
            raise InputError(
                f"{what} holds the acceleration {c.target}: what multiplies accelerations follows from the kinetic"
                " terms; drop it"
            )
        if c.cyclic and c.name in term.names:
            raise InputError(
                f"{what} holds the coordinate {c.name} itself, which is declared cyclic: drop the term, or set"
                " cyclic = false"
            )


def _check_inertia(found: Iterable[Mechanism], coordinates: Sequence[Coordinate]) -> None:
    moved = {part.relation for mechanism in found for part in mechanism.parts if part.product.factor is not None}
    for r, c in enumerate(coordinates):
        if r not in moved:
            raise InputError(
                f"no kinetic term gives the equation of {c.name} an acceleration: add one such as {_rate(c)}**2"
            )


def _raw_parts(
    kind: Function, term: Term, coordinates: Sequence[Coordinate]
) -> Iterator[tuple[int, str | None, Combination]]:
    """Yield what a term adds: the relation, the target that it multiplies, and how much of it."""
    for i, c in enumerate(coordinates):
        if kind == "potential":
            yield i, None, derivative(term, c.name)
        elif kind == "dissipation":
            yield i, None, derivative(term, _rate(c))
        else:
            momentum = derivative(term, _rate(c))
            for other in coordinates:
                yield i, other.target, slope(momentum, _rate(other))
                yield i, None, _times(slope(momentum, other.name), 1.0, Term(((Name(_rate(other)), 1),)))
            yield i, None, _times(derivative(term, c.name), -1.0, Term())


def _parts(what: str, raw: Iterable[tuple[int, str | None, Combination]]) -> tuple[Part, ...]:
    """Return parts in which every product is written out and stands once."""
    try:
        return merged(Part(r, Product(factor, t), c) for r, factor, much in raw for c, t in expanded(much).parts)
    except InputError as error:
        raise InputError(f"{what} is too long: {error}; name its products one by one") from error


def _times(combination: Combination, coefficient: float, term: Term) -> Combination:
    return Combination.of((coefficient * c, t * term) for c, t in combination.parts)


def _rate(coordinate: Coordinate) -> str:
    return coordinate.derivative(1)


def _size(kind: str, term: Term, coordinates: Sequence[Coordinate]) -> float:
    """Return how elaborate a term is: its powers, the multiples of angles in its harmonics past the first, and more.

    Of two that look alike while angles are small the likelier costs less: a weight less than a spring that turns with
    one angle, a spring between two angles less than a wave of their difference. Friction of each of two costs less than
    friction between them: both describe a record where a rotor's forces couple the two.
    """
    angles = {c.name for c in coordinates if c.angle}
    powers = sum(
        abs(power) * (TURNING if isinstance(atom, Name) and atom.name in angles else 1) for atom, power in term.factors
    )
    calls = [atom for atom, _ in term.factors if isinstance(atom, Call)]
    further = sum(_multiples(atom, angles) - 1 for atom in calls)
    further += sum(kind == "dissipation" and any(c < 0.0 for c, _ in atom.argument.parts) for atom in calls)
    between = sum(BETWEEN for atom in calls if kind == "potential" and _of_difference(atom, angles))
    return max(0, powers + further + between - TAKEN_FOR_GRANTED.get(kind, 0))


def _of_difference(call: Call, angles: set[str]) -> bool:
    """Say whether a call is a function of a difference of angles, and not that difference itself."""
    parts = call.argument.parts
    return bool(call.function) and len(parts) > 1 and call.argument.names <= angles and any(c < 0.0 for c, _ in parts)


def _multiples(call: Call, angles: set[str]) -> int:
    """Return the largest |k| of a function of k1*angle1 + k2*angle2 + ..., 1 for a function of anything else."""
    parts = call.argument.parts
    plain = all(t.text in angles and c.is_integer() for c, t in parts)
    return int(max(abs(c) for c, _ in parts)) if plain else 1
