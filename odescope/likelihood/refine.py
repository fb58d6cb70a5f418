"""The likelihood stage: from the relations that regression proposes to the model that the trajectory supports."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.candidates import split_target
from odescope.library.expression import Term
from odescope.likelihood.evidence import Evidence, weigh
from odescope.likelihood.fit import Evaluator, Fit, Program
from odescope.likelihood.process_noise import (
    Noisy,
    cost_without_process_noise,
    free_run_error,
    in_pieces,
    search_with_process_noise,
)
from odescope.likelihood.search import WHITE, LikelihoodSearch, Outcome, Searcher, search, universe
from odescope.likelihood.segments import SEGMENT, Segments, cut_segments
from odescope.model.relation import Relation, RelationTerm
from odescope.parallel.workers import Threads, Workers
from odescope.recordings.coordinate import following_states
from odescope.recordings.record import Records
from odescope.regression.problem import Problem
from odescope.regression.proposers import MatchingPursuit
from odescope.signals.estimate import Signals

THREADS = Threads()

FORWARD_TERMS = 6  # of a sparse forward selection that a search may begin from
FINEST = 8  # steps of RK4 a block average, at most
JOINED_SHARE = 0.6  # of the time, at most, for the search without process noise
NO_WORSE_THAN_PROPOSED = 1.5  # mean squared error of free runs over that of the regression's model, unless it is
NEGLIGIBLE = 1e-3  # of the variance
CHANCE = 2.0  # standard deviations of a residual variance that are no reason to look for process noise
FOLLOWED = 1.5  # residual variance over noise variance up to which a model is said to follow its record
STEP_ERROR = 1.0  # change of the cost, in units of chi-squared, that does not ask for shorter steps
STEP_SHARE = 0.01  # of the cost, and
STEP_MOVE = 0.2  # standard errors of any coefficient: changes of a refit that do not ask for shorter steps still


@dataclass(frozen=True, eq=False)
class Refinement:
    """The relations at the end of the likelihood stage, and how it went.

    `outcome` is the search for a model that follows the record to within its noise. Where there is none, `process` is
    the model with process noise, or `rejected`, where that is no better than what it would replace. `fit` and
    `searcher` are those of the relations, `evidence` what the record says of every term.
    """

    relations: tuple[Relation, ...]
    outcome: Outcome
    process: Noisy | None
    rejected: Noisy | None
    fit: Fit
    searcher: Searcher
    evidence: Evidence | None
    starts: int

    @property
    def follows(self) -> bool:
        """Whether the model, with process noise if it has any, describes the record: its errors can then be stated."""
        return self.process is not None or _joined(self.outcome)


def _joined(outcome: Outcome) -> bool:
    """Say whether the model of a search follows the record to within its noise, segments joined."""
    return bool(np.isfinite(outcome.gap)) and outcome.scale < FOLLOWED


def refine(
    records: Records,
    signals: Signals,
    problems: Sequence[Problem],
    starts: Sequence[Sequence[Relation]],
    plain: Sequence[Relation],
    options: LikelihoodSearch,
    watch: Callable[[str], None] = lambda _: None,
    hands: Workers = THREADS,
) -> Refinement | None:
    """Return the best end of the searches from several starts, or None where no start can be followed.

    Args:
        records: uniformly sampled, at one period.
        signals: noise, cutoffs and order of states found in them.
        problems: the candidates of each target.
        starts: relations of all targets to begin from; a sparse forward selection is added.
        plain: relations that hold their targets bare; they are begun from too where one of those cannot be followed.
        options: how many starts, how long.
        watch: told what goes on.
        hands: who searches from the starts.
    """

    def cut(length: int) -> Segments:
        return cut_segments(records, signals.coordinates, signals.inputs, signals.channels, length)

    slots = universe([_products(p, signals.targets) for p in problems])
    if not all(any(s.fixed for s in slots if s.relation == r) for r in range(len(problems))):
        return None  # a library without the bare target has nothing that could be 1 throughout a search
    variables = (*signals.states, *(i.name for i in signals.inputs))
    measured = np.array([signals.states.index(c.name) for c in signals.coordinates], dtype=np.int64)
    now = time.time()
    searcher = Searcher(
        Evaluator(cut(SEGMENT)), slots, variables, following_states(signals.coordinates), measured,
        now + JOINED_SHARE * options.seconds,
    )  # fmt: skip
    begun = [_slots_of(searcher, relations, signals.targets) for relations in starts][: options.starts]
    begun.append(_forward(searcher, problems))
    searcher = _fine_enough(searcher, begun)
    outcomes = _searches(searcher, begun, _slots_of(searcher, plain, signals.targets), watch, hands)
    if not outcomes:
        return None
    best = min(outcomes, key=lambda o: o.rank)
    if _joined(best):
        searcher, best = _finer(searcher, best)
    process = None
    chance = CHANCE * np.sqrt(2.0 / searcher.segments.samples)  # of white residuals alone
    if not _joined(best) or best.scale > WHITE + chance:
        watch("likelihood: process noise")
        timed = replace(searcher, deadline=now + options.seconds)
        process, adopted = _with_process_noise(cut, timed, best, begun)
        if process is not None and adopted:
            relations = _relations(searcher, process.fit, np.sqrt(process.evidence.variances), signals.targets)
            return Refinement(
                relations, best, process, None, process.fit, process.searcher, process.evidence, len(outcomes)
            )
    relations = _relations(searcher, best.fit, np.sqrt(best.fit.variances * best.scale), signals.targets)
    return Refinement(relations, best, None, process, best.fit, searcher, _evidence(searcher, best), len(outcomes))


def _searches(
    searcher: Searcher,
    begun: Sequence[tuple[FloatArray, list[int]]],
    plain: tuple[FloatArray, list[int]],
    watch: Callable[[str], None],
    hands: Workers,
) -> list[Outcome]:
    """Return the ends of searches from these starts, until one is clear; from plain relations too if one fails."""
    outcomes, failed = list[Outcome](), False
    watch(f"likelihood: search 1 of {len(begun)}")
    for number, found in enumerate(hands.map(_search, begun, searcher, alone=True), start=1):
        if number < len(begun):
            watch(f"likelihood: search {number + 1} of {len(begun)}")
        if found is None:
            failed = True
            continue
        outcomes.append(found)
        if found.clear or time.time() > searcher.deadline:
            break
    if failed and time.time() < searcher.deadline:
        watch("likelihood: search from plain relations")
        found = search(searcher, *_shorter(searcher, plain, outcomes))
        if found is not None:
            outcomes.append(found)
    return outcomes


def _search(start: tuple[FloatArray, list[int]], searcher: Searcher) -> Outcome | None:
    return search(searcher, *start)


def _shorter(
    searcher: Searcher, plain: tuple[FloatArray, list[int]], outcomes: Sequence[Outcome]
) -> tuple[FloatArray, list[int]]:
    """Return each relation as it is plain or as the best search left it, whichever has fewer terms."""
    if not outcomes:
        return plain
    best = min(outcomes, key=lambda o: o.rank).fit
    theta, present = plain[0].copy(), list[int]()
    for r in range(searcher.relations):
        own = [k for k in plain[1] if searcher.slots[k].relation == r]
        other = [int(k) for k in best.present if searcher.slots[k].relation == r]
        if len(other) < len(own):
            theta[own] = 0.0
            theta[other] = best.theta[other]
            own = other
        present += own
    return theta, present


def _with_process_noise(
    cut: Callable[[int], Segments],
    searcher: Searcher,
    best: Outcome,
    starts: Sequence[tuple[FloatArray, list[int]]],
) -> tuple[Noisy | None, bool]:
    """Return the model with process noise, None where no start can be followed, and whether the record needs it."""
    begun = [(theta, np.array(sorted(present), dtype=np.int64)) for theta, present in starts]
    if np.isfinite(best.gap):
        begun.append((best.fit.theta, best.fit.present))
    pieces = in_pieces(cut, searcher, begun)
    process = search_with_process_noise(pieces, begun)
    if process is None:
        return None, False
    if _joined(best) and cost_without_process_noise(pieces, best) < process.penalised:
        return process, False
    # Compared as fitted to all: the proposal has seen what was held out too.
    proposed, found = (free_run_error(pieces, theta) for theta in (starts[0][0], process.fit.theta))
    return process, found < max(NO_WORSE_THAN_PROPOSED * proposed, NEGLIGIBLE)


def _evidence(searcher: Searcher, outcome: Outcome) -> Evidence | None:
    """Return the evidence at the end of a search without process noise, variances at the residuals' level."""
    program = Program.of(searcher.slots, searcher.variables, searcher.following, searcher.measured)
    fit, gap = outcome.fit, searcher.segments.spread * outcome.gap
    expansion = searcher.evaluator.expand(program, fit.theta, searcher.free, fit.x0, gap)
    if expansion is None or not expansion.finite:
        return None
    return weigh(searcher, fit, expansion.information / outcome.scale, expansion.gradient[None] / outcome.scale)


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


