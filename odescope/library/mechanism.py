"""Mechanism: one coefficient and all that it multiplies, in one relation or in several.

A term of an energy, a reaction, a tie are mechanisms of several parts; a plain candidate is one of a single part. What
else a record may ask for has a coefficient and no part: the offset of a sensor, the delay of an input, a constant
within functions. Such a coefficient is 0 where the record does not ask for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from odescope.library.product import Product

Kind = Literal["term", "kinetic", "potential", "dissipation", "force", "reaction", "tie", "offset", "delay", "constant"]

FORCE_ON = " on "  # between the term of a force and the coordinate that it acts on, in its name


@dataclass(frozen=True)
class Part:
    """share * product, in one relation."""

    relation: int
    product: Product
    share: float = 1.0


@dataclass(frozen=True)
class Mechanism:
    """coefficient * parts: what it adds to the relations, whose sums are zero.

    Attributes:
        kind: what it is a term of.
        term: what the coefficient stands before, as text: a product, a term of an energy, the flux of a reaction.
        place: where that is: the target of its relation, or the kind; of what has no part, the coordinate, input or
            constant that it belongs to.
        parts: one a relation and product.
        size: how elaborate it is; laws are simple, so every step of it halves the prior.
        name: by which people know it, such as S + E -> C or u on x; the term where it has none of its own.
        known: its coefficient, where that is given; None where it is looked for.
    """

    kind: Kind
    term: str
    place: str
    parts: tuple[Part, ...]
    size: float
    name: str = ""
    known: float | None = None

    @cached_property
    def names(self) -> frozenset[str]:
        """The states, inputs and constants in its terms."""
        return frozenset[str]().union(*(p.product.term.names for p in self.parts))

    @property
    def relations(self) -> frozenset[int]:
        """The relations that it stands in."""
        return frozenset(p.relation for p in self.parts)

    def __str__(self) -> str:
        if self.kind == "reaction":  # fluxes are those of several
            return self.name
        return f"{self.term} in {self.place}" if self.parts else self.term


def candidate(relation: int, product: Product, target: str) -> Mechanism:
    """Return the mechanism of a single part.

    Args:
        relation: where it stands.
        product: what it is.
        target: of that relation.
    """
    size = (product.factor is not None) + product.degree
    return Mechanism("term", product.text, target, (Part(relation, product),), size)


def merged(parts: Iterable[Part]) -> tuple[Part, ...]:
    """Return parts of which no two have the same relation and product, those that cancel left out."""
    shares: dict[tuple[int, Product], float] = {}
    for part in parts:
        key = (part.relation, part.product)
        shares[key] = shares.get(key, 0.0) + part.share
    return tuple(Part(r, product, share) for (r, product), share in shares.items() if share != 0.0)


def candidates_of(libraries: Sequence[Sequence[Product]], targets: Sequence[str]) -> tuple[Mechanism, ...]:
    """Return the plain candidates of every relation, given the products of each."""
    return tuple(
        candidate(r, product, target)
        for r, (products, target) in enumerate(zip(libraries, targets, strict=True))
        for product in products
    )


def scale_groups(mechanisms: Sequence[Mechanism], present: Iterable[int]) -> list[tuple[int, ...]]:
    """Return the present mechanisms that have parts, in groups that have no relation in common, ascending.

    All coefficients of a group may be multiplied by one number: its relations say the same.

    Args:
        mechanisms: all candidates.
        present: numbers of those in the model.
    """
    groups: list[tuple[frozenset[int], list[int]]] = []
    for k in present:
        if not mechanisms[k].parts:
            continue
        relations, members, apart = mechanisms[k].relations, [int(k)], []
        for other, others in groups:
            if other & relations:
                relations, members = relations | other, members + others
            else:
                apart.append((other, others))
        groups = [*apart, (relations, members)]
    return [tuple(sorted(members)) for _, members in groups]
