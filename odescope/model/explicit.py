"""The explicit form: targets as quotients, by collecting what multiplies them.

Relations that share targets are solved by Cramer's rule on their own small block; everything stays a sum of terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import permutations
from math import prod

from odescope.errors import InputError
from odescope.library.expression import ONE, Combination, Term
from odescope.model.relation import Relation

NOTHING = Combination()
SAME = 1e-9  # of a coefficient: less is rounding
ROUNDING = 1e-14  # of the products that a coefficient is the sum of
LARGEST_BLOCK = 5  # targets in one coupled block; its determinant has n! products
MOST_PRODUCTS = 5000  # of a block, before equal ones are collected: more take long, and nobody reads what they come to


@dataclass(frozen=True)
class Quotient:
    """target = outside + numerator / denominator."""

    target: str
    numerator: Combination
    denominator: Combination
    outside: Combination = NOTHING

    @property
    def plain(self) -> bool:
        """Whether the denominator is 1."""
        return self.denominator.parts == ((1.0, ONE),)

    @property
    def divided(self) -> Quotient:
        """The same, divided by its denominator if that is one product: what people write is 9.81 - u**2/z**2."""
        if self.plain or len(self.denominator.parts) > 1:
            return self
        ((share, below),) = self.denominator.parts
        by = below.inverse
        return Quotient(
            self.target,
            Combination(tuple((c / share, term * by) for c, term in self.numerator.parts)),
            Combination(((1.0, ONE),)),
        )

    @property
    def apart(self) -> Quotient:
        """The same, with what stands in the numerator times the denominator outside: what flows in beside a rate."""
        above, below = ({t: c for c, t in side.parts} for side in (self.numerator, self.denominator))
        unit = below.pop(ONE, 0.0)
        outside = list[tuple[float, Term]]()
        for term in sorted(above, key=lambda t: sum(abs(power) for _, power in t.factors)) if unit and below else ():
            inside = {term * t: above[term] * c / unit for t, c in below.items()} if term in above else {}
            if inside and all(t in above and abs(above[t] - c) <= SAME * abs(c) for t, c in inside.items()):
                outside.append((above.pop(term) / unit, term))
                above = {t: c for t, c in above.items() if t not in inside}
        if not outside:
            return self
        rest = Combination.of((c, t) for t, c in above.items())
        if not rest.parts:
            return Quotient(self.target, Combination.of(outside), Combination(((1.0, ONE),)))
        return Quotient(self.target, rest, self.denominator, Combination.of(outside))

    @property
    def together(self) -> Quotient:
        """The same, with all of it over the denominator."""
        above = (*self.numerator.parts, *_product(self.outside, self.denominator).parts)
        return replace(self, numerator=Combination.of(above), outside=NOTHING)

    @property
    def negative(self) -> bool:
        """Whether a fraction beside terms outside of it is written with a minus before it."""
        return bool(self.outside.parts) and all(c < 0.0 for c, _ in self.numerator.parts)

    @property
    def unsigned(self) -> Combination:
        """The numerator without that minus."""
        return Combination(tuple((-c, t) for c, t in self.numerator.parts)) if self.negative else self.numerator

    @property
    def text(self) -> str:
        """The right-hand side in Python syntax."""
        if self.plain:
            return self.numerator.text
        above, below = self.unsigned.text, self.denominator.text
        if not self.outside.parts:
            return f"({above})/({below})"
        fraction = f"{above}/({below})" if len(self.numerator.parts) == 1 else f"({above})/({below})"
        return f"{self.outside.text} {'-' if self.negative else '+'} {fraction}"


@dataclass(frozen=True)
class Coupled:
    """Relations, by number, and the targets that they share with no others: as many of the one as of the other."""

    rows: tuple[int, ...]
    targets: tuple[str, ...]


def explicit(relations: Sequence[Relation], targets: Sequence[str]) -> tuple[Quotient, ...]:
    """Return one quotient a target, in the order of the targets.

    Raises:
        InputError: the relations do not determine the targets, or more than five are coupled.
    """
    found: dict[str, Quotient] = {}
    for block in blocks(relations, targets):
        if len(block.rows) > LARGEST_BLOCK:
            raise InputError(f"{len(block.rows)} coupled targets have no readable explicit form; use the relations")
        found |= _solved(relations, block)
    return tuple(found[t] for t in targets)


def short_explicit(relations: Sequence[Relation], block: Coupled) -> dict[str, Quotient]:
    """Return the quotients of a block by target; none where they would take thousands of products to work out.

    Raises:
        InputError: the relations of the block are not independent.
    """
    count = len(block.rows)
    if count > LARGEST_BLOCK:
        return {}
    widths = [[len(relations[r].part(t).parts) for t in block.targets] for r in block.rows]
    right = [len(relations[r].right.parts) for r in block.rows]
    # Of the determinant, and of those with the right-hand side in place of one column.
    each = [widths] + [[[*w[:k], b, *w[k + 1 :]] for w, b in zip(widths, right, strict=True)] for k in range(count)]
    orders = list(permutations(range(count)))
    products = sum(prod(m[r][c] for r, c in enumerate(order)) for m in each for order in orders)
    return _solved(relations, block) if products <= MOST_PRODUCTS else {}


def blocks(relations: Sequence[Relation], targets: Sequence[str]) -> list[Coupled]:
    """Return the connected groups of relations and targets.

    Raises:
        InputError: a group has not as many relations as targets, or a target stands in no relation.
    """
    groups: list[tuple[set[int], set[str]]] = []
    for r, relation in enumerate(relations):
        rows, held = {r}, {t.factor for t in relation.terms if t.factor is not None}
        apart = []
        for other_rows, other_targets in groups:
            if other_targets & held:
                rows, held = rows | other_rows, held | other_targets
            else:
                apart.append((other_rows, other_targets))
        groups = [*apart, (rows, held)]
    unused = set(targets) - {t for _, held in groups for t in held}
    if unused:
        raise InputError(f"no relation holds the target {min(unused)}")
    found = [Coupled(tuple(sorted(rows)), tuple(t for t in targets if t in held)) for rows, held in groups]
    for block in found:
        if len(block.rows) != len(block.targets):
            raise InputError(
                f"{len(block.rows)} relations cannot determine {len(block.targets)} targets"
                f" ({', '.join(block.targets)}): two relations say the same, or one target appears in none"
            )
    return found


def _solved(relations: Sequence[Relation], block: Coupled) -> dict[str, Quotient]:
    """Return the quotients of a block, by Cramer's rule."""
    matrix = [[relations[r].part(t) for t in block.targets] for r in block.rows]
    right = [relations[r].right for r in block.rows]
    denominator = _determinant(matrix)
    if not denominator.parts:
        raise InputError(f"the relations for {', '.join(block.targets)} are not independent")
    found: dict[str, Quotient] = {}
    for k, target in enumerate(block.targets):
        replaced = [[*row[:k], b, *row[k + 1 :]] for row, b in zip(matrix, right, strict=True)]
        found[target] = Quotient(target, _determinant(replaced), denominator)
    return found


def _determinant(matrix: Sequence[Sequence[Combination]]) -> Combination:
    parts = []
    for order in permutations(range(len(matrix))):
        inversions = sum(a > b for k, a in enumerate(order) for b in order[k + 1 :])
        product = reduce(_product, (matrix[r][c] for r, c in enumerate(order)))
        parts += [(-c if inversions % 2 else c, t) for c, t in product.parts]
    sizes = {t: c for c, t in Combination.of((abs(c), t) for c, t in parts).parts}
    # Products that cancel leave their rounding behind, which is no term and would hide a singular block.
    return Combination(tuple((c, t) for c, t in Combination.of(parts).parts if abs(c) > ROUNDING * sizes[t]))


def _product(first: Combination, second: Combination) -> Combination:
    return Combination.of((a * b, t * u) for a, t in first.parts for b, u in second.parts)