def _fine_enough(searcher: Searcher, starts: Sequence[tuple[FloatArray, list[int]]]) -> Searcher:
    """Halve the steps of RK4 until that no longer matters to the first start that can be followed in loose segments."""
    loose = np.full_like(searcher.segments.spread, np.inf)
    for theta, present in starts:
        found = searcher.fit(theta, np.array(sorted(present), dtype=np.int64), searcher.segments.initial, loose)
        if found is not None:
            return _halve(searcher, found, loose)[0]
    return searcher


def _finer(searcher: Searcher, outcome: Outcome) -> tuple[Searcher, Outcome]:
    """Halve the steps until that no longer matters at the end of a search."""
    searcher, found = _halve(searcher, outcome.fit, searcher.segments.spread * outcome.gap)
    return searcher, replace(outcome, fit=found)


def _halve(searcher: Searcher, found: Fit, gap: FloatArray) -> tuple[Searcher, Fit]:
    """Return searcher and fit with steps so short that halving them moves no coefficient by its standard error.

    Where the cost itself hardly changes nothing is refitted. It always does where a term jumps, such as dry friction.
    """
    while searcher.evaluator.substeps < FINEST:
        finer = replace(searcher, evaluator=Evaluator(searcher.segments, 2 * searcher.evaluator.substeps))
        again = finer.fit(found.theta, found.present, found.x0, gap, iterations=0)
        if again is not None and abs(again.cost - found.cost) < STEP_ERROR:
            break
        refitted = finer.fit(found.theta, found.present, found.x0, gap)
        if refitted is None:
            break
        moved = (refitted.theta - found.theta)[found.present] ** 2
        variances = refitted.variances * max(refitted.data_cost / searcher.segments.samples, 1.0)
        same = abs(refitted.cost - found.cost) < STEP_SHARE * found.cost
        searcher, found = finer, refitted
        if same and bool(np.all(moved < STEP_MOVE**2 * variances)):
            break
    return searcher, found


def _relations(searcher: Searcher, fit: Fit, errors: FloatArray, targets: Sequence[str]) -> tuple[Relation, ...]:
    of_slot = dict(zip(fit.present.tolist(), errors.tolist(), strict=True))
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
                        float(fit.theta[k]),
                        of_slot.get(k),
                    )
                    for k in own
                )
            )
        )
    return tuple(relations)
