"""Libraries of candidate terms: sums and products of terms, thinned by rules, counted before anything is computed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations_with_replacement, product
from math import comb

from odescope.errors import InputError
from odescope.library.expression import ONE, Term
from odescope.library.parse import MAXIMUM_POWER, Scope, parse_term
from odescope.library.product import Product
from odescope.library.rules import Rule

MAXIMUM_CANDIDATES = 20_000


@dataclass(frozen=True)
class Library:
    """Distinct candidate terms, in order, with the tally of what each rule removed on the way."""

    terms: tuple[Term, ...]
    removed: tuple[tuple[str, int], ...] = field(default=())

    @staticmethod
    def of(texts: Iterable[str], scope: Scope) -> Library:
        """Return the library of these terms.

        Raises:
            InputError: a text is no product of known functions (see `parse_term`).
        """
        return Library(tuple(dict.fromkeys(parse_term(text, scope) for text in texts)))

    def __len__(self) -> int:
        return len(self.terms)

    def __iter__(self) -> Iterator[Term]:
        return iter(self.terms)

    def __add__(self, other: Library) -> Library:
        return Library(tuple(dict.fromkeys((*self.terms, *other.terms))), (*self.removed, *other.removed))

    def __mul__(self, other: Library) -> Library:
        return Library(
            tuple(dict.fromkeys(a * b for a, b in product(self.terms, other.terms))), (*self.removed, *other.removed)
        )

    def powers(self, degree: int) -> Library:
        """Return all products of at most `degree` of these terms, the constant included.

        Raises:
            InputError: there would be more than 20 000 of them, or a power in one exceeds 16.
        """
        basis = [t for t in self.terms if t != ONE]
        count = comb(len(basis) + degree, degree)
        if count > MAXIMUM_CANDIDATES:
            raise InputError(
                f"{len(basis)} basis functions to degree {degree} make {count} products, more than"
                f" {MAXIMUM_CANDIDATES}: lower the degree or name fewer basis functions"
            )
        terms = dict.fromkeys(
            Term.of(f for t in chosen for f in t.factors)
            for d in range(degree + 1)
            for chosen in combinations_with_replacement(basis, d)
        )
        steepest = max((abs(p) for t in terms for _, p in t.factors), default=0)
        if steepest > MAXIMUM_POWER:
            raise InputError(
                f"the basis to degree {degree} holds a power of {steepest}, more than {MAXIMUM_POWER}: lower the degree"
            )
        return Library(tuple(terms), self.removed)

    def that(self, stays: Callable[[Term], bool]) -> Library:
        """Return the terms that stay, in order."""
        return Library(tuple(t for t in self.terms if stays(t)), self.removed)

    def thin(self, rules: Sequence[Rule], scope: Scope) -> Library:
        """Return what the rules keep, in order; `removed` says how many each rule took from what reached it."""
        terms, removed = self.terms, list(self.removed)
        for rule in rules:
            kept = tuple(t for t in terms if rule.keeps(t, scope))
            removed.append((str(rule), len(terms) - len(kept)))
            terms = kept
        return Library(terms, tuple(removed))

    def without(self, names: Collection[str]) -> Library:
        """Return the terms that hold none of these names."""
        return Library(tuple(t for t in self.terms if not t.names & set(names)), self.removed)

    def with_single(self, basis: Iterable[Term], constants: Collection[str]) -> Library:
        """Return the terms with at most one basis function that holds constants, and that only once.

        A product of two is most often another of the same kind: exp(-E/T)**2 is exp(-2*E/T).

        Args:
            basis: the functions that the terms are products of.
            constants: by name.
        """
        single = {_holding(term, constants) for term in basis} | {ONE}
        return Library(tuple(t for t in self.terms if _holding(t, constants) in single), self.removed)

    def products(self, targets: Collection[str]) -> tuple[Product, ...]:
        """Return the candidates as products of a target or 1.

        Raises:
            InputError: a candidate is not linear in the targets.
        """
        return tuple(Product.of(term, targets) for term in self.terms)

    def preview(self, samples: int) -> str:
        """Return how many candidates there are and what their values would take in memory if held at once."""
        return f"{len(self)} candidates x {samples} samples: {len(self) * samples * 8 / 1e6:.1f} MB if held at once"


def _holding(term: Term, constants: Collection[str]) -> Term:
    """Return the factors of a term that hold constants."""
    return Term(tuple((atom, p) for atom, p in term.factors if Term(((atom, 1),)).names & set(constants)))
