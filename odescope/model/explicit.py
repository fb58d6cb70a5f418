"""The explicit form: targets as quotients, by collecting what multiplies them.

Relations that share targets are solved by Cramer's rule on their own small block; everything stays a sum of terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import permutations

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.library.expression import ONE, Combination, latex_combination, latex_name
from odescope.library.mathml import mathml_combination, mathml_name
from odescope.library.tape import evaluate, write_tape
from odescope.model.model import Model

ROUNDING = 1e-14  # of the products that a coefficient is the sum of
LARGEST_BLOCK = 5  # targets in one coupled block; its determinant has n! products


@dataclass(frozen=True)
class Quotient:
    """target = numerator / denominator."""

    target: str
    numerator: Combination
    denominator: Combination

    @property
    def text(self) -> str:
        """The right-hand side in Python syntax."""
        if self.denominator.parts == ((1.0, ONE),):
            return self.numerator.text
        return f"({self.numerator.text})/({self.denominator.text})"

    @property
    def latex(self) -> str:
        """The whole equation in LaTeX."""
        numerator = latex_combination(self.numerator)
        if self.denominator.parts == ((1.0, ONE),):
            return f"{latex_name(self.target)} = {numerator}"
        return rf"{latex_name(self.target)} = \frac{{{numerator}}}{{{latex_combination(self.denominator)}}}"

    @property
    def mathml(self) -> str:
        """The whole equation in MathML."""
        right = mathml_combination(self.numerator)
        if self.denominator.parts != ((1.0, ONE),):
            right = f"<mfrac>{right}{mathml_combination(self.denominator)}</mfrac>"
        return f"{mathml_name(self.target)}<mo>=</mo>{right}"


def explicit(model: Model) -> tuple[Quotient, ...]:
    """Return one quotient a target, in the order of the targets.

    Raises:
        InputError: the relations do not determine the targets, or more than five are coupled.
    """
    found: dict[str, Quotient] = {}
    for rows, targets in _blocks(model):
        if len(rows) != len(targets):
            raise InputError(
                f"{len(rows)} relations cannot determine {len(targets)} targets ({', '.join(targets)}): two relations"
                " say the same, or one target appears in none"
            )
        if len(rows) > LARGEST_BLOCK:
            raise InputError(f"{len(rows)} coupled targets have no readable explicit form; use the relations")
        matrix = [[model.relations[r].part(t) for t in targets] for r in rows]
        right = [_scaled(model.relations[r].part(None), -1.0) for r in rows]
        denominator = _determinant(matrix)
        if not denominator.parts:
            raise InputError(f"the relations for {', '.join(targets)} are not independent")
        for k, target in enumerate(targets):
            replaced = [[*row[:k], b, *row[k + 1 :]] for row, b in zip(matrix, right, strict=True)]
            found[target] = Quotient(target, _determinant(replaced), denominator)
    return tuple(found[t] for t in model.targets)


def denominator_ranges(
    model: Model, columns: FloatArray, rng: np.random.Generator
) -> dict[str, dict[str, list[float]]]:
    """Return the range of each target's denominator over the data and over the box of the data.

    Args:
        model: whose explicit form is looked at.
        columns: states and inputs of the data, (variables, N).
        rng: draws the 4 096 points that sample the box.
    """
    quotients = explicit(model)
    tape = write_tape(model.variables, [q.denominator for q in quotients])
    low, high = columns.min(axis=1), columns.max(axis=1)
    box = low[:, None] + (high - low)[:, None] * rng.random((len(columns), 4096))
    ranges: dict[str, dict[str, list[float]]] = {}
    for q, inside, around in zip(quotients, evaluate(tape, columns), evaluate(tape, box), strict=True):
        both = np.concatenate([inside, around])
        ranges[q.target] = {
            "data": [float(inside.min()), float(inside.max())],
            "box": [float(both.min()), float(both.max())],
        }
    return ranges


def _blocks(model: Model) -> list[tuple[list[int], list[str]]]:
    """Return the connected groups of relations and targets."""
    groups: list[tuple[set[int], set[str]]] = []
    for r, relation in enumerate(model.relations):
        rows, targets = {r}, {t.factor for t in relation.terms if t.factor is not None}
        apart = []
        for other_rows, other_targets in groups:
            if other_targets & targets:
                rows, targets = rows | other_rows, targets | other_targets
            else:
                apart.append((other_rows, other_targets))
        groups = [*apart, (rows, targets)]
    unused = set(model.targets) - {t for _, targets in groups for t in targets}
    if unused:
        raise InputError(f"no relation holds the target {min(unused)}")
    return [(sorted(rows), [t for t in model.targets if t in targets]) for rows, targets in groups]


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


def _scaled(combination: Combination, factor: float) -> Combination:
    return Combination(tuple((factor * c, t) for c, t in combination.parts))
