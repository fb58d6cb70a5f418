"""Relation: a sum of terms that is zero, each a coefficient times a target or 1, times a product."""

from __future__ import annotations

from dataclasses import dataclass

from odescope.library.expression import Combination, Term

NORMAL = 1.959963984540054  # of a standard normal, 97.5 %


@dataclass(frozen=True)
class RelationTerm:
    """coefficient * factor * term; factor is a target or None, which means 1."""

    factor: str | None
    term: Term
    coefficient: float
    std_error: float | None = None

    @property
    def text(self) -> str:
        """The product of factor and term in Python syntax."""
        if self.factor is None:
            return self.term.text
        return self.factor if not self.term.factors else f"{self.factor}*{self.term.text}"

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval of the coefficient, None without a standard error."""
        if self.std_error is None:
            return None
        return self.coefficient - NORMAL * self.std_error, self.coefficient + NORMAL * self.std_error


@dataclass(frozen=True)
class Relation:
    """The sum of its terms is zero; one target term has coefficient 1."""

    terms: tuple[RelationTerm, ...]

    def part(self, factor: str | None) -> Combination:
        """Return what multiplies `factor`."""
        return Combination.of((t.coefficient, t.term) for t in self.terms if t.factor == factor)
