"""Combinations written out, so that what is equal is spelt alike: brackets multiplied out, abs(z)*sign(z) as z."""

from __future__ import annotations

from odescope.errors import InputError
from odescope.library.expression import Call, Combination, Term

MAXIMUM_PRODUCTS = 1000


def expanded(combination: Combination) -> Combination:
    """Return the same combination, its brackets to the first power multiplied out and abs(z)*sign(z) written z.

    Higher powers of brackets stay: (x - 3.0)**3 written out would lose digits where x is near 3.

    Raises:
        InputError: there would be more than 1000 products.
    """
    done, waiting = list[tuple[float, Term]](), list(combination.parts)
    while waiting:
        coefficient, term = waiting.pop()
        opened = _opened(term)
        if opened is None:
            done.append((coefficient, term))
        else:
            rest, inner = opened
            waiting += [(coefficient * c, rest * t) for c, t in inner.parts]
        if len(done) + len(waiting) > MAXIMUM_PRODUCTS:
            raise InputError(f"multiplied out, it has more than {MAXIMUM_PRODUCTS} products")
    return Combination.of(done)


def _opened(term: Term) -> tuple[Term, Combination] | None:
    """Return a term as a product of a rest and a combination, None where it is written out."""
    for atom, power in term.factors:
        if not isinstance(atom, Call) or power != 1:
            continue
        if not atom.function:
            return term * Term.of([(atom, -1)]), atom.argument
        size = Call("abs", atom.argument)
        if atom.function == "sign" and term.power_of(size) >= 1:
            return term * Term.of([(atom, -1), (size, -1)]), atom.argument
    return None
