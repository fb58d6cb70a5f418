"""Motion in a plane or in space: positions that are components of one have speed and distance in common.

So have velocities that were measured themselves, as states of order 1, a speed.

Quadratic drag is against the velocity, and its size is that of all components together; a force from the origin goes
by the distance from there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from odescope.library.expression import Call, Term
from odescope.library.friction import alike
from odescope.recordings.coordinate import Coordinate

AXES = "xyz"


def components(names: Iterable[str]) -> tuple[tuple[str, ...], ...]:
    """Return the names that are components of one, by axis: those that differ in one letter, which is x, y or z."""
    found: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        for k, letter in enumerate(name):
            if letter.lower() in AXES:
                found.setdefault((name[:k], name[k + 1 :]), {})[letter.lower()] = name
    return tuple(tuple(of[axis] for axis in sorted(of)) for of in found.values() if len(of) > 1)


def in_space(coordinates: Sequence[Coordinate]) -> tuple[tuple[Coordinate, ...], ...]:
    """Return the positions that are components of one, in what may be one unit."""
    return _alike(c for c in coordinates if c.order == 2)


def _placed(coordinates: Sequence[Coordinate]) -> tuple[tuple[Coordinate, ...], ...]:
    """Return those of them whose distance from the origin may matter: what is cyclic only moves on."""
    return tuple(group for group in in_space(coordinates) if not any(c.cyclic for c in group))


def _velocities(coordinates: Sequence[Coordinate]) -> tuple[tuple[Coordinate, ...], ...]:
    """Return the states of order 1 that may be components of a velocity: what is called x, y or z alone is a place.

    Nor is one that is cyclic, of which nothing holds the value.
    """
    return _alike(c for c in coordinates if c.order == 1 and len(c.name) > 1 and not c.cyclic)


def _alike(coordinates: Iterable[Coordinate]) -> tuple[tuple[Coordinate, ...], ...]:
    """Return those that are components of one and alike; what goes round is of none."""
    moving = {c.name: c for c in coordinates if not c.angle}
    groups = (tuple(moving[name] for name in group) for group in components(moving))
    return tuple(group for group in groups if all(alike(group[0], c) for c in group[1:]))


def spatial_forces(coordinates: Sequence[Coordinate], targets: Sequence[str]) -> tuple[str, ...]:
    """Return quadratic drag, and forces from the origin by the square of the distance and of one size, as text.

    Args:
        coordinates: all.
        targets: forces on their coordinates are meant.
    """
    found = list[str]()
    for group in in_space(coordinates):
        speed = _squares(c.derivative(1) for c in group)
        found += [f"{c.derivative(1)}*sqrt({speed})" for c in group if c.target in targets]
    for group in _placed(coordinates):
        distance = _squares(c.name for c in group)
        mine = [c for c in group if c.target in targets]
        found += [f"{c.name}/sqrt({distance}){power}" for c in mine for power in ("**3", "")]
    for group in _velocities(coordinates):
        speed = _squares(c.name for c in group)
        found += [f"{c.name}*sqrt({speed})" for c in group if c.target in targets]
    return tuple(found)


def spatial_potentials(coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return the potentials of forces from the origin, by the square of the distance and of one size."""
    distances = [_squares(c.name for c in group) for group in _placed(coordinates)]
    return tuple(text for distance in distances for text in (f"1/sqrt({distance})", f"sqrt({distance})"))


def spatial_dissipation(coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return what quadratic drag adds to Rayleigh's function."""
    return tuple(f"sqrt({_squares(c.derivative(1) for c in group)})**3" for group in in_space(coordinates))


def together(coordinates: Sequence[Coordinate], k: int) -> dict[str, str]:
    """Return the sum of the squares of all components of a position, by the last component, for whose square it stands.

    What moves freely has the same inertia along every axis, and most often the same spring and friction: that is one
    coefficient instead of several.

    Args:
        coordinates: all.
        k: 0 for positions, 1 for rates.
    """
    groups = ([c.derivative(k) for c in group] for group in (in_space if k else _placed)(coordinates))
    return {names[-1]: f"({_squares(names)})**1" for names in groups}


def from_origin(term: Term) -> frozenset[str]:
    """Return the names in a root that a term holds: of components, at whose origin it has a pole or a kink."""
    roots = (a for a, _ in term.factors if isinstance(a, Call) and a.function == "sqrt")
    return next((a.argument.names for a in roots), frozenset())


def _squares(names: Iterable[str]) -> str:
    return " + ".join(f"{name}**2" for name in names)
