"""Searches by likelihood from several starts, and from none where no start can be followed.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.events import Monitor, Progress
from odescope.likelihood.budget import Budget
from odescope.likelihood.division import divided_in_part
from odescope.likelihood.followed import states_of
from odescope.likelihood.process_noise import only_noise_lacks
from odescope.likelihood.search import TIED, WIDTHS, Outcome, full, search, torn, unbounded
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import SHORT
from odescope.likelihood.smoothed_targets import singular
from odescope.parallel.workers import Workers

JOINED_SHARE = 0.6  # of the budget, at most, for the searches without process noise
FEW = 160  # averages that more than one model may follow without a doubt
OVERRATED = 0.25  # residual variance over noise variance below which the noise was taken for more than it is
SHORT_RECORD = 1000  # averages: searches of more take long
FOLLOWED = 1.5  # residual variance over noise variance up to which a model is said to follow its record


def joined(outcome: Outcome) -> bool:
    """Say whether the model of a search follows the record to within its noise, segments joined."""
    return bool(np.isfinite(outcome.width)) and outcome.scale < FOLLOWED and not unbounded(outcome.fit)


def searches(
    space: SearchSpace, begun: Sequence[FloatArray], plain: FloatArray | None, monitor: Monitor, workers: Workers
) -> list[Outcome]:
    """Return the ends of searches from these starts, until one is clear; from plain relations too if one fails.

    Of few samples every start is searched from, and where a denominator of the model passes zero; of a record whose
    noise turns out to be less than it was taken for, every one that is shorter than the clear end. An end that lacks
    nothing but noise of the process is the last, too: no other start can be followed more closely. So is one that
    follows the record and that two searches come to. Where the best end has a pole on the data, the first start is
    searched from once more without such models; where it may be a law times something, the law is.

    Every search has its own part of the budget, so that it ends alike wherever it runs.

    Args:
        space: data, candidates, budget.
        begun: (mechanisms,) coefficients of each start.
        plain: those of relations without denominators, None where there are none.
        monitor: told what goes on, and asked whether to stop.
        workers: where it is searched.

    Raises:
        Stopped: the run is to end.
    """
    share = JOINED_SHARE / max(len(begun), 2)
    budget = space.budget.part(share)
    outcomes, failed = _from_all(space, begun, budget, monitor, workers)
    if failed and plain is not None:
        monitor.tell(Progress("likelihood", "search from plain relations", 0, 1))
        found = _search(_shorter(space, plain, outcomes), space.within(space.budget.part(share)))
        if found is not None:
            outcomes.append(found)
    best = min(outcomes, key=lambda o: o.rank, default=None)
    if best is not None and begun and singular(space, best.fit):
        monitor.tell(Progress("likelihood", "search without poles", 0, 1))
        found = _search(begun[0], replace(space, no_poles=True).within(budget.part(1.0)))
        if found is not None and joined(found) and not singular(space, found.fit):
            return [found]
    if best is not None and (begin := divided_in_part(space, best.fit.theta)) is not None:
        monitor.tell(Progress("likelihood", "search from divided relations", 0, 1))
        own = budget.part(min(best.spent / budget.limit, 1.0))
        found = _search(begin, space.with_constants(best.constants).within(own))
        if found is not None:
            outcomes.append(found)
    if not outcomes:
        monitor.tell(Progress("likelihood", "search from nothing", 0, 1))
        found = from_nothing(space.within(space.budget.part(share)))
        if found is not None:
            outcomes.append(found)
    return outcomes


def _from_all(
    space: SearchSpace, begun: Sequence[FloatArray], budget: Budget, monitor: Monitor, workers: Workers
) -> tuple[list[Outcome], bool]:
    """Return the ends of searches from starts until one settles it, and whether some start could not be followed.

    Args:
        space: data, candidates, budget.
        begun: (mechanisms,) coefficients of each start.
        budget: of every search.
        monitor: told what goes on, and asked whether to stop.
        workers: where it is searched.
    """
    outcomes, failed, left = list[Outcome](), False, list(begun)
    monitor.tell(Progress("likelihood", "search", 0, len(begun)))
    while left:
        ends = workers.map(_search, left, space.within(budget), alone=True, check=monitor.check)
        for number, found in enumerate(ends, start=1):
            monitor.check()
            monitor.tell(Progress("likelihood", "search", len(begun) - len(left) + number, len(begun)))
            rest, failed = left[number:], failed or found is None
            if found is None:
                continue
            settled = _settles(space, found) or _met(space, found, outcomes)
            outcomes.append(found)
            if rest and settled:
                left = worth_it(space, found, rest)
                budget = replace(budget, limit=min(budget.limit, found.spent / max(len(left), 1)))
                break
        else:
            break
    return outcomes, failed


def _settles(space: SearchSpace, found: Outcome) -> bool:
    """Say whether the end of a search speaks against searching on.

    What a function with constants says, others can nearly say; and few samples are followed by many models. Where a
    model lacks nothing but noise of the process no other follows the record more closely. What imitates a law leaves
    little to such noise, too, but by terms whose case is thin.
    """
    if space.needed or singular(space, found.fit):
        return False
    if found.clear:
        return space.segments.samples > FEW
    loosely = joined(found) and found.sure and found.width >= WIDTHS[1] and not full(space, found.fit)
    return loosely and space.segments.samples > SHORT_RECORD and only_noise_lacks(space, found.fit.theta)


def _met(space: SearchSpace, found: Outcome, before: Sequence[Outcome]) -> bool:
    """Say whether a search that follows the record ends where another did, though it began elsewhere."""
    alike = any(np.array_equal(found.fit.present, o.fit.present) for o in before if joined(o))
    return alike and joined(found) and not singular(space, found.fit)


def worth_it(space: SearchSpace, found: Outcome, left: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the starts to search from after a clear end; all of these may cost as much as that did.

    A record whose noise was taken for more than it is can be followed by many models to within that, and a shorter one
    may be among these.

    Args:
        space: data, candidates.
        found: the clear end.
        left: (mechanisms,) coefficients of each start that has not been searched from.
    """
    if found.scale > OVERRATED or space.segments.samples > SHORT_RECORD:
        return []
    return [start for start in left if np.count_nonzero(start) < len(found.fit.present)]


