"""The derivative of a term: product rule, chain rule, and the rows of `functions`."""

from __future__ import annotations

from functools import cache, lru_cache

from odescope.library.expression import Atom, Call, Combination, Name, Power, Term
from odescope.library.functions import FUNCTIONS
from odescope.library.parse import Scope, parse_combination

_ARGUMENT = Name("z")  # what the derivatives in the rows call the argument


@lru_cache(maxsize=8192)
def derivative(term: Term, name: str) -> Combination:
    """Return the partial derivative of a term with respect to a state, target or input.

    Searches ask for the same few hundred with every model they try.
    """
    parts: list[tuple[float, Term]] = []
    for atom, power in term.factors:
        rest = term.over(atom)
        parts += [(power * c, rest * inner) for c, inner in _of_atom(atom, name).parts]
    return Combination.of(parts)


def slope(combination: Combination, name: str) -> Combination:
    """Return the partial derivative of a combination with respect to a state, target or input."""
    return Combination.of((c * k, t) for c, term in combination.parts for k, t in derivative(term, name).parts)


def _of_atom(atom: Atom, name: str) -> Combination:
    if isinstance(atom, Name):
        return Combination(((1.0, Term()),)) if atom.name == name else Combination()
    inner = slope(atom.argument, name)
    if not atom.function or not inner.parts:
        return inner
    outer = _substituted(_of_function(atom.function), atom.argument)
    return Combination.of((c * k, f * t) for c, f in outer.parts for k, t in inner.parts)


@cache
def _of_function(function: str) -> Combination:
    """Return the derivative of a function, in the name z."""
    return parse_combination(FUNCTIONS[function].derivative, Scope.of([_ARGUMENT.name]))


def _substituted(combination: Combination, argument: Combination) -> Combination:
    """Return a combination of functions of z, with `argument` in place of z."""
    parts: list[tuple[float, Term]] = []
    for c, term in combination.parts:
        if term.factors == ((_ARGUMENT, 1),):
            parts += [(c * k, t) for k, t in argument.parts]
        else:
            parts.append((c, Term.of(f for atom, power in term.factors for f in _factors(atom, power, argument))))
    return Combination.of(parts)


def _factors(atom: Atom, power: Power, argument: Combination) -> tuple[tuple[Atom, Power], ...]:
    if isinstance(atom, Call):
        return ((Call(atom.function, _substituted(atom.argument, argument)), power),)
    # z as a factor is a lone product itself, and not an atom around it.
    if len(argument.parts) == 1 and argument.parts[0][0] == 1.0:
        return tuple((own, p * power) for own, p in argument.parts[0][1].factors)
    return ((Call("", argument), power),)
