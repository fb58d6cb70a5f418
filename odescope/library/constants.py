"""Constants within functions, such as E in exp(-E/T): the range of each, and terms with numbers in their places."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import ONE, Call, Combination, Power, Term
from odescope.library.mechanism import Mechanism, merged
from odescope.library.parse import MAXIMUM_POWER
from odescope.library.product import Product

ALONE, EACH = 300, 8  # points at most of a constant that is alone, and of each of two
LARGEST_EXPONENT = 700.0  # of e, before it overflows
ALIKE = 0.999  # least correlation of a term at neighbouring points of a grid


@dataclass(frozen=True)
class Constant:
    """A constant within functions, between `low` and `high`.

    As a parameter of a likelihood it is a coefficient p, 0 at `nominal`: nominal * e^p where the range has one sign,
    else nominal + p * (high - low). An `optional` one is a parameter where the record asks for it, and nominal
    elsewhere; any other is one wherever a present term names it.
    """

    name: str
    low: float
    high: float
    nominal: float
    optional: bool = False
    grid: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(f"{self.name}: a range from {self.low} to {self.high} holds nothing")

    @property
    def relative(self) -> bool:
        """Whether it is varied by factors."""
        return self.low * self.high > 0.0

    def at(self, coefficient: float) -> float:
        """Return the value of a coefficient, within the range."""
        if self.relative:
            value = self.nominal * math.exp(min(coefficient, LARGEST_EXPONENT))
        else:
            value = self.nominal + coefficient * self.reach
        return min(max(value, self.low), self.high)

    @property
    def reach(self) -> float:
        """Length of the range."""
        return self.high - self.low

    def coefficient(self, value: float) -> float:
        """Return the coefficient of a value."""
        return float(np.log(value / self.nominal) if self.relative else (value - self.nominal) / self.reach)

    @property
    def limits(self) -> tuple[float, float]:
        """The least and the largest coefficient."""
        ends = self.coefficient(self.low), self.coefficient(self.high)
        return min(ends), max(ends)

    @property
    def halved(self) -> Constant:
        """The constant with half the nominal value, in a range that begins at half the least."""
        return replace(self, nominal=0.5 * self.nominal, low=0.5 * self.low)

    def slope(self, value: float) -> float:
        """Return the derivative of the value with respect to the coefficient."""
        return value if self.relative else self.reach

    def evenly(self, points: int) -> FloatArray:
        """Return so many values (points,), away from both ends."""
        share = (np.arange(points) + 0.5) / points
        values: FloatArray = (
            self.low * (self.high / self.low) ** share if self.relative else self.low + share * self.reach
        )
        return values


def grid_of(constants: Sequence[Constant], alone: int = ALONE, each: int = EACH) -> list[dict[str, float]]:
    """Return values of all constants, by name, at every point of their grids, thinned where these would be too many.

    Nothing where there are no constants.

    Args:
        constants: each with its grid.
        alone: points at most of a single constant.
        each: points at most of every one of several.
    """
    many = alone if len(constants) == 1 else each
    grids = [thinned_grid(c.grid, many) for c in constants]
    names = [c.name for c in constants]
    return [dict(zip(names, values, strict=True)) for values in product(*grids)] if constants else []


def thinned_grid(grid: tuple[float, ...], points: int) -> tuple[float, ...]:
    """Return at most so many points of a grid, evenly spread."""
    if len(grid) <= points:
        return grid
    return tuple(grid[int(k)] for k in np.rint((np.arange(points) + 0.5) * len(grid) / points - 0.5))


def grid_for(constant: Constant, columns: FloatArray) -> tuple[float, ...]:
    """Return the values of a constant to look for it at: so far apart that terms at neighbouring ones are still alike.

    Args:
        constant: whose `evenly` spread values are chosen from.
        columns: (points, terms, N) the terms that hold it on the data at these.
    """
    points = len(columns)
    centred = columns - columns.mean(axis=2, keepdims=True)
    centred /= np.maximum(np.linalg.norm(centred, axis=2, keepdims=True), 1e-300)
    chosen, last = list[int](), 0
    while len(apart := np.flatnonzero(np.abs(np.vecdot(centred[last + 1 :], centred[last])).min(axis=1) < ALIKE)):
        before, last = last, last + 1 + int(apart[0])
        chosen.append((before + last) // 2)
    chosen.append((last + points - 1) // 2)
    values = constant.evenly(points)
    return tuple(float(values[k]) for k in dict.fromkeys(chosen))


def mechanism_at(mechanism: Mechanism, values: Mapping[str, float | None]) -> Mechanism:
    """Return a mechanism with numbers for its constants, and sign(v) again where nothing is known of the width.

    Args:
        mechanism: whose terms may name constants.
        values: of all constants, by name; None for one that the record does not ask for.
    """
    if not mechanism.names & set(values):
        return mechanism
    parts, text = [], mechanism.term
    for p in mechanism.parts:
        share, term = term_at(p.product.term, values)
        product = Product(p.product.factor, term)
        parts.append(replace(p, product=product, share=p.share * share))
        text = product.text if mechanism.term == p.product.text and share == 1.0 else text
    return replace(mechanism, parts=merged(parts), term=text)


def term_at(term: Term, values: Mapping[str, float | None]) -> tuple[float, Term]:
    """Return a term with numbers for some names, as a number times a term.

    The number is NaN where the term has no value, as x/K at K = 0.

    Args:
        term: that may name constants.
        values: of constants by name; None makes of tanh(v/w) sign(v) again.
    """
    if not term.names & set(values):
        return 1.0, term
    share, rest = 1.0, ONE
    for atom, power in term.factors:
        if isinstance(atom, Call):
            jump = any(values.get(name, 0.0) is None for name in atom.argument.names)
            inner = [(c, *term_at(t, values)) for c, t in atom.argument.parts]
            if any(np.isnan(k) for _, k, _ in inner):
                return float("nan"), ONE
            argument = Combination.of((c * k, t) for c, k, t in inner)
            function = "sign" if jump and atom.function == "tanh" else atom.function
            factor, raised = _simplified(function, argument)
            share *= _raised(factor, power)
            rest *= Term.of((a, p * power) for a, p in raised.factors)
        elif atom.name in values:
            value = values[atom.name]
            share *= 1.0 if value is None else _raised(value, power)
        else:
            rest *= Term(((atom, power),))
    return share, rest


def _raised(base: float, power: Power) -> float:
    """Return a power, NaN where that is no real number."""
    none = (base == 0.0 and power < 0) or (base < 0.0 and power != round(power))
    return float("nan") if none else float(base**power)


def _simplified(function: str, argument: Combination) -> tuple[float, Term]:
    """Return a function of an argument as a number times a term: exp(2.5*log(x)) is x**2.5."""
    if not argument.names:
        value = sum(c for c, _ in argument.parts)
        return (value if not function else float(getattr(np, function)(value))), ONE
    if not function and len(argument.parts) == 1:
        return argument.parts[0]
    if function == "exp" and len(argument.parts) == 1 and (found := _power(*argument.parts[0])) is not None:
        return found
    return 1.0, Term(((Call(function, argument), 1),))


def _power(power: float, inner: Term) -> tuple[float, Term] | None:
    """Return exp(power*log(scale*a)) as scale**power times a**power, None where that is not the same or cannot be read.

    The logarithm of a square, or of minus a number, says that its argument is positive; of a fractional power of what
    stands there nothing does.
    """
    if len(inner.factors) != 1 or inner.factors[0][1] != 1 or abs(power) > MAXIMUM_POWER:
        return None
    logarithm = inner.factors[0][0]
    if not isinstance(logarithm, Call) or logarithm.function != "log" or len(logarithm.argument.parts) != 1:
        return None
    ((scale, base),) = logarithm.argument.parts
    if not scale > 0.0 or len(base.factors) != 1 or base.factors[0][1] != 1:
        return None
    return scale**power, Term.of([(base.factors[0][0], power)])