def _search(start: FloatArray, space: SearchSpace) -> Outcome | None:
    """Search with a budget of one's own; from short segments where the start is lost in those of usual length.

    The further a model is from the record, the shorter it can be followed. Of much noise a short segment says next to
    nothing; tied to its neighbours from the beginning it does. The end is judged in the usual segments again.
    """
    space = space.within(space.budget.part(1.0))
    found = search(space, start)
    if found is not None and joined(found):
        return found
    if found is not None and space.budget.over:
        return replace(found, spent=space.budget.spent)
    short = space.on(space.segments.cut_anew(SHORT))
    near = search(short, start, TIED)
    ends = [o for o in (found, _from_short(space, short, near)) if o is not None]
    best = min(ends, key=lambda o: o.rank, default=None)
    if best is None:
        return None
    tried = () if joined(best) else ((found, space), (near, short))
    loose = tuple(o.fit.theta for o, where in tried if o is not None and _open(where, o))
    return replace(best, spent=space.budget.spent, loose=loose)


def _open(space: SearchSpace, outcome: Outcome) -> bool:
    """Say whether a model that cannot be joined follows a record in open segments, without terms for everything."""
    follows = outcome.finished and outcome.scale < FOLLOWED
    return follows and not torn(space, outcome.fit) and not full(space, outcome.fit)


def _from_short(space: SearchSpace, short: SearchSpace, near: Outcome | None) -> Outcome | None:
    """Return the end of a search that goes on from one in short segments, None where that was lost in those, too.

    It begins from the states that this has: where a state is hardly left, what is smoothed lies on either side of it,
    and runs away in longer segments. Of few samples short segments follow the noise.

    Args:
        space: the usual segments.
        short: the short ones.
        near: where the search in those ended.
    """
    if near is None or near.width >= TIED[0] or not joined(near):
        return None
    usual, x0 = space.with_constants(near.constants), space.segments.initial
    if space.segments.samples > FEW:
        states, seen = states_of(short.with_constants(near.constants), near.fit)
        x0 = np.where(seen[:, None], states, space.segments.filtered)[space.segments.start]
    return search(usual, near.fit.theta, x0=x0)


def from_nothing(space: SearchSpace) -> Outcome | None:
    """Return the end of a search that begins with bare targets, in short segments, None where it is lost.

    Where a signal is too fast for its samples regression has its derivative wrong, and what it proposes runs away. Free
    runs through short segments need no derivative. While a model lacks most of its law a denominator stands for much of
    that: explicit terms come first, and fractions where these are lost.
    """
    bare = np.array([float(space.stays(k)) if m.known is None else m.known for k, m in enumerate(space.mechanisms)])
    if np.count_nonzero(bare) < space.relations:  # Lagrange's equations have no bare targets
        return None
    short, every = space.on(space.segments.cut_anew(SHORT)), np.arange(len(space.mechanisms))
    parts = [[p.product for p in m.parts] for m in space.mechanisms]
    explicit = np.flatnonzero([all(p.factor is None or p.bare for p in own) for own in parts])
    for kept in (explicit, every) if len(explicit) < len(every) else (every,):
        near = search(short.among([space.mechanisms[k] for k in kept]), bare[kept], TIED)
        found = None if near is None else _from_short(space, short, near.padded(kept, len(every)))
        if found is not None:
            return replace(found, spent=space.budget.spent)
    return None


def _shorter(space: SearchSpace, plain: FloatArray, outcomes: Sequence[Outcome]) -> FloatArray:
    """Return each relation as it is plain or as the best search left it, whichever has fewer terms."""
    if not outcomes:
        return plain
    best = min(outcomes, key=lambda o: o.rank).fit.theta
    theta, owner = plain.copy(), np.array([min(m.relations, default=-1) for m in space.mechanisms])
    for r in range(space.relations):
        if np.count_nonzero(best[owner == r]) < np.count_nonzero(plain[owner == r]):
            theta[owner == r] = best[owner == r]
    return theta
