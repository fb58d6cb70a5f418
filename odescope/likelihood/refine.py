"""The likelihood stage: from the relations that regression proposes to the model that the trajectory supports."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.events import Monitor, Progress
from odescope.library.constants import Constant
from odescope.library.mechanism import Mechanism
from odescope.likelihood.anew import with_steps_settled
from odescope.likelihood.budget import Budget
from odescope.likelihood.centring import Centring
from odescope.likelihood.division import divided_in_part
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.evidence import Evidence, weigh
from odescope.likelihood.families import promising
from odescope.likelihood.held_out import thinned, without_held_out
from odescope.likelihood.holds import holds_of
from odescope.likelihood.input_searches import Between
from odescope.likelihood.local_minima import out_of_local_minima
from odescope.likelihood.look_alikes import with_simpler_terms
from odescope.likelihood.negligible import without_negligible
from odescope.likelihood.noise_or_terms import cost_without_process_noise, likelier_with_process_noise
from odescope.likelihood.path import ModelPath, telling
from odescope.likelihood.process_noise import PATH_SHARE, Noisy, in_pieces, search_with_process_noise
from odescope.likelihood.program import Frame
from odescope.likelihood.refinement import Refinement, leaves_noise
from odescope.likelihood.search import LikelihoodSearch, Outcome, fitted_again, in_whole
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import JOINED_SHARE, joined, searches
from odescope.likelihood.segments import SEGMENT, Segments
from odescope.likelihood.settings import Start, Starts, with_settings
from odescope.likelihood.settled_noise import with_noise_settled
from odescope.likelihood.steps import with_narrow_friction
from odescope.likelihood.taken_out import with_terms_outside
from odescope.likelihood.undecided_holds import undecided_holds
from odescope.parallel.workers import Threads, Workers
from odescope.recordings.coordinate import Hold
from odescope.recordings.record import Records
from odescope.signals.differentiators import Differentiator
from odescope.signals.estimate import Signals

THREADS = Threads()
NO_WORSE_THAN_PROPOSED = 1.5  # mean squared error of free runs over that of the regression's model, unless it is
WELL = 0.1  # error of free runs, in standard deviations, of a model that leaves another little to find


def refine(
    records: Records,
    signals: Signals,
    mechanisms: Sequence[Mechanism],
    starts: Starts,
    differentiator: Differentiator,
    options: LikelihoodSearch,
    monitor: Monitor = Monitor(),  # noqa: B008
    workers: Workers = THREADS,
    late: Collection[str] = (),
    held: Collection[str] = (),
    declared: Sequence[Constant] = (),
    deadline: float | None = None,
) -> Refinement | None:
    """Return the best end of the searches from several starts, or None where no start can be followed.

    Args:
        records: uniformly sampled, at one period.
        signals: noise, cutoffs and order of states found in them.
        mechanisms: the candidates.
        starts: to begin from.
        differentiator: that the signals were found with.
        options: how many starts, at what budget.
        monitor: told what goes on, and asked whether to stop.
        workers: where it is searched from the starts.
        late: names of the inputs whose delays are open.
        held: names of the inputs whose holds are open.
        declared: constants within functions that the candidates name.
        deadline: of the clock (`time.time`), after which the best so far is returned; None for none.

    Raises:
        InputError, Stopped: the path of models has none of so many terms; the run is to end.
    """
    everything, constants = with_settings(mechanisms, signals, late, declared)
    frame = _frame(signals, everything, constants, declared)
    whole = partial(Start.among, mechanisms=everything, frame=frame)
    begun, bare = [whole(s) for s in starts.first], None if starts.plain is None else whole(starts.plain)
    budget = Budget(options.budget, monitor, deadline)
    known = Between.of(records, signals, differentiator, held)
    space = SearchSpace(Evaluator(known.cut(known.holds, SEGMENT), 1, budget), everything, frame)
    begun = promising(space.on(thinned(space.segments)), begun) if declared else begun
    known, space = known.first(space, begun)
    seen = space.on(thinned(space.segments))
    outcomes = searches(seen, begun, bare, monitor, workers)
    between, seen, outcomes, gains = known.searched(seen, begun, outcomes, monitor, workers)
    if starts.rival is not None:
        outcomes += searches(seen, [whole(starts.rival)], None, monitor, workers)
    more = starts.further(_constants(seen, outcomes)) if _worth_more(outcomes) else None
    if more is not None:
        begun = [whole(more), *begun]
        outcomes += searches(seen, begun[:1], None, monitor, workers)
        between, seen, outcomes, gains = between.searched(seen, begun, outcomes, monitor, workers)
    if between is not known or holds_of(seen) != holds_of(space):
        space = seen.on(between.cut(holds_of(seen), SEGMENT))
    ended = partial(_ended, hold_gains=gains, terms=options.terms, workers=workers)
    found = ended(between, space, seen, outcomes, begun)
    if found is None or found.process is None or (later := between.where_known(found.space, found.fit)) is None:
        return found
    seen, outcomes = later.anew(space, holds_of(space), [found.fit.theta, *begun], monitor, workers)
    return ended(later, seen.on(later.cut(holds_of(seen), SEGMENT)), seen, outcomes, begun) or found


def _ended(
    between: Between,
    space: SearchSpace,
    seen: SearchSpace,
    outcomes: Sequence[Outcome],
    begun: Sequence[FloatArray],
    hold_gains: Mapping[str, float],
    terms: int | None,
    workers: Workers,
) -> Refinement | None:
    """Return what the best end of searches comes to, None where there is none."""
    space, best = with_noise_settled(*_best(space, seen, outcomes), begun, workers)
    if best is None:
        return None
    near = [theta for o in outcomes for theta in o.loose]
    found = _judged(between, space, begun, near, best, len(outcomes), hold_gains, terms, workers)
    return replace(found, steps=between.placed, unknown=between.unknown)


def _frame(
    signals: Signals, mechanisms: Sequence[Mechanism], constants: Mapping[str, Constant], declared: Sequence[Constant]
) -> Frame:
    """Return what the relations are about, exponentials with declared constants about the middle of the signals."""
    centring = Centring.of(mechanisms, [c.name for c in declared], signals.names, signals.joined())
    return Frame.of(signals.coordinates, [i.name for i in signals.inputs], constants, centring)


def _worth_more(outcomes: Sequence[Outcome]) -> bool:
    """Say whether to search from one more start: all were lost, or one came to its end, and none is clear or near.

    Where all of them spent their budgets another would do so, too.
    """
    if any(o.clear or o.loose for o in outcomes):
        return False
    return not outcomes or any(o.finished for o in outcomes)


def _constants(space: SearchSpace, outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Return the constants within functions where the best search ended, by name."""
    if not outcomes:
        return {}
    theta = min(outcomes, key=lambda o: o.rank).fit.theta
    return {name: space.frame.constants[name].at(float(theta[k])) for name, k in space.needed.items()}


