"""The likelihood stage: from the relations that regression proposes to the model that the trajectory supports."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.candidates import split_target
from odescope.library.expression import Term
from odescope.likelihood.data import cut_segments
from odescope.likelihood.fit import Evaluator
from odescope.likelihood.search import LikelihoodSearch, Outcome, Searcher, search, universe
from odescope.model.model import Relation, RelationTerm
from odescope.model.simulate import following_states
from odescope.records import Records
from odescope.regression.proposers import MatchingPursuit
from odescope.selection.problem import Problem
from odescope.signals.estimate import Signals

FORWARD_TERMS = 6  # of a sparse forward selection that a search may begin from
FINEST = 8  # steps of RK4 a block average, at most
FOLLOWED = 1.5  # residual variance over noise variance up to which a model is said to follow its record
STEP_ERROR = 1.0  # change of the cost, in units of chi-squared, that asks for steps half as long


@dataclass(frozen=True, eq=False)
class Refinement:
    """The relations at the end of the likelihood stage, and how it went."""

    relations: tuple[Relation, ...]
    outcome: Outcome
    searcher: Searcher
    starts: int

    @property
    def follows(self) -> bool:
        """Whether the model follows the record to within its noise, segments joined: its errors can then be stated."""
        return bool(np.isfinite(self.outcome.gap)) and self.outcome.scale < FOLLOWED


def refine(
    records: Records,
    signals: Signals,
    problems: Sequence[Problem],
    starts: Sequence[Sequence[Relation]],
    options: LikelihoodSearch,
    watch: Callable[[str], None] = lambda _: None,
) -> Refinement | None:
    """Return the best end of the searches from several starts, or None where no start can be followed.

    Args:
        records: uniformly sampled, at one period.
        signals: noise, cutoffs and order of states found in them.
        problems: the candidates of each target.
        starts: relations of all targets to begin from; a sparse forward selection is added.
        options: how many starts, how long.
        watch: told what goes on.
    """
    segments = cut_segments(records, signals.coordinates, signals.inputs, signals.channels)
    slots = universe([_products(p, signals.targets) for p in problems])
    if not all(any(s.fixed for s in slots if s.relation == r) for r in range(len(problems))):
        return None  # a library without the bare target has nothing that could be 1 throughout a search
    variables = (*signals.states, *(i.name for i in signals.inputs))
    measured = np.array([signals.states.index(c.name) for c in signals.coordinates], dtype=np.int64)
    searcher = Searcher(
        Evaluator(segments), slots, variables, following_states(signals.coordinates), measured,
        time.monotonic() + options.seconds,
    )  # fmt: skip
    searcher = _fine_enough(searcher, *_slots_of(searcher, starts[0], signals.targets))
    begun = [_slots_of(searcher, relations, signals.targets) for relations in starts][: options.starts]
    begun.append(_forward(searcher, problems))
    outcomes = []
    for number, (theta, present) in enumerate(begun, start=1):
        watch(f"likelihood: search {number} of {len(begun)}")
        found = search(searcher, theta, present)
        if found is not None:
            outcomes.append(found)
        if time.monotonic() > searcher.deadline or (found is not None and found.clear):
            break
    if not outcomes:
        return None
    best = min(outcomes, key=lambda o: o.rank)
    searcher, best = _finer(searcher, best)
    return Refinement(_relations(searcher, best, signals.targets), best, searcher, len(outcomes))


def _products(problem: Problem, targets: Sequence[str]) -> list[tuple[int, Term]]:
    split = [split_target(term, targets) for term in problem.terms]
    return [(-1 if name is None else list(targets).index(name), rest) for name, rest in split]


def _slots_of(
    searcher: Searcher, relations: Sequence[Relation], targets: Sequence[str]
) -> tuple[FloatArray, list[int]]:
    """Return coefficients and present slots of relations whose own bare target has coefficient 1."""
    place = {(s.relation, s.factor, s.term): k for k, s in enumerate(searcher.slots)}
    theta = np.array([1.0 if s.fixed else 0.0 for s in searcher.slots])
    present = []
    for r, relation in enumerate(relations):
        for t in relation.terms:
            k = place[r, -1 if t.factor is None else list(targets).index(t.factor), t.term]
            if not searcher.slots[k].fixed:
                theta[k] = t.coefficient
                present.append(k)
    return theta, present


def _forward(searcher: Searcher, problems: Sequence[Problem]) -> tuple[FloatArray, list[int]]:
    """Return a sparse forward selection of every relation, fitted by regression."""
    theta = np.array([1.0 if s.fixed else 0.0 for s in searcher.slots])
    present, offset = [], 0
    for problem in problems:
        everything = tuple(range(len(problem.terms)))
        plain = tuple(j for j in everything if j not in problem.own or j == problem.left)
        path = list(MatchingPursuit(FORWARD_TERMS).supports(problem.factor, problem.left, plain))
        support = (*path[-1], problem.left)
        xi = problem.factor.solve(support, problem.left)
        for j in path[-1]:
            theta[offset + j] = xi[j]
            present.append(offset + j)
        offset += len(problem.terms)
    return theta, present


def _fine_enough(searcher: Searcher, theta: FloatArray, present: list[int]) -> Searcher:
    """Halve the steps of RK4 until that no longer changes the cost of the first start, fitted in loose segments."""
    loose = np.full_like(searcher.segments.spread, np.inf)
    kept = np.array(sorted(present), dtype=np.int64)
    found = searcher.fit(theta, kept, searcher.segments.initial, loose)
    while found is not None and searcher.evaluator.substeps < FINEST:
        finer = replace(searcher, evaluator=Evaluator(searcher.segments, 2 * searcher.evaluator.substeps))
        again = finer.fit(found.theta, kept, found.x0, loose, iterations=0)
        if again is not None and abs(again.cost - found.cost) < STEP_ERROR:
            return searcher
        searcher, found = finer, finer.fit(found.theta, kept, found.x0, loose)
    return searcher


def _finer(searcher: Searcher, outcome: Outcome) -> tuple[Searcher, Outcome]:
    """Halve the steps until that no longer changes the cost, refitting each time it did."""
    gap = searcher.segments.spread * outcome.gap
    found = outcome.fit
    while searcher.evaluator.substeps < FINEST:
        finer = replace(searcher, evaluator=Evaluator(searcher.segments, 2 * searcher.evaluator.substeps))
        again = finer.fit(found.theta, found.present, found.x0, gap, iterations=0)
        if again is None or abs(again.cost - found.cost) < STEP_ERROR:
            break
        refitted = finer.fit(found.theta, found.present, found.x0, gap)
        if refitted is None:
            break
        searcher, found = finer, refitted
    return searcher, replace(outcome, fit=found)


def _relations(searcher: Searcher, outcome: Outcome, targets: Sequence[str]) -> tuple[Relation, ...]:
    errors = np.sqrt(outcome.fit.variances * max(outcome.scale, 1e-300))
    of_slot = dict(zip(outcome.fit.present.tolist(), errors.tolist(), strict=True))
    relations = []
    for r in range(len(targets)):
        own = [k for k, s in enumerate(searcher.slots) if s.relation == r and (s.fixed or k in of_slot)]
        own.sort(key=lambda k: not searcher.slots[k].fixed)
        relations.append(
            Relation(
                tuple(
                    RelationTerm(
                        None if searcher.slots[k].factor < 0 else targets[searcher.slots[k].factor],
                        searcher.slots[k].term,
                        float(outcome.fit.theta[k]),
                        of_slot.get(k),
                    )
                    for k in own
                )
            )
        )
    return tuple(relations)
