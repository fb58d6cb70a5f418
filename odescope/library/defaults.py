"""Libraries without a hand: the default by order of the equations, and the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

from odescope.errors import InputError
from odescope.library.candidates import Library
from odescope.library.friction import default_friction, friction_rule, speeds
from odescope.library.harmonics import harmonics
from odescope.library.parse import Scope
from odescope.library.rules import Exclusive, Identity, MaximumDegree, Rule
from odescope.library.spatial import spatial_forces
from odescope.recordings.coordinate import Coordinate, Input

COMFORTABLE = 60  # polynomial degree is lowered until a default has no more products of states and inputs than this


def paper_basis(coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> tuple[str, ...]:
    """Return the paper's basis (24) less the constant: velocities, sine and cosine of angles, inputs, targets."""
    velocities = [c.derivative(k) for k in range(1, _highest(coordinates)) for c in coordinates if c.order > k]
    trigonometric = [f"{f}({c.name})" for c in coordinates if c.angle for f in ("sin", "cos")]
    return (*velocities, *trigonometric, *(i.name for i in inputs), *(c.target for c in coordinates))


def paper_rules(coordinates: Sequence[Coordinate], inputs: Sequence[Input], target: str) -> tuple[Rule, ...]:
    """Return the rules that thin the paper's 330 products to the 35 of one target.

    What is left is {1, v1, v1^2, v2, v2^2, u, target} x {1, s, c, s c, c^2}.

    Args:
        coordinates: give the velocities and the angles.
        inputs: each enters at most linearly.
        target: the one whose relation is looked for; products with the others are left out.
    """
    velocities = tuple(c.derivative(k) for k in range(1, _highest(coordinates)) for c in coordinates if c.order > k)
    driven = tuple(i.name for i in inputs)
    angles = [c.name for c in coordinates if c.angle]
    others = tuple(c.target for c in coordinates if c.target != target)
    rules: list[Rule] = [MaximumDegree(others, 0)] if others else []
    rules += [Exclusive((*velocities, *driven, target))]
    rules += [MaximumDegree((name,), 2) for name in velocities]
    rules += [MaximumDegree((name,), 1) for name in (*driven, target)]
    rules += [Identity(f"sin({a})") for a in angles]
    if angles:
        rules.append(MaximumDegree(tuple(f"{f}({a})" for a in angles for f in ("sin", "cos")), 2))
    return tuple(rules)


def default_library(
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    targets: Sequence[str],
    scope: Scope,
    degree: int | None = None,
    sums: bool = False,
) -> Library:
    """Return the default candidates for relations that are linear in `targets`.

    With angles: {1, velocities, products of two velocities, inputs, positions that are neither angle nor cyclic,
    targets} x products of sines and cosines to degree 2, and positions times the square of an angle's velocity, which
    is what turning throws outwards, and the cube of that velocity where nothing else moves, as damps a hull (Norrbin);
    what is of order 1 and no angle may be a speed, too, and is multiplied by another,
    a velocity or a target. Without: monomials of states and inputs to degree 3 (less where that
    would be too many) x {1, targets}. In both, dry and quadratic friction of the targets' coordinates of order 2 and of
    the differences of their rates with like ones, and of positions that are components of one the drag by their speed
    and forces from the origin by their distance (`spatial`), which nothing multiplies.

    Args:
        coordinates: give states, velocities and angles; an angle or a cyclic coordinate does not itself enter.
        inputs: enter as states do.
        targets: those that may multiply a product, each to the first power.
        scope: the names that the products are made of.
        degree: how many functions a product holds at most, targets aside, where that is asked for.
        sums: whether sines and cosines of sums and differences of angles stand in the place of products of those of
            different angles: they span the same, and either may be the shorter.
    """
    states = [
        c.derivative(k)
        for k in range(_highest(coordinates))
        for c in coordinates
        if c.order > k and not (k == 0 and (c.angle or c.cyclic))
    ]
    driven = [i.name for i in inputs]
    angles = [c.name for c in coordinates if c.angle]
    alone = Library.of((*default_friction(coordinates, targets), *spatial_forces(coordinates, targets)), scope)
    if not angles:
        names = [*states, *driven]
        usual = next((d for d in (3, 2) if comb(len(names) + d, d) <= COMFORTABLE), 1)
        polynomial = Library.of(names, scope).powers(usual if degree is None else degree)
        return polynomial * Library.of(("1", *targets), scope) + alone
    own, waves = {c.name for c in coordinates}, [f"{f}({a})" for a in angles for f in ("sin", "cos")]
    velocities = Library.of([s for s in states if s not in own], scope).powers(degree or 2)
    positions = Library.of([s for s in states if s in own], scope)
    trigonometric = Library.of(waves, scope).powers(degree or 2)
    trigonometric = trigonometric.thin([Identity(f"sin({a})") for a in angles], scope)
    if sums:
        several = Library.of((h for d in range(2, (degree or 2) + 1) for (h,) in harmonics(angles, d)), scope)
        trigonometric = trigonometric.that(lambda t: len(t.names) < 2) + several.that(lambda t: len(t.names) > 1)
    moving = velocities + Library.of([*driven], scope) + positions + Library.of(targets, scope)
    measured = Library.of(speeds(coordinates), scope)
    products = measured * (measured + velocities + Library.of(targets, scope))
    turning = Library.of([f"{c.derivative(1)}**2" for c in coordinates if c.angle and c.order > 1], scope)
    products = products + positions * turning + Library.of(_cubes(coordinates) if degree is None else (), scope)
    asked = [] if degree is None else [MaximumDegree((*states, *driven, *waves), degree)]
    return (moving * trigonometric + products).thin(asked, scope) + alone


def default_rules(
    coordinates: Sequence[Coordinate], targets: Sequence[str], basis: Sequence[str], scope: Scope
) -> tuple[Rule, ...]:
    """Return the rules of a basis by hand that brings none of its own.

    Linear in the targets, sin^2 = 1 - cos^2, no products with functions of dry friction.

    Args:
        coordinates: the angles among them may have sine and cosine in the basis, those of order 2 friction.
        targets: to appear to the first power at most.
        basis: the functions, as text.
        scope: the names that they may use.
    """
    compact = {b.replace(" ", "") for b in basis}
    pairs = [c.name for c in coordinates if {f"sin({c.name})", f"cos({c.name})"} <= compact]
    friction = friction_rule(coordinates, basis, scope)
    identities = [Identity(f"sin({a})") for a in pairs]
    return (MaximumDegree(tuple(targets), 1), *identities, *([friction] if friction else []))


def _cubes(coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return the cube of an angle's velocity where it is the only coordinate of order 2."""
    moving = [c for c in coordinates if c.order == 2]
    return tuple(f"{c.derivative(1)}**3" for c in moving if c.angle and len(moving) == 1)


def check_basis(coordinates: Sequence[Coordinate], library: Library) -> None:
    """Refuse a library without any state, whose relations could not be equations of motion."""
    states = {c.derivative(k) for c in coordinates for k in range(c.order)}
    if not any(term.names & states for term in library):
        raise InputError("no candidate term contains a state; name some in [library] basis")


def _highest(coordinates: Sequence[Coordinate]) -> int:
    return max(c.order for c in coordinates)
