"""Declared rules that thin a library: each says yes or no to a product of basis functions, and prints itself."""

from __future__ import annotations

from typing import Protocol

import msgspec

from odescope.errors import InputError
from odescope.library.expression import Atom, Term
from odescope.library.parse import Scope, parse_term


class Rule(Protocol):
    """What a rule has to offer; one of one's own needs no more."""

    def keeps(self, term: Term, scope: Scope) -> bool:
        """Say whether the product may stay."""
        ...

    def __str__(self) -> str: ...


def _atoms(texts: tuple[str, ...], scope: Scope) -> tuple[Atom, ...]:
    atoms = []
    for text in texts:
        term = parse_term(text, scope)
        if len(term.factors) != 1 or term.factors[0][1] != 1:
            raise InputError(f"a rule speaks of single functions such as sin(phi); {text!r} is a product or a power")
        atoms.append(term.factors[0][0])
    return tuple(atoms)


class MaximumDegree(msgspec.Struct, frozen=True, tag="maximum_degree", tag_field="kind", forbid_unknown_fields=True):
    """The powers of these functions, by size, add up to at most `degree` in a product.

    Attributes:
        of: the functions.
        degree: the bound.
    """

    of: tuple[str, ...]
    degree: int

    def keeps(self, term: Term, scope: Scope) -> bool:
        """Say whether the summed power is within the bound."""
        return sum(abs(term.power_of(atom)) for atom in _atoms(self.of, scope)) <= self.degree

    def __str__(self) -> str:
        return f"{', '.join(self.of)}: degree at most {self.degree}"


class Exclusive(msgspec.Struct, frozen=True, tag="exclusive", tag_field="kind", forbid_unknown_fields=True):
    """At most one of these functions appears in a product (to any power).

    Attributes:
        of: the functions.
    """

    of: tuple[str, ...]

    def keeps(self, term: Term, scope: Scope) -> bool:
        """Say whether no two of the functions meet."""
        return sum(term.power_of(atom) != 0 for atom in _atoms(self.of, scope)) <= 1

    def __str__(self) -> str:
        return f"{', '.join(self.of)}: at most one of them in a product"


class MaximumFactors(msgspec.Struct, frozen=True, tag="maximum_factors", tag_field="kind", forbid_unknown_fields=True):
    """A product has at most `count` distinct functions.

    Attributes:
        count: the bound.
    """

    count: int

    def keeps(self, term: Term, scope: Scope) -> bool:
        """Say whether there are few enough distinct functions."""
        return len(term.factors) <= self.count

    def __str__(self) -> str:
        return f"at most {self.count} distinct functions in a product"


class Identity(msgspec.Struct, frozen=True, tag="identity", tag_field="kind", forbid_unknown_fields=True):
    """The square of this function is a combination of other products, as sin^2 = 1 - cos^2: it appears at most once.

    Attributes:
        of: the function.
    """

    of: str

    def keeps(self, term: Term, scope: Scope) -> bool:
        """Say whether the function appears at most to the first power."""
        return term.power_of(_atoms((self.of,), scope)[0]) <= 1

    def __str__(self) -> str:
        return f"{self.of}: its square follows from an identity, so at most once"


class Unmultiplied(msgspec.Struct, frozen=True, tag="unmultiplied", tag_field="kind", forbid_unknown_fields=True):
    """Of the products with any of these functions, as those of dry friction, only `terms` stay, as they are written.

    Attributes:
        of: the functions.
        terms: the products that stay.
    """

    of: tuple[str, ...]
    terms: tuple[str, ...]

    def keeps(self, term: Term, scope: Scope) -> bool:
        """Say whether none of the functions appears, or the product is one of the terms."""
        if not any(term.power_of(atom) for atom in _atoms(self.of, scope)):
            return True
        return term in {parse_term(text, scope) for text in self.terms}

    def __str__(self) -> str:
        return f"{', '.join(self.of)}: in no products but {', '.join(self.terms)}"


AnyRule = MaximumDegree | Exclusive | MaximumFactors | Identity | Unmultiplied
