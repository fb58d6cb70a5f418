"""Terms of the energies, the dissipation and the forces without a hand, built from the coordinates alone.

Configuration functions h(q) are products of powers of the positions that are no angles and one harmonic, cos(k.q) or
sin(k.q), k whole numbers over the angles: no identity such as sin**2 + cos**2 = 1 holds among them. Their degree is
that of the powers plus the sum of |k|. Springs that turn with an angle, or between two, store its square. Cyclic
coordinates do not enter.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, combinations_with_replacement, islice, product

from odescope.library.friction import alike, friction_rates
from odescope.library.harmonics import harmonics
from odescope.library.spatial import spatial_dissipation, spatial_potentials, together
from odescope.recordings.coordinate import Coordinate, Input

COMFORTABLE = 250  # degrees are lowered until a default has no more kinetic and potential terms than this
# Degree of the functions in the kinetic energy; whether of the two coordinates only whose rates they multiply (as two
# arms of a chain do, by cos(phi1 - phi2)); degree of the powers in the potential. From the richest on.
_LADDER = ((2, False, 4), (2, True, 4), (2, True, 3), (2, True, 2), (1, True, 2), (0, True, 2), (0, True, 1))


def default_energies(coordinates: Sequence[Coordinate], driven: bool = True) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the default terms of the kinetic energy and of the potential.

    Kinetic: every product of two rates times every h to degree 2, and of two positions in one unit the one times the
    rate of the other, which is what a rotor, a turning frame or a magnetic field add.

    Potential: every h to degree 2 but the constant, products of powers of positions to degree 4, and the squares of
    angles and of the differences of two; for x*y and x**3*y of two positions in one unit stand the second and the
    fourth power of their difference, as springs between them have it. Where these are more than 250, the degrees are
    lowered step by step: first the products of two rates keep the functions of their own two coordinates only, then the
    powers of the potential fall to 3 and 2, then the functions of the kinetic energy to degree 1 and 0, at last the
    potential to 1. Potentials of the distance from the origin (`spatial`) come on top, and where no input drives each
    coordinate by itself, the sum of the squares of all components of a position or of its velocity stands for the
    square of the last.

    Args:
        coordinates: generalized coordinates.
        driven: whether there are inputs.
    """
    distances, speeds = ({} if driven else together(coordinates, k) for k in (0, 1))
    kinetic, potential = tuple[str, ...](), tuple[str, ...]()
    for degree, own, powers in _LADDER:
        # Not one more than needed to see that they are too many, but for the last rung, which has to do.
        most = None if (degree, own, powers) == _LADDER[-1] else COMFORTABLE + 1
        kinetic = tuple(islice(_kinetic(coordinates, degree, own, speeds), most))
        potential = tuple(islice(_potential(coordinates, powers, distances), most))
        if len(kinetic) + len(potential) <= COMFORTABLE:
            break
    return kinetic, (*potential, *spatial_potentials(coordinates))


def default_dissipation(coordinates: Sequence[Coordinate], driven: bool = True) -> tuple[str, ...]:
    """Return the default terms of the dissipation function: viscous, dry and quadratic friction.

    Each is of every rate and of the differences of two rates of like kind, as in the default relations; quadratic
    friction is of the speed, too, where positions are components of one, and so is viscous friction where nothing
    drives them.

    Args:
        coordinates: generalized coordinates.
        driven: whether there are inputs.
    """
    of, sums = friction_rates(coordinates, coordinates), {} if driven else together(coordinates, 1)
    viscous = [sums.get(v) or (f"{v}**2" if v.isidentifier() else f"({v})**2") for v in of]
    return (*viscous, *(f"abs({v})" for v in of), *(f"abs({v})**3" for v in of), *spatial_dissipation(coordinates))


