"""Relation: a sum of terms that is zero, each a coefficient times a product."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec

from odescope.library.expression import Combination, Term
from odescope.library.mechanism import Kind
from odescope.library.product import Product

NORMAL = 1.959963984540054  # of a standard normal, 97.5 %


@dataclass(frozen=True)
class RelationTerm:
    """coefficient * product."""

    product: Product
    coefficient: float
    std_error: float | None = None

    @property
    def factor(self) -> str | None:
        """The target in the product, None for 1."""
        return self.product.factor

    @property
    def term(self) -> Term:
        """The product without its target."""
        return self.product.term

    @property
    def text(self) -> str:
        """The product in Python syntax."""
        return self.product.text

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval of the coefficient, None without a standard error."""
        return interval_of(self.coefficient, self.std_error)


def interval_of(coefficient: float, std_error: float | None) -> tuple[float, float] | None:
    """Return the 95 % interval of a coefficient, None without a standard error."""
    return None if std_error is None else (coefficient - NORMAL * std_error, coefficient + NORMAL * std_error)


class FoundMechanism(msgspec.Struct, frozen=True):
    """A mechanism of a model: a term of an energy, a force, a reaction, with its coefficient and standard error.

    `name` is that of a reaction, such as S + E -> C, or says on what a force acts, as in u on x; it is the term of
    energies, and the text of a tie. Relations hold what all of them add up to.
    """

    name: str
    kind: Kind
    term: str
    coefficient: float
    std_error: float | None = None

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval of the coefficient, None without a standard error."""
        return interval_of(self.coefficient, self.std_error)


class FoundParameter(msgspec.Struct, frozen=True):
    """A constant within functions, its standard error, and the terms of the relations that hold it, as a number.

    `written` are the same terms with the names of constants, as people read them.
    """

    name: str
    value: float
    std_error: float | None
    terms: tuple[str, ...]
    written: tuple[str, ...] = ()


@dataclass(frozen=True)
class Relation:
    """The sum of its terms is zero; one target term has coefficient 1."""

    terms: tuple[RelationTerm, ...]

    def part(self, factor: str | None) -> Combination:
        """Return what multiplies `factor`."""
        return Combination.of((t.coefficient, t.term) for t in self.terms if t.factor == factor)

    @property
    def left(self) -> tuple[RelationTerm, ...]:
        """What stands on the left where the targets do: the terms with one."""
        return tuple(t for t in self.terms if t.factor is not None)

    @property
    def divided(self) -> Relation:
        """The same, divided by what multiplies its target where that is one product: as people write it."""
        return self.times(self.left[0].term.inverse) if len(self.left) == 1 else self

    def times(self, by: Term) -> Relation:
        """Return the relation multiplied by a product without a target."""
        return Relation(tuple(replace(t, product=t.product * by) for t in self.terms)) if by.factors else self

    @property
    def targets(self) -> tuple[str, ...]:
        """The targets that it holds, each once, that of the term with coefficient 1 first."""
        first = sorted(self.left, key=lambda t: t.coefficient != 1.0)
        return tuple(dict.fromkeys(t.factor for t in first if t.factor is not None))

    @property
    def right(self) -> Combination:
        """What stands on the right where the targets stand on the left: the terms without one, negated."""
        return Combination(tuple((-c, term) for c, term in self.part(None).parts))


def in_order(relations: Sequence[Relation], targets: Sequence[str]) -> tuple[Relation, ...]:
    """Return relations so that each holds the target that it stands for, as whoever writes them by hand may not.

    They stay as they are where they do so already, as coupled ones do in any order, or where they cannot: then two
    targets stand in one relation alone.

    Args:
        relations: as many as targets.
        targets: in their order.
    """
    if all(target in r.targets for target, r in zip(targets, relations, strict=True)):
        return tuple(relations)
    taken = dict[str, Relation]()

    def placed(relation: Relation, tried: set[str]) -> bool:
        """Say whether a relation found a target, moving others to others of theirs (an augmenting path)."""
        for target in relation.targets:
            if target not in tried:
                tried.add(target)
                if target not in taken or placed(taken[target], tried):
                    taken[target] = relation
                    return True
        return False

    whole = all(placed(relation, set()) for relation in relations)
    return tuple(taken[target] for target in targets) if whole else tuple(relations)
