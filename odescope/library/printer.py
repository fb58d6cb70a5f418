"""The one walk over a term: a language says what becomes of its parts, so that a further language is a table.

LaTeX (latex.py), MathML (mathml.py), code (export/languages), units (report/units.py) and the instructions that compute
values (tape.py) are tables of this kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from odescope.library.expression import Atom, Combination, Name, Power, Term
from odescope.library.extremes import Extreme

T = TypeVar("T")


@dataclass(frozen=True)
class Language(Generic[T]):
    """What becomes of the parts of a term: text of type str, or whatever else can be built bottom up.

    Attributes:
        name: of a state, target or input, to a power.
        call: of a function's name and its argument, to a power.
        group: of a sum that stands in a product, to a power.
        product: of the factors of a term, of which there may be none.
        sum: of coefficients and what they multiply, of which there may be none.
        fraction: of a numerator and a denominator; without one, a factor in a denominator has a negative power.
        extreme: of "max" or "min" and its two arguments, to a power; without one, it is the sum that it stands for.
    """

    name: Callable[[str, Power], T]
    call: Callable[[str, T, Power], T]
    group: Callable[[T, Power], T]
    product: Callable[[Iterable[T]], T]
    sum: Callable[[Iterable[tuple[float, T]]], T]
    fraction: Callable[[T, T], T] | None = None
    extreme: Callable[[str, T, T, Power], T] | None = None


def print_term(language: Language[T], term: Term) -> T:
    """Return a term in a language."""
    return print_product(language, None, term)


def print_combination(language: Language[T], combination: Combination) -> T:
    """Return a linear combination of terms in a language."""
    return language.sum((c, print_term(language, term)) for c, term in combination.parts)


def print_product(language: Language[T], factor: str | None, term: Term) -> T:
    """Return factor * term in a language.

    Args:
        language: to print in.
        factor: name of a target, or None for 1.
        term: what it multiplies.
    """
    fraction = language.fraction
    over = [_print_factor(language, a, power) for a, power in term.factors if fraction is None or power > 0]
    under = [_print_factor(language, a, -power) for a, power in term.factors if fraction is not None and power < 0]
    whole = language.product(over if factor is None else [language.name(factor, 1), *over])
    return whole if fraction is None or not under else fraction(whole, language.product(under))


def _print_factor(language: Language[T], atom: Atom, power: Power) -> T:
    if isinstance(atom, Name):
        return language.name(atom.name, power)
    found = Extreme.read(atom.argument) if language.extreme is not None and not atom.function else None
    if language.extreme is not None and found is not None:
        first, second = (print_combination(language, c) for c in (found.first, found.second))
        return language.extreme(found.name, first, second, power)
    inside = print_combination(language, atom.argument)
    return language.call(atom.function, inside, power) if atom.function else language.group(inside, power)
