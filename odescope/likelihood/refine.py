"""The likelihood stage: from the relations that regression proposes to the model that the trajectory supports."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.events import Monitor, Progress
from odescope.likelihood.budget import Budget
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.evidence import Evidence, weigh
from odescope.likelihood.fit import Fit
from odescope.likelihood.held_out import free_run_error
from odescope.likelihood.process_noise import (
    Noisy,
    cost_without_process_noise,
    in_pieces,
    search_with_process_noise,
)
from odescope.likelihood.program import Frame
from odescope.likelihood.search import WHITE, LikelihoodSearch, Outcome, search
from odescope.likelihood.searcher import Searcher, candidate_parts
from odescope.likelihood.segments import SEGMENT, Segments, cut_segments
from odescope.model.relation import Relation, RelationTerm
from odescope.parallel.workers import Threads, Workers
from odescope.recordings.record import Records
from odescope.regression.problem import Problem
from odescope.regression.proposers import MatchingPursuit
from odescope.signals.differentiators import Differentiator
from odescope.signals.estimate import Signals

THREADS = Threads()

FORWARD_TERMS = 6  # of a sparse forward selection that a search may begin from
FINEST = 8  # steps of RK4 a block average, at most
JOINED_SHARE = 0.6  # of the budget, at most, for the searches without process noise
NO_WORSE_THAN_PROPOSED = 1.5  # mean squared error of free runs over that of the regression's model, unless it is
NEGLIGIBLE = 1e-3  # of the variance
CHANCE = 2.0  # standard deviations of a residual variance that are no reason to look for process noise
FOLLOWED = 1.5  # residual variance over noise variance up to which a model is said to follow its record
STEP_ERROR = 1.0  # change of the cost, in units of chi-squared, that does not ask for shorter steps
STEP_SHARE = 0.01  # of the cost, and
STEP_MOVE = 0.2  # standard errors of any coefficient: changes of a refit that do not ask for shorter steps still

Start = tuple[FloatArray, IntArray]  # coefficients (parts,), 1 in held parts, and the parts present, ascending


@dataclass(frozen=True, eq=False)
class Refinement:
    """The relations at the end of the likelihood stage, and how it went.

    `outcome` is the search for a model that follows the record to within its noise. Where there is none, `process` is
    the model with process noise, or `rejected`, where that is no better than what it would replace. `fit` and
    `searcher` are those of the relations, `evidence` what the record says of every term. Not `finished` if the budget
    ended a search, `late` if the clock did; `spent` is in units of the budget.
    """

    relations: tuple[Relation, ...]
    outcome: Outcome
    process: Noisy | None
    rejected: Noisy | None
    fit: Fit
    searcher: Searcher
    evidence: Evidence | None
    starts: int
    finished: bool
    late: bool
    spent: float

    @property
    def follows(self) -> bool:
        """Whether the model, with process noise if it has any, describes the record: its errors can then be stated."""
        return self.process is not None or _joined(self.outcome)


def _joined(outcome: Outcome) -> bool:
    """Say whether the model of a search follows the record to within its noise, segments joined."""
    return bool(np.isfinite(outcome.width)) and outcome.scale < FOLLOWED


def refine(
    records: Records,
    signals: Signals,
    problems: Sequence[Problem],
    starts: Sequence[Sequence[Relation]],
    plain: Sequence[Relation],
    differentiator: Differentiator,
    options: LikelihoodSearch,
    monitor: Monitor = Monitor(),  # noqa: B008
    workers: Workers = THREADS,
) -> Refinement | None:
    """Return the best end of the searches from several starts, or None where no start can be followed.

    Args:
        records: uniformly sampled, at one period.
        signals: noise, cutoffs and order of states found in them.
        problems: the candidates of each target.
        starts: relations of all targets to begin from; a sparse forward selection is added.
        plain: relations that hold their targets bare; they are begun from too where one of those cannot be followed.
        differentiator: that the signals were found with.
        options: how many starts, at what budget.
        monitor: told what goes on, and asked whether to stop.
        workers: who searches from the starts.

    Raises:
        Stopped: the run is to end.
    """

    def cut(length: int) -> Segments:
        return cut_segments(records, signals, differentiator, length)

    frame = Frame.of(signals.coordinates, [i.name for i in signals.inputs])
    deadline = None if options.seconds is None else time.time() + options.seconds
    budget = Budget(options.budget, monitor, deadline)
    searcher = Searcher(Evaluator(cut(SEGMENT), 1, budget), candidate_parts([p.terms for p in problems]), frame)
    if len(searcher.held) < searcher.relations:
        return None  # a library without the bare target has nothing that could be 1 throughout a search
    begun = [searcher.start(relations) for relations in starts][: options.starts]
    begun.append(searcher.start([_forward(problem) for problem in problems]))
    searcher = _fine_enough(searcher, begun)
    outcomes = _searches(searcher, begun, searcher.start(plain), monitor, workers)
    if not outcomes:
        return None
    budget.spent += sum(o.spent for o in outcomes)
    return _judged(cut, searcher, begun, outcomes)


def _judged(
    cut: Callable[[int], Segments], searcher: Searcher, begun: Sequence[Start], outcomes: Sequence[Outcome]
) -> Refinement:
    """Return the best end of the searches, or the model with process noise where that describes the record better."""
    best = min(outcomes, key=lambda o: o.rank)
    if _joined(best):
        searcher, best = _finer(searcher, best)
    process, adopted = None, False
    chance = CHANCE * np.sqrt(2.0 / searcher.segments.samples)  # of white residuals alone
    if not _joined(best) or best.scale > WHITE + chance:
        searcher.budget.monitor.tell(Progress("likelihood", "search with process noise", 0, 1))
        process, adopted = _with_process_noise(cut, searcher, best, begun)
    evidence: Evidence | None
    if process is not None and adopted:
        found, last, evidence = process.fit, process.searcher, process.evidence
        errors = np.sqrt(evidence.variances)
    else:
        found, last, evidence = best.fit, searcher, _evidence(searcher, best)
        errors = np.sqrt(found.variances * best.scale)
    return Refinement(
        relations=searcher.relations_of(found, errors),
        outcome=best,
        process=process if adopted else None,
        rejected=None if adopted else process,
        fit=found,
        searcher=last,
        evidence=evidence,
        starts=len(outcomes),
        finished=best.finished and not searcher.budget.over,
        late=best.late or searcher.budget.late,
        spent=searcher.budget.spent,
    )


def _searches(
    searcher: Searcher, begun: Sequence[Start], plain: Start, monitor: Monitor, workers: Workers
) -> list[Outcome]:
    """Return the ends of searches from these starts, until one is clear; from plain relations too if one fails.

    Every search has its own part of the budget, so that it ends alike wherever it runs.
    """
    share = JOINED_SHARE / len(begun)
    # A monitor speaks to whoever started the run, not to a worker elsewhere.
    budget = replace(searcher.budget.part(share), monitor=Monitor()) if workers.remote else searcher.budget.part(share)
    outcomes, failed = list[Outcome](), False
    monitor.tell(Progress("likelihood", "search", 0, len(begun)))
    for number, found in enumerate(workers.map(_search, begun, searcher.within(budget), alone=True), start=1):
        monitor.check()
        monitor.tell(Progress("likelihood", "search", number, len(begun)))
        if found is None:
            failed = True
            continue
        outcomes.append(found)
        if found.clear:
            break
    if failed:
        monitor.tell(Progress("likelihood", "search from plain relations", 0, 1))
        found = _search(_shorter(searcher, plain, outcomes), searcher.within(searcher.budget.part(share)))
        if found is not None:
            outcomes.append(found)
    return outcomes


def _search(start: Start, searcher: Searcher) -> Outcome | None:
    """Search with a budget of one's own."""
    return search(searcher.within(searcher.budget.part(1.0)), *start)