def default_forces(coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> dict[str, tuple[str, ...]]:
    """Return the default forces: every input on every coordinate, and beside inputs a constant.

    What an amplifier is off pushes the same way wherever a coordinate is, so no function of an angle stands for it. Of
    other positions the potential has the first power, which is a constant force. Where two positions may be those of a
    body in a plane, inputs also push along and across each angle: the thrust of a rotor turns with what it lifts.
    """
    driven = tuple(i.name for i in inputs)
    places = [c for c in coordinates if not c.angle]  # cyclic ones, too: it is the force that turns
    plane = {c.name for pair in combinations(places, 2) if alike(*pair) for c in pair}
    angles = [c.name for c in coordinates if c.angle and not c.cyclic]
    turning = tuple(f"{i}*{f}({a})" for i in driven for a in angles for f in ("cos", "sin"))

    def on(c: Coordinate) -> tuple[str, ...]:
        constant = ("1",) if driven and (c.angle or c.cyclic) else ()
        return (*driven, *constant, *(turning if c.name in plane else ()))

    return {c.name: on(c) for c in coordinates}


def _kinetic(coordinates: Sequence[Coordinate], degree: int, own: bool, sums: Mapping[str, str]) -> Iterator[str]:
    everywhere = tuple(_configuration(coordinates, degree))
    squares = {f"{rate}*{rate}": text for rate, text in sums.items()}
    for a, b in combinations_with_replacement(coordinates, 2):
        rates = f"{a.derivative(1)}*{b.derivative(1)}"
        pair = (a,) if a is b else (a, b)
        for h in _configuration(pair, degree) if own else everywhere:
            yield squares.get(rates, rates) if h == "1" else f"{rates}*{h}"
    if degree > 0:
        yield from (f"{a.name}*{b.derivative(1)}" for a, b in _pairs(coordinates))


def _potential(coordinates: Sequence[Coordinate], powers: int, sums: Mapping[str, str]) -> Iterator[str]:
    low = tuple(h for h in _configuration(coordinates, min(2, powers)) if h != "1")
    between = _between(coordinates) | {f"{name}**2": text for name, text in sums.items()}
    yield from (between.get(h, h) for h in low)
    positions = [c for c in coordinates if not c.angle]
    yield from (between.get(h, h) for h in _configuration(positions, powers) if h != "1" and h not in low)
    turning = [c for c in coordinates if c.angle and not c.cyclic]
    yield from (f"{c.name}**2" for c in turning)
    yield from (f"({_difference(a, b)})**2" for a, b in combinations(turning, 2))


def _between(coordinates: Sequence[Coordinate]) -> dict[str, str]:
    """Return what springs between two positions store, linear and hardening, by the product that each stands for.

    Together with the others they span the same: one coefficient where the products need three and five.
    """
    found = dict[str, str]()
    for a, b in _pairs(coordinates):
        apart = _difference(a, b)
        found |= {f"{a.name}*{b.name}": f"({apart})**2", f"{a.name}**3*{b.name}": f"({apart})**4"}
    return found


def _pairs(coordinates: Sequence[Coordinate]) -> Iterator[tuple[Coordinate, Coordinate]]:
    """Yield every two positions in one unit that are no angles."""
    positions = [c for c in coordinates if not (c.angle or c.cyclic)]
    return ((a, b) for a, b in combinations(positions, 2) if alike(a, b))


def _difference(a: Coordinate, b: Coordinate) -> str:
    return " - ".join(sorted((a.name, b.name)))


def _configuration(coordinates: Sequence[Coordinate], degree: int) -> Iterator[str]:
    """Yield the functions h(q) to a degree, the constant as "1", simple ones first."""
    positions = [c.name for c in coordinates if not (c.angle or c.cyclic)]
    angles = sorted(c.name for c in coordinates if c.angle and not c.cyclic)
    waves = [list(harmonics(angles, d)) for d in range(degree + 1)]
    for total in range(degree + 1):
        for d in range(total + 1):
            for powers, harmonic in product(combinations_with_replacement(positions, total - d), waves[d]):
                factors = [p if n == 1 else f"{p}**{n}" for p, n in Counter(powers).items()]
                yield "*".join([*factors, *harmonic]) or "1"
