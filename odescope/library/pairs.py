"""Functions of two variables together: of difference and sum, of sums with weights, and rates that both limit."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations, product
from types import MappingProxyType

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.constants import Constant
from odescope.library.expression import Term
from odescope.library.families import (
    BELOW,
    EDGES,
    FALL,
    FLAT,
    GROWTH,
    HALF,
    NEGLIGIBLE,
    OFF,
    POINTS,
    RISE,
    constant_of,
    half_range,
    may_be_angle,
)
from odescope.library.parse import Scope, parse_term
from odescope.recordings.checks import is_angular
from odescope.recordings.coordinate import free_name

STEEPEST = 10.0  # weight of a variable within a function, times the range of the variable
WEIGHTS = (0.4, 1.0, 2.5)  # the same, where it is looked for
ADDED = (0.3, 1.0, 3.0, 10.0)  # what an amount at its largest adds to 1 below a rate, where that is looked for
MOST_ADDED = 50.0  # the same, at most
PLACES = (-0.5, 0.0, 0.5, 1.0, 1.5)  # middles of a step, from one end of the range of the sum to the other
NO_UNITS: Mapping[str, str | None] = MappingProxyType({})
LEAST = 0.1  # radians that what has a sine moves over: those of less are lines
MANY = 6  # variables: of more there are too many pairs


@dataclass(frozen=True)
class PairFamily:
    """A function of two variables, its constants, and values of these to look for them at."""

    term: Term
    constants: tuple[Constant, ...] = ()
    points: tuple[tuple[tuple[str, float], ...], ...] = ()


def pair_families(
    values: Mapping[str, FloatArray], taken: Collection[str], units: Mapping[str, str | None] = NO_UNITS
) -> tuple[PairFamily, ...]:
    """Return the functions of pairs of variables that have values on the data.

    What has another unit than an angle is in no sine, and what has two units in no difference.

    Args:
        values: of the variables, by name (N,).
        taken: names that constants may not have.
        units: of the variables, as far as they are known.
    """
    moving = [name for name, v in values.items() if np.isfinite(v).all() and float(np.ptp(v)) > 0.0]
    found = list[PairFamily]()
    for one, other in combinations(moving if len(moving) <= MANY else (), 2):
        found += _plain(one, other, values, units)
        found += _weighted(one, other, values, taken)
        found += _of_difference(one, other, values, taken, units)
        found += _limited(one, other, values, taken)
    return tuple(found)


def may_be_angles(values: Mapping[str, FloatArray], units: Mapping[str, str | None] = NO_UNITS) -> frozenset[str]:
    """Return the variables that may be angles, by themselves or by their difference from another or sum with it.

    What moves next to nothing itself has functions that are lines.
    """
    values = {name: v for name, v in values.items() if is_angular(units.get(name))}
    found = {name for name, v in values.items() if may_be_angle(v)}
    for one, other in combinations(values if len(values) <= MANY else (), 2):
        if may_be_angle(values[one] - values[other]) or may_be_angle(values[one] + values[other]):
            found |= {one, other}
    return frozenset(name for name in found if float(np.ptp(values[name])) > LEAST)


def sines(angles: Collection[str]) -> tuple[Term, ...]:
    """Return sine and cosine of each angle."""
    return tuple(parse_term(f"{f}({name})", Scope.of([name])) for name in sorted(angles) for f in ("sin", "cos"))


def signed_root(one: str, other: str) -> str:
    """Return the root of a difference of two variables, with its sign."""
    return f"sign({one} - {other})*sqrt(abs({one} - {other}))"


def _plain(one: str, other: str, values: Mapping[str, FloatArray], units: Mapping[str, str | None]) -> list[PairFamily]:
    """Return the functions of difference and sum without constants.

    Sine and cosine where these may be angles; of a difference its root, with its sign where that changes, or its size.
    """
    difference, total = values[one] - values[other], values[one] + values[other]
    texts, unit = list[str](), _units_of(one, other, units)
    if len(unit) > 1:
        return []
    for sign, column in (("-", difference), ("+", total)):
        if may_be_angle(column) and all(map(is_angular, unit)):
            texts += [f"sin({one} {sign} {other})", f"cos({one} {sign} {other})"]
    if difference.min() > 0.0:
        texts.append(f"sqrt({one} - {other})")
    elif difference.max() < 0.0:
        texts.append(f"sqrt({other} - {one})")
    else:
        texts += [f"abs({one} - {other})", signed_root(one, other)]
    scope = Scope.of([one, other])
    return [PairFamily(parse_term(text, scope)) for text in texts]


def _units_of(one: str, other: str, units: Mapping[str, str | None]) -> set[str]:
    """Return the units of two variables, as far as they are known."""
    return {u for u in (units.get(one), units.get(other)) if u is not None}


def _weighted(one: str, other: str, values: Mapping[str, FloatArray], taken: Collection[str]) -> list[PairFamily]:
    """Return the logistic function and the exponential of a sum with weights, and where to look for these."""
    ranges = [float(np.ptp(values[name])) for name in (one, other)]
    points, reach = list[tuple[float, float, float]](), 0.0
    pairs = list(product(*([s * w / r for s in (-1.0, 1.0) for w in WEIGHTS] for r in ranges)))
    for first, second in (p for p in pairs if p[0] > 0.0):  # a falling step is a constant less a rising one
        total = first * values[one] + second * values[other]
        low, high = float(total.min()), float(total.max())
        reach = max(reach, abs(low), abs(high))
        points += [(first, second, low + place * (high - low)) for place in PLACES]
    limits = {name: STEEPEST / r for name, r in zip((one, other), ranges, strict=True)}
    step, constants = step_of_sum(limits, reach * 2.0 * STEEPEST / max(WEIGHTS), f"{one}_{other}", taken)
    weights, (a, b, offset) = constants[:-1], (c.name for c in constants)
    growth = parse_term(f"exp({a}*{one} + {b}*{other})", Scope.of([one, other], constants=[a, b]))
    return [
        PairFamily(step, constants, tuple(((a, x), (b, y), (offset, z)) for x, y, z in points)),
        PairFamily(growth, weights, tuple(((a, x), (b, y)) for x, y in pairs)),
    ]


def _of_difference(
    one: str, other: str, values: Mapping[str, FloatArray], taken: Collection[str], units: Mapping[str, str | None]
) -> list[PairFamily]:
    """Return the functions of a difference that have one constant: exponentials and what is left between two limits.

    So a diode conducts, and gears with backlash push. What changes its sign has both.
    """
    difference = values[one] - values[other]
    low, high = float(difference.min()), float(difference.max())
    if len(_units_of(one, other, units)) > 1 or not low < 0.0 < high:
        return []
    constant = partial(constant_of, f"{one}_{other}", taken)
    size, reach, least = max(high, -low), high - low, min(high, -low)
    found = list[tuple[str, Constant]]()
    for role, above, below, most in ((RISE, one, other, high), (FALL, other, one, -low)):
        scale = constant(role, max(most / GROWTH, size / OFF), reach / FLAT)
        found.append((f"exp(({above} - {below})/{scale.name})", scale))
    edge = constant("edge", *(share * least for share in EDGES))
    found.append((f"(abs({edge.name} + {one} - {other}) - abs({edge.name} - {one} + {other}))**1", edge))
    return [_along(c, text, one, other) for text, c in found]


def _along(constant: Constant, text: str, one: str, other: str) -> PairFamily:
    """Return a function of two variables and one constant, which is looked for along all of its range.

    Args:
        constant: the constant.
        text: of the function.
        one: name of a variable.
        other: of the other.
    """
    term = parse_term(text, Scope.of([one, other], constants=[constant.name]))
    return PairFamily(term, (constant,), tuple(((constant.name, v),) for v in constant.evenly(POINTS).tolist()))


def _limited(one: str, other: str, values: Mapping[str, FloatArray], taken: Collection[str]) -> list[PairFamily]:
    """Return the rates of amounts that the other one limits, too, as a competitor for an enzyme does, or of both.

    Both limit in one denominator, or each saturates by itself, as with a substrate and oxygen; or a rate goes with the
    amount of one for each unit of the other (Contois 1959, J. gen. Microbiol. 21, 40), where the two are never next to
    nothing at once. Where one amount follows from the other the fractions in it imitate the saturation of the other:
    each that saturates by itself is there to be compared.
    """
    names, ends = (one, other), [(float(values[n].min()), float(values[n].max())) for n in (one, other)]
    if any(low <= -NEGLIGIBLE * high for low, high in ends):
        return []
    below = tuple(
        Constant(free_name(f"{BELOW}_{n}", taken), 0.0, MOST_ADDED / high, 0.0)
        for n, (_, high) in zip(names, ends, strict=True)
    )
    half = tuple(constant_of(n, taken, HALF, *half_range(*e)) for n, e in zip(names, ends, strict=True))
    total = " + ".join(["1", *(f"{c.name}*{n}" for c, n in zip(below, names, strict=True))])
    saturating = "*".join(f"{n}/({c.name} + {n})" for c, n in zip(half, names, strict=True))
    drawn = [*((f"{above}/({total})", below, 1) for above in (one, other, f"{one}*{other}")), (saturating, half, -1)]
    most, found = [high for _, high in ends], list[PairFamily]()
    for text, constants, power in drawn:
        grid = product(*([(share / high) ** power for share in ADDED] for high in most))
        points = tuple(tuple((c.name, v) for c, v in zip(constants, at, strict=True)) for at in grid)
        scope = Scope.of(names, constants=[c.name for c in constants])
        found.append(PairFamily(parse_term(text, scope), constants, points))
    found += [_along(c, f"{one}*{other}/({c.name} + {n})", one, other) for c, n in zip(half, names, strict=True)]
    if float((values[one] / ends[0][1] + values[other] / ends[1][1]).min()) > NEGLIGIBLE:
        equal = ends[1][1] / ends[0][1]
        ratio = constant_of(f"{one}_{other}", taken, "ratio", equal / OFF, equal * OFF)
        found.append(_along(ratio, f"{one}*{other}/({ratio.name}*{one} + {other})", one, other))
    return found


def step_of_sum(
    limits: Mapping[str, float], reach: float, of: str, taken: Collection[str]
) -> tuple[Term, tuple[Constant, ...]]:
    """Return the logistic function of a sum with weights, and its constants: a weight a variable, then the offset.

    Args:
        limits: largest size of the weight of each variable, by its name.
        reach: largest size of the offset.
        of: whose function it is, or of what: it ends the names of the constants.
        taken: names that constants may not have.
    """
    weights = [Constant(free_name(f"weight_{name}_{of}", taken), -w, w, 0.0) for name, w in limits.items()]
    offset = Constant(free_name(f"offset_{of}", taken), -reach, reach, 0.0)
    total = "".join(f" - {w.name}*{name}" for w, name in zip(weights, limits, strict=True))
    constants = (*weights, offset)
    scope = Scope.of(tuple(limits), constants=[c.name for c in constants])
    return parse_term(f"1/(1 + exp({offset.name}{total}))", scope), constants