def _shorter(searcher: Searcher, plain: Start, outcomes: Sequence[Outcome]) -> Start:
    """Return each relation as it is plain or as the best search left it, whichever has fewer terms."""
    if not outcomes:
        return plain
    best = min(outcomes, key=lambda o: o.rank).fit
    theta, owner = plain[0].copy(), np.array([p.relation for p in searcher.parts])
    present = list[int]()
    for r in range(searcher.relations):
        own, other = plain[1][owner[plain[1]] == r], best.present[owner[best.present] == r]
        if len(other) < len(own):
            theta[own] = 0.0
            theta[other] = best.theta[other]
            own = other
        present += own.tolist()
    return theta, np.array(sorted(present), dtype=np.int64)


def _with_process_noise(
    cut: Callable[[int], Segments], searcher: Searcher, best: Outcome, begun: Sequence[Start]
) -> tuple[Noisy | None, bool]:
    """Return the model with process noise, None where no start can be followed, and whether the record needs it."""
    starts = [*begun, *([(best.fit.theta, best.fit.present)] if np.isfinite(best.width) else [])]
    pieces = in_pieces(cut, searcher, starts)
    process = search_with_process_noise(pieces, starts)
    if process is None:
        return None, False
    if _joined(best) and cost_without_process_noise(pieces, best) < process.penalised:
        return process, False
    # Compared as fitted to all: the proposal has seen what was held out too.
    proposed, found = (free_run_error(pieces, theta) for theta in (begun[0][0], process.fit.theta))
    return process, found < max(NO_WORSE_THAN_PROPOSED * proposed, NEGLIGIBLE)