def _best(space: SearchSpace, seen: SearchSpace, outcomes: Sequence[Outcome]) -> tuple[SearchSpace, Outcome | None]:
    """Return the best end of searches in what was seen of a record, as it is in the whole of it, and that space."""
    space.budget.spent += sum(o.spent for o in outcomes)
    best = min(outcomes, key=lambda o: o.rank, default=None)
    if best is None:
        return space, None
    space = space.with_constants(best.constants)
    return space, in_whole(space, best) if len(seen.segments.start) < len(space.segments.start) else best


def _judged(
    between: Between,
    space: SearchSpace,
    begun: Sequence[FloatArray],
    near: Sequence[FloatArray],
    best: Outcome,
    searches: int,
    hold_gains: Mapping[str, float],
    terms: int | None,
    workers: Workers,
) -> Refinement:
    """Return the best end of the searches, or the model with process noise where that describes the record better."""
    if joined(best):
        space, best = with_steps_settled(space, best, begun, workers)
        space, best = with_narrow_friction(space, without_negligible(space, out_of_local_minima(space, best)))
        best = with_simpler_terms(space, without_negligible(space, best))  # friction is wider, and may ask for less
    cut, apart = partial(between.cut, holds_of(space)), dict[str, Hold]()
    process, adopted, scale, begin, only_noise = None, False, best.scale, None, leaves_noise(space, best)
    path = _path(space, best) if only_noise else None
    if path is not None:
        begin = likelier_with_process_noise(cut, space, best, path)
    if not only_noise or begin is not None:
        space.budget.monitor.tell(Progress("likelihood", "search with process noise", 0, 1))
        near = near if begin is None else [begin, *near]
        process, adopted = _with_process_noise(cut, space, best, begun, near, terms)
    evidence: Evidence | None
    if process is not None and adopted:
        found, last, evidence, path = process.fit, process.space, process.evidence, process.path
        covariance = evidence.covariance
    else:
        path = path or _path(space, best)
        if terms is not None:
            if path is None:
                raise InputError(f"[likelihood] terms = {terms}: too little is left to fit when a part is held out")
            path, best, scale = _shortened(space, best, path.chosen_at(terms))
        found, last, evidence = best.fit, space, _evidence(space, best, scale)
        undecided = undecided_holds(space, found, between.open, best.width, scale)
        known = between.covariance(space, found, best.width)
        covariance, apart = known * scale + undecided.covariance, undecided.others
    found, covariance = with_terms_outside(last, found, covariance)
    return Refinement(
        relations=last.relations_of(found, covariance),
        mechanisms=last.mechanisms_of(found, covariance),
        settings=last.settings_of(found, covariance),
        covariance=covariance,
        outcome=best,
        scale=scale,
        process=process if adopted else None,
        rejected=None if adopted else process,
        fit=found,
        space=last,
        evidence=evidence,
        path=path,
        starts=searches,
        finished=best.finished and not last.budget.over,
        late=best.late or last.budget.late,
        spent=space.budget.spent,
        hold_gains=hold_gains,
        undecided=apart,
    )


