"""Functions of one variable that its powers and fractions may imitate: which the data allow, and their constants."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.constants import Constant, grid_for, thinned_grid
from odescope.library.expression import Name, Term
from odescope.library.parse import Scope, parse_term
from odescope.library.tape import evaluate, write_tape
from odescope.recordings.checks import is_angular
from odescope.recordings.coordinate import free_name

FINEST = 200  # values of a constant that are compared, from one end of its range to the other
SEEN = 200  # samples on which they are
EXPONENTS = (0.2, 4.0)
ORDERS = (1.2, 12.0)  # of Hill's function: at 1 it is a saturation
NEGLIGIBLE = 0.05  # of the largest value: a quantity that is never further below zero is one that has no sign
STEEP = 200.0  # times as wide as a step of tanh or of a logistic function the range of its variable may be
GROWTH = 30.0  # largest argument of an exponential, over the range of its variable, or to one side of what has a sign,
WAVES = 12.0  # and of a sine
MOSTLY = 0.9  # of the samples, that have the least or the largest value
ARC, TURNS = 0.4, 60.0  # radians that an angle moves over: over less its functions are powers
STEERED = 1.4  # radians: the tangent of an angle that is turned further is a pole
BEYOND = 1.0  # of the range of its variable: how far outside of it the middle of a step may be
FLAT = 0.3  # least one
POLE = 2.0  # times as far below zero as noise takes what has no sign the pole of a saturation is, at least
EDGES = (0.05, 0.95)  # of a limit to both sides, over the smaller of what its variable reaches on either side
SLOW = 0.5  # of the largest speed: above it friction at rest is not told from dry friction
BENDS = (0.02, 0.98)  # quantiles of its variable that the place of a bend is between
HEADS = (0.005, 3.0)  # of the range of its variable: how far outside of it a root may end
GAPS = (0.02, 10.0)  # of the range of its variable: how far outside of it a pole may be
CRITICAL = (0.1, 3.0)  # of its largest size: where what falls again with a speed may be largest
OFF = 100.0  # largest exponent, by size
POINTS = 24  # of a grid, at most: fits go on from the best
ABOVE_ZERO = {"K": 0.0, "kelvin": 0.0, "°C": 273.15, "degC": 273.15, "celsius": 273.15}  # kelvins, at 0 of each unit
RATE = "rate"  # how the constant of a sine is called, before the name of its variable
RISE = "rise"  # how the constant of an exponential is called, before the name of its variable,
FALL = "fall"  # and of one that falls as what has a sign grows: it has a scale of its own
HALF = "half"  # how the constant of a saturation is called, before the name of its variable
BELOW = "below"  # how that of an amount is called which is one of several in the denominator of a rate
STRIBECK = "stribeck"  # how the constant of Stribeck's curve is called, before the name of the speed
ACTIVATION = "activation"  # how the constant of Arrhenius' law is called, before the name of the temperature
ENERGIES = (500.0, 50_000.0)  # of activation over the gas constant, in kelvins: 4 to 416 kJ/mol

POLES = ("before", "behind")  # how the constants of poles are called, before the name of their variable
LARGEST_AT = "critical"  # how that of what falls again is called
FILLED = "filled"  # how that of what fills up as an exponential does is called
BEND = "bend"  # how the place of a bend is called
ORDER = "order"  # how the exponent of Hill's rate is called

Drawn = tuple[str, tuple[Constant, ...]]  # a function as text, and its constants


@dataclass(frozen=True)
class Family:
    """A function of one variable, with the constants within it."""

    variable: str
    term: Term
    constants: tuple[Constant, ...]

    @property
    def falls(self) -> bool:
        """Whether it is an exponential that falls as its variable grows."""
        return self._scaled and self.term.text.startswith("exp(-")

    @property
    def rises(self) -> bool:
        """Whether it is an exponential that grows with its variable."""
        return self._scaled and self.term.text.startswith("exp(") and not self.falls

    @property
    def _scaled(self) -> bool:
        return any(c.name.startswith((f"{RISE}_", f"{FALL}_")) for c in self.constants)

    def suits(self, squared: bool, divided: bool, position: bool) -> bool:
        """Say whether it may be in a relation: what has a square below it only where something divides.

        Forces go with gaps and distances: what has a pole is of a position.

        Args:
            squared: whether a square of the variable divides the relation.
            divided: whether the variable does.
            position: whether it is one.
        """
        pole, falls = (any(c.name.startswith(r) for c in self.constants) for r in (POLES, LARGEST_AT))
        if pole or self.term.power_of(Name(self.variable)) < 0:
            return position and (divided or not pole)
        return squared or not falls


def laid_out(
    constant: Constant, constants: Sequence[Constant], terms: Sequence[Term], names: Sequence[str], values: FloatArray
) -> Constant:
    """Return a constant with the grid that it is looked for on, the others in the middle of their ranges.

    Args:
        constant: one of those.
        constants: all that the terms hold.
        terms: functions that hold it.
        names: of the variables.
        values: (variables, N) of these.
    """
    seen = values[:, :: -(-values.shape[1] // SEEN)]
    tape = write_tape([*names, *(c.name for c in constants)], terms)
    tried, samples = constant.evenly(FINEST), seen.shape[1]
    rows = [np.tile(column, len(tried)) for column in seen]
    rows += [
        np.repeat(tried if c.name == constant.name else np.full(len(tried), c.nominal), samples) for c in constants
    ]
    columns = evaluate(tape, np.array(rows)).reshape(len(terms), len(tried), samples).swapaxes(0, 1)
    return replace(constant, grid=grid_for(constant, np.nan_to_num(columns, posinf=0.0, neginf=0.0)))


def may_be_angle(values: FloatArray) -> bool:
    """Say whether values (N,) may be an angle in radians, called so or not, of which functions tell.

    What never comes within a turn of zero, such as a temperature in a room, is none, nor what is switched.
    """
    near = ARC < float(np.ptp(values)) < TURNS and float(np.abs(values).min()) < 2.0 * np.pi
    return near and not is_switched(values)


def is_switched(values: FloatArray) -> bool:
    """Say whether values (N,) are but two, as of a valve or a binary test signal: all functions of these are lines.

    Averages over a step lie between the two.
    """
    ends = (values == values.min()) | (values == values.max())
    return float(ends.mean()) >= MOSTLY


def families_of(
    variable: str, values: FloatArray, taken: Collection[str], angle: bool | None = None, unit: str | None = None
) -> tuple[Family, ...]:
    """Return the functions of a variable that have values on the data, those without constants first.

    Of what has no sign (a level, a concentration, a temperature) there are root, logarithm, powers, saturation and the
    rates of Hill, what they leave of one, as of a gene that is repressed, and Haldane's rate, of what is always
    negative (a depth) those of its size, and what fills up as an exponential does; of both what goes with the square of
    its reciprocal, as gravity; of what changes its sign the size, the square with its sign, twice what is left of it
    between two limits, and the hyperbolic sine, as of two diodes or an electrode; of all exponentials, tanh, the
    logistic function and sines, those of the variable itself where it may be an angle. Of a temperature, by its unit,
    there are Arrhenius' law, about the middle of its range, and the fourth power of what it is above absolute zero, as
    it radiates. What hardly moves beside its size has no tanh, and further still no exponentials, which would be lines.

    Args:
        variable: its name.
        values: (N,) on the data.
        taken: names that constants may not have.
        angle: whether it may be an angle, which its unit and its values tell if nothing else does.
        unit: that it is in, None where that is not known.
    """
    low, high = float(values.min()), float(values.max())
    size, reach = max(abs(low), abs(high)), high - low
    if not (reach > 0.0 and np.isfinite(reach)) or is_switched(values):
        return ()

    constant = partial(constant_of, variable, taken)
    scale = constant("scale", reach / STEEP, reach / FLAT)
    rate = constant(RATE, 1.0 / reach, WAVES / reach)
    slope = constant("slope", 1.0 / reach, 2.0 * STEEP / reach)
    middle = constant("middle", low - BEYOND * reach, high + BEYOND * reach)
    least = low if high > -low else -high
    drawn = list(_by_sign(variable, low, high, constant))
    drawn += _by_ends(variable, low, high, constant)
    if is_angular(unit) and may_be_angle(values) if angle is None else angle:
        drawn += [(f"sin({variable})", ()), (f"cos({variable})", ())]
        drawn += [(f"tan({variable})", ())] if size < STEERED else []
    for kelvins, inverse, largest in _kelvins(variable, unit, low, high):
        energy = constant(ACTIVATION, ENERGIES[0], largest)
        drawn += [
            (f"exp({energy.name}*({inverse:.3g} - 1/({kelvins})))", (energy,)),
            (f"({kelvins})**4", ()),
        ]
    if least < reach:
        drawn.append((f"tanh({variable}/{scale.name})", (scale,)))
    if size / OFF < reach / FLAT:
        signed = least < -NEGLIGIBLE * size
        up, down = (high, -low) if signed else (reach, reach)
        gentle = constant(RISE, max(up / GROWTH, size / OFF), reach / FLAT)
        fall = constant(FALL if signed else RISE, max(down / GROWTH, size / OFF), reach / FLAT)
        drawn += [(f"exp({variable}/{gentle.name})", (gentle,)), (f"exp(-{variable}/{fall.name})", (fall,))]
        drawn += [(f"sinh({variable}/{gentle.name})", (gentle,))] if signed else []
    drawn += [
        (f"sin({rate.name}*{variable})", (rate,)),
        (f"cos({rate.name}*{variable})", (rate,)),
        (f"1/(1 + exp(-{slope.name}*({variable} - {middle.name})))", (slope, middle)),
    ]
    return tuple(_family(variable, text, constants, values) for text, constants in drawn)


def _by_ends(
    variable: str, low: float, high: float, constant: Callable[[str, float, float], Constant]
) -> Iterator[Drawn]:
    """Yield the functions that end outside of the data, roots and poles, and the pole at zero of what has a sign.

    Args:
        variable: its name.
        low: its least value.
        high: its largest.
        constant: makes one of a role, from the least to the largest.
    """
    near, far = (share * (high - low) for share in HEADS)
    head, supply = constant("head", near - low, far - low), constant("supply", high + near, high + far)
    yield from ((f"sqrt({head.name} + {variable})", (head,)), (f"sqrt({supply.name} - {variable})", (supply,)))
    if low * high > 0.0:
        yield f"1/{variable}**2", ()
    near, far = (share * (high - low) for share in GAPS)
    before, behind = constant(POLES[0], near - low, far - low), constant(POLES[1], high + near, high + far)
    yield from ((f"1/({before.name} + {variable})**2", (before,)), (f"1/({behind.name} - {variable})**2", (behind,)))


def _by_sign(
    variable: str, low: float, high: float, constant: Callable[[str, float, float], Constant]
) -> Iterator[Drawn]:
    """Yield the functions that what has no sign has, and what has one.

    Rates with two constants are Hill's (1910), J. Physiol. 40, iv, and Haldane's (1930), Enzymes, of a substrate that
    inhibits, of microorganisms Andrews (1968), Biotechnol. Bioeng. 10, 707.

    Args:
        variable: its name.
        low: its least value.
        high: its largest.
        constant: makes one of a role, from the least to the largest.
    """
    least, largest = (low, high) if high > -low else (-high, -low)
    critical = constant(LARGEST_AT, *(share * largest for share in CRITICAL))
    yield f"{variable}/({critical.name}**2 + {variable}**2)", (critical,)
    amount, plus = (variable, "+") if high > -low else (f"(-{variable})", "-")
    if least > 0.0:
        power = constant("exponent", *EXPONENTS)
        yield from ((f"sqrt({amount})", ()), (f"log({amount})", ()))
        yield from ((f"{amount}**{power.name}", (power,)), (f"{amount}**(-{power.name})", (power,)))
    elif least > -NEGLIGIBLE * largest:
        amount = f"abs({variable})"  # which noise alone takes below zero
        yield f"sign({variable})*sqrt({amount})", ()  # an empty tank stays empty: without the sign it would run away
    if least > -NEGLIGIBLE * largest:
        # What is not half saturated at the largest amount is a power, or a polynomial.
        level, order = constant("level", largest / OFF, largest), constant(ORDER, *ORDERS)
        raised = f"{amount}**{order.name}"
        for above in (raised, f"{level.name}**{order.name}"):  # what activates, and what represses
            yield f"{above}/({level.name}**{order.name} + {raised})", (level, order)
        half = constant(HALF, *half_range(least, largest))
        for above in (variable, half.name):
            yield f"{above}/({half.name} {plus} {variable})", (half,)
        filled = constant(FILLED, largest / OFF, largest / FLAT)
        yield f"(1 - exp(-{amount}/{filled.name}))**1", (filled,)
        affinity = constant("affinity", half.low, half.high)
        inhibition = constant("inhibition", largest / OFF, largest / FLAT)
        yield (
            f"{variable}/({affinity.name} {plus} {variable} + {variable}**2/{inhibition.name})",
            (affinity, inhibition),
        )
    else:
        yield from ((f"abs({variable})", ()), (f"{variable}*abs({variable})", ()))
        edge = constant("edge", EDGES[0] * -least, EDGES[1] * -least)
        yield f"(abs({edge.name} + {variable}) - abs({edge.name} - {variable}))**1", (edge,)


def bends(variable: str, values: FloatArray, taken: Collection[str]) -> tuple[Family, ...]:
    """Return what is zero to one side of a place and a line to the other, rising or falling.

    As a stop pushes that is reached, a weir spills, a valve opens, or a command stays where it saturates.

    Args:
        variable: its name.
        values: (N,) on the data.
        taken: names that the constant may not have.
    """
    low, high = (float(q) for q in np.quantile(values, BENDS))
    if not low < high or is_switched(values):
        return ()
    bend = constant_of(variable, taken, BEND, low, high)
    sides = f"{variable} - {bend.name}", f"{bend.name} - {variable}"
    return tuple(_family(variable, f"max({side}, 0)", (bend,), values) for side in sides)


def half_range(least: float, largest: float) -> tuple[float, float]:
    """Return the range of the amount that half saturates a rate, from the least and the largest in the data."""
    return max(largest / OFF, -POLE * least), largest / FLAT


def stribeck(speed: str, values: FloatArray, taken: Collection[str]) -> Family:
    """Return what is left at a speed of that by which friction at rest exceeds dry friction, to be multiplied by this.

    Stribeck's curve (1902) as Bo and Pavelescu (1982), Wear 82, 277, write it, with an exponent of 2.

    Args:
        speed: name of the variable.
        values: (N,) on the data.
        taken: names that the constant may not have.
    """
    size = float(np.abs(values).max())
    constant = constant_of(speed, taken, STRIBECK, size / STEEP, SLOW * size)
    return _family(speed, f"exp(-{speed}**2/{constant.name}**2)", (constant,), values)


def constant_of(variable: str, taken: Collection[str], role: str, least: float, largest: float) -> Constant:
    """Return a constant of a function of a variable.

    Args:
        variable: its name, or those of several.
        taken: names that the constant may not have.
        role: of the constant in the function.
        least: its least value.
        largest: its largest.
    """
    made = Constant(free_name(f"{role}_{variable}", taken), least, largest, least)
    return replace(made, nominal=float(made.evenly(1)[0]))


def _kelvins(variable: str, unit: str | None, low: float, high: float) -> Iterator[tuple[str, float, float]]:
    """Yield a temperature in kelvins as text, the inverse of one in the middle, and the largest energy of activation.

    About the middle the factor of Arrhenius' law and its energy can be told apart. Nothing for what is no temperature.

    Args:
        variable: its name.
        unit: that it is in.
        low: its least value.
        high: its largest.
    """
    zero = ABOVE_ZERO.get(unit or "")
    if zero is None or low + zero <= 0.0:
        return
    inverse = 1.0 / (low + zero), 1.0 / (high + zero)
    largest = min(ENERGIES[1], OFF / (inverse[0] - inverse[1]))
    if largest > ENERGIES[0]:
        yield in_kelvins(variable, zero), sum(inverse) / 2.0, largest


def in_kelvins(variable: str, zero: float) -> str:
    """Return a temperature in kelvins as text, from the kelvins at 0 of its unit."""
    return f"{variable} + {zero!r}" if zero else variable


def _family(variable: str, text: str, constants: tuple[Constant, ...], values: FloatArray) -> Family:
    names = [c.name for c in constants]
    term = parse_term(text, Scope.of([variable], constants=names))
    found = tuple(laid_out(c, constants, [term], [variable], values[None]) for c in constants)
    return Family(variable, term, tuple(replace(c, grid=thinned_grid(c.grid, POINTS)) for c in found))
