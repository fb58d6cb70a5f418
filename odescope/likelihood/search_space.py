"""What a structure search works on: data, candidate parts, their penalties, and fits of some of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.product import Product
from odescope.likelihood.budget import Budget
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.fit import ITERATIONS, Fit, fit
from odescope.likelihood.program import Frame, Part, Program
from odescope.likelihood.segments import Segments
from odescope.model.relation import Relation, RelationTerm
from odescope.selection.criterion import penalty

RARER = 2.0  # a product with one factor more is half as likely


@dataclass(frozen=True)
class Move:
    """One step of the trail: the score or Wald statistic that asked for it, the penalty of its part, the cost after it.

    `width` is the size of the defects that the step was made at, in smoothing errors of each state.
    """

    width: float
    action: str
    part: Part
    statistic: float
    penalty: float
    cost: float


def candidate_parts(libraries: Sequence[Sequence[Product]]) -> tuple[Part, ...]:
    """Return the parts of all relations, given the candidates of each."""
    return tuple(Part(r, product) for r, candidates in enumerate(libraries) for product in candidates)


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """Everything a search needs that does not change on the way."""

    evaluator: Evaluator
    parts: tuple[Part, ...]
    frame: Frame

    @property
    def segments(self) -> Segments:
        """The data."""
        return self.evaluator.segments

    @property
    def budget(self) -> Budget:
        """What the search may cost."""
        return self.evaluator.budget

    @cached_property
    def held(self) -> IntArray:
        """Parts whose coefficient is 1 throughout."""
        return np.array([k for k, p in enumerate(self.parts) if self.frame.held(p)], dtype=np.int64)

    @cached_property
    def free(self) -> IntArray:
        """Parts whose coefficients may be parameters."""
        return np.setdiff1d(np.arange(len(self.parts)), self.held)

    @property
    def relations(self) -> int:
        """Number of relations."""
        return len(self.frame.targets)

    @cached_property
    def penalty(self) -> FloatArray:
        """What each part has to earn as a parameter (parts,), see `selection.criterion`.

        Every factor of a product divides the prior by RARER: noise often leaves it to a hair which of two look-alikes
        fits better, and laws are simple. All shares together are 1, so the penalty is 2 ln(candidates) on the whole.
        """
        size = np.array([(p.product.factor is not None) + p.product.degree for p in self.parts])
        share = RARER ** -size.astype(np.float64)
        return penalty(self.segments.samples, share / share[self.free].sum())

    @cached_property
    def whole(self) -> Program:
        """The program of all parts."""
        return Program.of(self.parts, self.frame)

    def on(self, segments: Segments) -> SearchSpace:
        """Return the space for other segments."""
        return replace(self, evaluator=Evaluator(segments, self.evaluator.substeps, self.budget))

    def within(self, budget: Budget) -> SearchSpace:
        """Return the space with another budget."""
        return replace(self, evaluator=Evaluator(self.segments, self.evaluator.substeps, budget))

    def finer(self, substeps: int) -> SearchSpace:
        """Return the space with so many steps of RK4 a sample."""
        return replace(self, evaluator=Evaluator(self.segments, substeps, self.budget))

    def program(self, present: IntArray) -> tuple[Program, IntArray]:
        """Return the program of these and the held parts alone, and their numbers."""
        kept = np.union1d(present, self.held)
        return Program.of([self.parts[k] for k in kept], self.frame), kept

    def move(self, width: float, action: str, k: int, statistic: float, after: Fit) -> Move:
        """Return the step of the trail that did something to part k.

        Args:
            width: of the defects, in smoothing errors.
            action: what was done.
            k: the part's number.
            statistic: that asked for it.
            after: the fit after it.
        """
        return Move(width, action, self.parts[k], statistic, float(self.penalty[k]), after.cost)

    def fit(
        self, theta: FloatArray, present: IntArray, x0: FloatArray, defect_std: FloatArray, iterations: int = ITERATIONS
    ) -> Fit | None:
        """Return the fit of the present parts; only they are on the tape.

        Args:
            theta: (parts,) coefficients to begin with, 1 in held parts.
            present: numbers of the parts that are parameters, ascending.
            x0: (J, n) initial states to begin with.
            defect_std: (n,) standard deviations of the defects between segments.
            iterations: steps at most.
        """
        program, kept = self.program(present)
        found = fit(self.evaluator, program, theta[kept], np.searchsorted(kept, present), x0, defect_std, iterations)
        if found is None:
            return None
        whole = np.zeros(len(self.parts))
        whole[kept] = found.theta
        return replace(found, theta=whole, present=present)

    def start(self, relations: Sequence[Relation]) -> tuple[FloatArray, IntArray]:
        """Return coefficients (parts,) and present parts of relations whose own bare target has coefficient 1."""
        place = {part: k for k, part in enumerate(self.parts)}
        theta = np.zeros(len(self.parts))
        theta[self.held] = 1.0
        found = {
            place[Part(r, t.product)]: t.coefficient for r, relation in enumerate(relations) for t in relation.terms
        }
        present = np.array(sorted(set(found) - set(self.held.tolist())), dtype=np.int64)
        theta[present] = [found[k] for k in present.tolist()]
        return theta, present

    def relations_of(self, found: Fit, errors: FloatArray) -> tuple[Relation, ...]:
        """Return the relations of a fit, each with its held part first.

        Args:
            found: the fit.
            errors: (p,) standard errors of the present parts.
        """
        error = dict(zip(found.present.tolist(), errors.tolist(), strict=True))
        numbers = [*self.held.tolist(), *found.present.tolist()]
        return tuple(
            Relation(
                tuple(
                    RelationTerm(self.parts[k].product, float(found.theta[k]), error.get(k))
                    for k in numbers
                    if self.parts[k].relation == r
                )
            )
            for r in range(self.relations)
        )