def _with_process_noise(
    cut: Callable[[int], Segments],
    space: SearchSpace,
    best: Outcome,
    begun: Sequence[FloatArray],
    near: Sequence[FloatArray],
    terms: int | None,
) -> tuple[Noisy | None, bool]:
    """Return the model with process noise, None where no start can be followed, and whether the record needs it.

    Args:
        cut: cuts the data into segments of so many averages.
        space: data and candidates.
        best: the best end of the searches for a model that follows the record to within its noise.
        begun: what these began from.
        near: models that they found to follow it in open segments alone, if any did: what they began from is no nearer.
        terms: number of mechanisms to stop at, where that is given.
    """
    # What a search has found is nearest, should the budget end the others.
    starts = [*near, best.fit.theta] if near else [best.fit.theta, *begun]
    parts = (divided_in_part(space, theta) for theta in starts)
    starts = [*starts, *(theta for theta in parts if theta is not None)]
    # Where there is process noise no search without it comes to an end: they leave a share of the budget.
    own = space.budget.rest(1.0 - JOINED_SHARE)
    pieces = in_pieces(cut, replace(space.within(own), zeros_are_off=True), starts)
    process = search_with_process_noise(pieces, starts, terms)
    space.budget.spent += own.spent
    if process is None:
        return None, False
    if joined(best) and cost_without_process_noise(pieces, best) < process.penalised:
        return process, False
    # Compared as fitted to all: the proposal has seen what was held out too.
    proposed, found = (float(np.mean(e**2)) for e in telling(pieces, (begun[0], process.fit.theta))[1])
    return process, found < max(NO_WORSE_THAN_PROPOSED * proposed, WELL**2)


def _path(space: SearchSpace, outcome: Outcome) -> ModelPath | None:
    """Return the models from the end of a search to the shortest, fitted without what is held out."""
    seen = space.on(without_held_out(space.segments)).within(space.budget.part(PATH_SHARE))
    if not len(seen.segments.start):
        return None
    defect_std = space.segments.spread * outcome.width
    # From where the model stands: it may run away from a smoothed state that is on the wrong side of nothing.
    x0 = seen.segments.initial
    _, there, known = np.intersect1d(seen.segments.start, space.segments.start, return_indices=True)
    x0[there] = outcome.fit.x0[known]
    found = seen.again(outcome.fit, x0, defect_std)
    return None if found is None else ModelPath.back(seen, found, defect_std, rough=True)


def _shortened(space: SearchSpace, outcome: Outcome, path: ModelPath) -> tuple[ModelPath, Outcome, float]:
    """Return the path, the outcome with the model that is chosen on it, fitted to all, and the scale of what it leaves.

    Who asks for fewer terms gets them: the scale of the outcome stays that of what the search found, so that nothing
    else is searched for what they lack.
    """
    shorter = space.again(path.choice.fit, space.segments.initial, space.segments.spread * outcome.width)
    if shorter is None:
        return path, outcome, outcome.scale
    end = fitted_again(space, outcome, shorter)
    return path, replace(end, scale=outcome.scale), end.scale


def _evidence(space: SearchSpace, outcome: Outcome, scale: float) -> Evidence | None:
    """Return the evidence at the end of a search without process noise, variances at the residuals' level."""
    fit, defect_std = outcome.fit, space.segments.spread * outcome.width
    expansion = space.evaluator.expand(space.whole, fit.theta, space.free(fit), fit.x0, defect_std)
    if expansion is None or not expansion.finite:
        return None
    return weigh(space, fit, expansion.information / scale, expansion.gradient[None] / scale)
