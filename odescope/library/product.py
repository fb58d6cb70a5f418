"""Product: a target or 1, times a term. The one spelling of what stands behind a coefficient of a relation.

Columns of a regression, terms of a model's relations and parameters of a likelihood are all coefficients of products.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

from odescope.errors import InputError
from odescope.library.expression import ONE, Name, Term


@dataclass(frozen=True)
class Product:
    """factor * term; the factor is a target's name, or None for 1, and the term holds no target."""

    factor: str | None
    term: Term = ONE

    def __hash__(self) -> int:
        return hash((self.factor, self.term))

    @property
    def bare(self) -> bool:
        """Whether it is a target alone."""
        return self.factor is not None and self.term == ONE

    @cached_property
    def text(self) -> str:
        """Python syntax: the target first."""
        if self.factor is None:
            return self.term.text
        return self.factor if self.bare else f"{self.factor}*{self.term.text}"

    def __str__(self) -> str:
        return self.text

    def __mul__(self, term: Term) -> Product:
        return Product(self.factor, self.term * term)

    @cached_property
    def expanded(self) -> Term:
        """The same as one term, of which the target is a factor."""
        return self.term if self.factor is None else self.term * Term(((Name(self.factor), 1),))

    @cached_property
    def degree(self) -> float:
        """The powers of the term, by size, added up."""
        return sum(abs(power) for _, power in self.term.factors)

    @staticmethod
    def of(term: Term, targets: Collection[str]) -> Product:
        """Return the product that a term is, given which names are targets.

        Raises:
            InputError: a target appears to a power, inside a function, or beside another target.
        """
        found = term.names & set(targets)
        if not found:
            return Product(None, term)
        name = min(found)
        rest = Term(tuple(f for f in term.factors if f[0] != Name(name)))
        if len(found) > 1 or term.power_of(Name(name)) != 1 or name in rest.names:
            raise InputError(f"the candidate {term} is not linear in the targets: {', '.join(sorted(found))}")
        return Product(name, rest)