def _evidence(searcher: Searcher, outcome: Outcome) -> Evidence | None:
    """Return the evidence at the end of a search without process noise, variances at the residuals' level."""
    fit, defect_std = outcome.fit, searcher.segments.spread * outcome.width
    expansion = searcher.evaluator.expand(searcher.whole, fit.theta, searcher.free, fit.x0, defect_std)
    if expansion is None or not expansion.finite:
        return None
    return weigh(searcher, fit, expansion.information / outcome.scale, expansion.gradient[None] / outcome.scale)


def _forward(problem: Problem) -> Relation:
    """Return a sparse forward selection of a relation that holds its target bare, fitted by regression."""
    everything = range(len(problem.terms))
    plain = tuple(j for j in everything if j not in problem.own or j == problem.left)
    path = list(MatchingPursuit(FORWARD_TERMS).supports(problem.factor, problem.left, plain))
    xi = problem.factor.solve((*path[-1], problem.left), problem.left)
    return Relation(tuple(RelationTerm(problem.terms[j], float(xi[j])) for j in (problem.left, *path[-1])))


def _fine_enough(searcher: Searcher, starts: Sequence[Start]) -> Searcher:
    """Halve the steps of RK4 until that no longer matters to the first start that can be followed in loose segments."""
    loose = np.full_like(searcher.segments.spread, np.inf)
    for theta, present in starts:
        found = searcher.fit(theta, present, searcher.segments.initial, loose)
        if found is not None:
            return _halve(searcher, found, loose)[0]
    return searcher


def _finer(searcher: Searcher, outcome: Outcome) -> tuple[Searcher, Outcome]:
    """Halve the steps until that no longer matters at the end of a search."""
    searcher, found = _halve(searcher, outcome.fit, searcher.segments.spread * outcome.width)
    return searcher, replace(outcome, fit=found)


def _halve(searcher: Searcher, found: Fit, defect_std: FloatArray) -> tuple[Searcher, Fit]:
    """Return searcher and fit with steps so short that halving them moves no coefficient by its standard error.

    Where the cost itself hardly changes nothing is refitted. It always does where a term jumps, such as dry friction.
    """
    while searcher.evaluator.substeps < FINEST:
        finer = searcher.finer(2 * searcher.evaluator.substeps)
        again = finer.fit(found.theta, found.present, found.x0, defect_std, iterations=0)
        if again is not None and abs(again.cost - found.cost) < STEP_ERROR:
            break
        refitted = finer.fit(found.theta, found.present, found.x0, defect_std)
        if refitted is None:
            break
        moved = (refitted.theta - found.theta)[found.present] ** 2
        variances = refitted.variances * max(refitted.data_cost / searcher.segments.samples, 1.0)
        same = abs(refitted.cost - found.cost) < STEP_SHARE * found.cost
        searcher, found = finer, refitted
        if same and bool(np.all(moved < STEP_MOVE**2 * variances)):
            break
    return searcher, found
