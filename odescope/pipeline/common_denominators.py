"""Quotients with the denominator of another relation: what reacts or flows is divided by the same in every balance.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from odescope.arrays import FloatArray
from odescope.events import Progress
from odescope.library.expression import ONE, Term
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.settings import Start
from odescope.likelihood.smoothed_targets import explicit
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.stages import refine_form
from odescope.pipeline.wider import LEAST, evidently_better, within
from odescope.pipeline.work import Work

HALF = 0.5  # of the squares that are left of a target: a term that takes as much belongs to it
INDEPENDENT = 1e-7  # share of a column that those chosen before do not say


def with_common_denominators(work: Work, filtered: Filtered, posed: Posed, refinement: Refinement) -> Refinement:
    """Return the model with one denominator in several relations, where that is evidently better.

    The growth of what lives on a substrate and its consumption are divided by the same, but of each relation a fraction
    of its own is found, and one that takes many terms may be an imitation. A relation is tried with the denominator of
    one that has fewer terms; with numbers for it the relation is linear, and few terms of it can be chosen at once.

    Args:
        work: whose study says how.
        filtered: the records and their signals.
        posed: the relations.
        refinement: their model.
    """
    if not work.study.suspects or any(len(m.parts) > 1 for m in posed.mechanisms):
        return refinement
    tried = _Relations(posed, refinement)
    for start in tried.starts():
        work.monitor.tell(Progress("suspicion", "search with a denominator of several relations", 0, 1))
        alone = replace(posed, starts=(start,), plain=None, rival=None, again=lambda _: None)
        other = refine_form(within(work, max(LEAST, refinement.spent)), filtered, alone)
        if other is not None and evidently_better(other, refinement):
            return with_common_denominators(work, filtered, posed, other)
    return refinement


@dataclass(frozen=True, eq=False)
class _Relations:
    """The relations of a model, and what they may have in common."""

    posed: Posed
    refinement: Refinement

    @cached_property
    def numbers(self) -> Mapping[tuple[int, bool, Term], int]:
        """The number of every candidate by relation, whether its target is a factor, and term."""
        space, found = self.refinement.space, dict[tuple[int, bool, Term], int]()
        for k, m in enumerate(space.mechanisms[: len(self.posed.mechanisms)]):
            part = m.parts[0].product
            relation = m.parts[0].relation
            if part.factor in (None, space.frame.targets[relation]):
                found[relation, part.factor is not None, part.term] = k
        return found

    @cached_property
    def denominators(self) -> list[dict[Term, float]]:
        """What multiplies the target of each relation: coefficients by term."""
        theta, found = self.refinement.fit.theta, list[dict[Term, float]]()
        for relation in range(len(self.refinement.space.frame.targets)):
            here = {t: k for (r, target, t), k in self.numbers.items() if r == relation and target}
            found.append({t: float(theta[k]) for t, k in here.items() if theta[k] != 0.0})
        return found

    def starts(self) -> Iterator[Start]:
        """Yield the model with the denominator of one relation in another that has more terms, the longest first."""
        theta = self.refinement.fit.theta
        terms = [sum(theta[k] != 0.0 for (q, _, _), k in self.numbers.items() if q == r) for r in self.order]
        for r in sorted(self.order, key=lambda r: -terms[r]):
            for q in sorted(self.order, key=lambda q: terms[q]):
                common = self.denominators[q]
                if terms[q] >= terms[r] or set(common) in ({ONE}, set(self.denominators[r])):
                    continue
                if (start := self._with(r, common, terms[r])) is not None:
                    yield start

    @property
    def order(self) -> range:
        """The numbers of the relations."""
        return range(len(self.denominators))

    def _with(self, relation: int, common: Mapping[Term, float], most: int) -> Start | None:
        """Return the model with a denominator in a relation, None where that takes no fewer terms.

        Args:
            relation: its number.
            common: coefficients of the denominator by term.
            most: terms that it has now.
        """
        space, theta = self.refinement.space, self.refinement.fit.theta.copy()
        below = {t: self.numbers.get((relation, True, t)) for t in common}
        if None in below.values():
            return None
        said = explicit(space, self.refinement.fit)[relation]
        if not np.isfinite(said).all():  # relations that do not determine their targets somewhere
            return None
        divisor = np.array([*common.values()]) @ space.evaluated([*common], theta)
        plain = {t: k for (r, target, t), k in self.numbers.items() if r == relation and not target}
        chosen = _few(space.evaluated([*plain], theta), divisor * said, most - len(common))
        if not len(chosen) < most - len(common):
            return None
        own = self.posed.mechanisms
        theta[[k for k, m in enumerate(own) if m.parts[0].relation == relation]] = 0.0  # other targets, too
        for term, k in below.items():
            theta[k] = common[term]
        numbers = [*plain.values()]
        for column, coefficient in chosen.items():
            theta[numbers[column]] = -coefficient
        return Start((theta * space.sizes(theta))[: len(own)])


def _few(columns: FloatArray, target: FloatArray, most: int) -> dict[int, float]:
    """Return coefficients of few columns (k, N) that say a target (N,), by number.

    They are chosen one by one, up to the last that halves the squares that are left, and those without which these are
    not twice as many are dropped again. What the record does not know of the target need not be known for that.

    Args:
        columns: to choose of.
        target: that is said.
        most: columns to choose.
    """
    chosen, left = _forward(columns, target, most)
    halving = [k for k in range(len(chosen)) if left[k + 1] < HALF * left[k]]
    chosen = chosen[: halving[-1] + 1] if halving else []
    while chosen:
        bar = _left(columns[chosen], target) / HALF
        without = [_left(columns[[*chosen[:k], *chosen[k + 1 :]]], target) for k in range(len(chosen))]
        least = int(np.argmin(without))
        if without[least] > bar:
            break
        del chosen[least]
    return dict(zip(chosen, np.linalg.lstsq(columns[chosen].T, target, rcond=None)[0].tolist(), strict=True))


def _forward(columns: FloatArray, target: FloatArray, most: int) -> tuple[list[int], list[float]]:
    """Return the numbers of columns (k, N), each that with most of what is left of a target, and the squares left."""
    rest, left, chosen = columns.copy(), target.copy(), list[int]()
    sizes, squares = np.sum(columns**2, axis=1), [float(target @ target)]
    for _ in range(min(most, len(columns))):
        own = np.sum(rest**2, axis=1)
        told = own > INDEPENDENT * sizes
        gain = np.where(told, (rest @ left) ** 2 / np.where(told, own, 1.0), -1.0)
        best = int(gain.argmax())
        if not gain[best] > 0.0:
            break
        chosen.append(best)
        direction = rest[best] / np.sqrt(own[best])
        rest = rest - np.outer(rest @ direction, direction)
        left = left - float(left @ direction) * direction
        squares.append(float(left @ left))
    return chosen, squares


def _left(columns: FloatArray, target: FloatArray) -> float:
    """Return the squares that columns (k, N) leave of a target."""
    rest = target - columns.T @ np.linalg.lstsq(columns.T, target, rcond=None)[0] if len(columns) else target
    return float(rest @ rest)
