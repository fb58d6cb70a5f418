"""Functions that the library lacks: one search more with them, where a model or its residual asks for some."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import hypot

import msgspec
import numpy as np

from odescope.events import Progress
from odescope.library.readable import readable
from odescope.likelihood.alternatives import alternative
from odescope.likelihood.beginnings import EVIDENT
from odescope.likelihood.path import FAITHFUL
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.standing import Alternative
from odescope.likelihood.suspicion import (
    JOINT,
    Reason,
    Suspicion,
    everywhere,
    suspicions,
    values_of_variables,
    with_pairs,
)
from odescope.model.relation import Relation, RelationTerm
from odescope.model.scores import SuspicionScore
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.stages import refine_form
from odescope.pipeline.units import units_of
from odescope.pipeline.work import Work

FAR_BETTER = 0.5  # of the error of free runs
NO_WORSE = 1.1  # times the error of free runs: over stretches of one record errors differ by as much and mean nothing
UNASKED: tuple[Reason, ...] = (*JOINT, "measured")  # reasons that nothing is told of where they are in vain
ALIKE = 4.0  # standard errors that coefficients of one denominator in two relations differ by, at most
MANY = 6  # terms of a fraction, twice as many as a function has numbers: fewer may be a law
LEAST = 0.5  # units of budget: what the comparison may cost where the search before cost next to nothing


def with_suspected(
    work: Work, filtered: Filtered, posed: Posed, refinement: Refinement
) -> tuple[Refinement, tuple[SuspicionScore, ...]]:
    """Return the model with functions that it imitates, where the likelihood prefers that, and what was suspected.

    What is left of imitations beside the first functions is looked at once more: one that stood beside others was as
    far from its function as these were from theirs.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        posed: the relations.
        refinement: the model so far, which stays as it is where nothing is better.
    """
    wide, found, scores = _suspecting(work, filtered, posed, refinement, _suspicions(work, refinement))
    left = () if found is refinement else _suspicions(work, found)
    if not any(s.terms for s in left):
        return found, scores
    _, again, more = _suspecting(work, filtered, wide, found, left)
    if again is not found:
        return again, _joined(scores, more, again)
    known = {_of_what(s) for s in scores}
    return found, (*scores, *(s for s in more if _of_what(s) not in known))


def _suspecting(
    work: Work, filtered: Filtered, posed: Posed, refinement: Refinement, suspected: Sequence[Suspicion]
) -> tuple[Posed, Refinement, tuple[SuspicionScore, ...]]:
    """Return the relations and the model with functions in the place of what is suspected, and what was.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        posed: the relations.
        refinement: the model so far, which stays as it is where nothing is better.
        suspected: of it, before anything else is.
    """
    enough = max(work.left, work.study.likelihood.budget)  # what others spent in vain is not taken from functions
    wide, found, scores = _once(work, filtered, posed, refinement, with_pairs(suspected), enough)
    for others in _otherwise(work, refinement, suspected) if found is refinement else ():
        wide, found, own = _once(work, filtered, posed, refinement, others, work.left)
        if found is not refinement:
            here = {s.relation for s in others}
            targets = {found.space.frame.targets[r] for r in here}
            return wide, found, (*(s for s in scores if s.target not in targets), *own)
    return wide, found, scores


def _otherwise(work: Work, refinement: Refinement, suspected: Sequence[Suspicion]) -> Iterator[tuple[Suspicion, ...]]:
    """Yield what else may be suspected where no functions were found in the place of what was.

    Relations one at a time, where what divides them differs: a function of a variable has the same constants in all
    relations of one choice. Then all variables: what a model says that does not follow the record is not even an
    imitation, and what has poles is near to no function. What has few terms may be a law itself.

    Args:
        work: whose study says of which variables functions may be looked for.
        refinement: the model.
        suspected: what was suspected of it.
    """
    able = {s.relation for s in suspected if s.reason == "fractions" and s.terms > MANY}
    if refinement.exact:
        apart = sorted((s for s in suspected if _apart(refinement, s, suspected)), key=lambda s: -s.terms)
        for relation in dict.fromkeys(s.relation for s in apart):
            yield tuple(s for s in suspected if s.relation == relation)
    elif not (refinement.says_all or refinement.hardly_off):
        able = set(range(len(refinement.space.frame.targets)))
    if able and not work.late:
        yield everywhere(refinement, able, work.study.suspects, work.study.parameters)


def _apart(refinement: Refinement, one: Suspicion, suspected: Sequence[Suspicion]) -> bool:
    """Say whether a variable is suspected in a relation and in others, none of which is divided by the same.

    Args:
        refinement: the model.
        one: the suspicion.
        suspected: all of them.
    """
    others = [s for s in suspected if s.variable == one.variable and s.relation != one.relation]
    own = refinement.relations[one.relation]
    return bool(others) and not any(_divided_alike(own, refinement.relations[s.relation]) for s in others)


def _divided_alike(one: Relation, other: Relation) -> bool:
    """Say whether two relations are divided by the same, as balances are that hold one rate."""
    below = [{t.term: t for t in r.left} for r in (one, other)]
    if below[0].keys() != below[1].keys():
        return False
    first, *rest = below[0]
    for term in rest:
        (a, ea), (b, eb) = (_ratio(there[term], there[first]) for there in below)
        if abs(a - b) > ALIKE * hypot(ea, eb):
            return False
    return True


def _ratio(one: RelationTerm, other: RelationTerm) -> tuple[float, float]:
    """Return the ratio of two coefficients, and its standard error without what the two have in common."""
    ratio = one.coefficient / other.coefficient
    return ratio, abs(ratio) * hypot(*((t.std_error or 0.0) / t.coefficient for t in (one, other)))


def _once(
    work: Work, filtered: Filtered, posed: Posed, refinement: Refinement, suspected: Sequence[Suspicion], most: float
) -> tuple[Posed, Refinement, tuple[SuspicionScore, ...]]:
    """Return the relations and the model with functions in the place of what is suspected, and what came of it.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        posed: the relations.
        refinement: the model so far, which stays as it is where nothing is better.
        suspected: of it.
        most: units of budget, at most.
    """
    if not suspected:
        return posed, refinement, ()
    with work.stage("suspicion"):
        work.monitor.tell(Progress("suspicion", "search with functions that the library lacks", 0, 1))
        limit = min(max(refinement.spent, LEAST), most)
        found = alternative(refinement, suspected, len(posed.mechanisms), limit, units_of(filtered))
        work.searches.spent += 0.0 if found is None else found.spent
    better = None
    if found is not None and _promises(refinement, found):
        wide = replace(
            posed,
            mechanisms=(*posed.mechanisms, *found.mechanisms),
            constants=(*posed.constants, *found.constants),
            starts=(found.start,),
            plain=None,
            rival=None,
            again=lambda _: None,
        )
        other = refine_form(work, filtered, wide)
        if other is not None and replaces(other, refinement):
            posed, better = wide, other
    kept = better or refinement
    rest = suspected if better is None else _suspicions(work, better)
    left = {(s.relation, s.variable): s.terms for s in rest}
    scores = (
        _scored(replace(s, terms=left.get((s.relation, s.variable), 0)), k, found, kept, refinement)
        for k, s in enumerate(suspected)
    )
    return posed, kept, tuple(s for s in scores if s.found or s.reason not in UNASKED)


def _suspicions(work: Work, refinement: Refinement) -> tuple[Suspicion, ...]:
    """Return what is suspected of a model, of variables, too, whose functions were found and whose powers are left."""
    return suspicions(refinement, work.study.suspects, work.study.parameters)


def left_over(work: Work, refinement: Refinement, before: Sequence[SuspicionScore]) -> tuple[SuspicionScore, ...]:
    """Return what is suspected of a model with another library, which came after functions had been tried.

    Args:
        work: whose study says of which variables functions may be looked for.
        refinement: the model.
        before: what was made of the suspicions against the model before it.
    """
    tried = {(s.target, s.variable): s.tried for s in before}
    targets = refinement.space.frame.targets
    left = (s for s in _suspicions(work, refinement) if s.terms)
    return tuple(_score(s, refinement, tried.get((targets[s.relation], s.variable), ()), (), None) for s in left)


def _joined(
    first: Sequence[SuspicionScore], second: Sequence[SuspicionScore], kept: Refinement
) -> tuple[SuspicionScore, ...]:
    """Return what was made of suspicions in two passes: those of the second, and what the first found and is left.

    Args:
        first: of the first pass.
        second: of the other.
        kept: the model in the end.
    """
    targets = kept.space.frame.targets
    here = {(target, text) for r, target in enumerate(targets) for text in _terms(kept, r)}
    left = {_of_what(s): tuple(text for text in s.found if (s.target, text) in here) for s in first}
    again = {_of_what(s): msgspec.structs.replace(s, found=(*left.get(_of_what(s), ()), *s.found)) for s in second}
    rest = (msgspec.structs.replace(s, found=left[_of_what(s)]) for s in first if _of_what(s) not in again)
    return (*rest, *again.values())


def _of_what(score: SuspicionScore) -> tuple[str, str]:
    """Return the target and the variable that were suspected, or what else if it was none."""
    return score.target, score.variable or score.reason


def _promises(refinement: Refinement, found: Alternative) -> bool:
    """Say whether a model with functions may be better than the one without."""
    if not found.mechanisms:
        return False
    if refinement.follows:
        return found.gain is not None and found.gain > found.least
    return found.outcome is not None and found.outcome.rank < refinement.outcome.rank


def replaces(other: Refinement, refinement: Refinement) -> bool:
    """Say whether a model with functions replaces the one without: only one that follows the record does.

    Of two that do, the one that follows it in longer pieces stays, else the likelier. Where the other did not, what the
    record lacks for a law may be put down to functions, so these must run freely no worse over what is held out, or be
    evidently likelier, take the place of as many terms and run about as well, errors from stretch to stretch allowed
    for; nor may they run worse where likelihoods do not compare, unless it is the other that needs noise of the process
    to follow. With such noise they are to be evidently likelier, of as few terms or far better.
    """
    gain, error, before = other.gained_over(refinement), other.free_run_error, refinement.free_run_error
    evident = gain is not None and gain > EVIDENT
    apart = 0.0 if other.path is None else other.path.choice.spread
    near = error <= NO_WORSE * before or error <= FAITHFUL or error - apart <= before
    fair = len(other.fit.free) <= len(refinement.fit.free) and near
    if other.process is not None:
        return evident and (fair or error < FAR_BETTER * before)
    if not other.exact:
        return False
    if refinement.exact and other.outcome.width != refinement.outcome.width:
        return other.outcome.width < refinement.outcome.width
    likelier = gain is None or gain > 0.0
    alone = gain is None and refinement.process is not None and other.outcome.sure
    return likelier and (error <= before or (refinement.exact and gain is not None) or ((evident or alone) and fair))


def _scored(
    suspicion: Suspicion, number: int, found: Alternative | None, kept: Refinement, before: Refinement
) -> SuspicionScore:
    """Return what was made of a suspicion.

    Args:
        suspicion: what was suspected.
        number: which of all.
        found: the model with functions, where there was one.
        kept: the model in the end.
        before: the model before, whose own terms were not tried in its place.
    """
    own, terms = _terms(before, suspicion.relation), _terms(kept, suspicion.relation)
    tried = () if found is None else tuple(t for t in found.tried[number] if t not in own)
    gain = None if found is None else found.gain
    return _score(suspicion, kept, tried, tuple(t for t in terms if t in tried), gain)


def _score(
    suspicion: Suspicion, kept: Refinement, tried: tuple[str, ...], found: tuple[str, ...], gain: float | None
) -> SuspicionScore:
    """Return what is told of a suspicion.

    Args:
        suspicion: what was suspected.
        kept: the model in the end.
        tried: functions, as people read them.
        found: those that the model holds.
        gain: of these.
    """
    seen = values_of_variables(kept.space).get(suspicion.variable, np.zeros(1))
    return SuspicionScore(
        target=kept.space.frame.targets[suspicion.relation],
        variable=suspicion.variable,
        reason=suspicion.reason,
        terms=suspicion.terms,
        low=float(seen.min()),
        high=float(seen.max()),
        tried=tried,
        found=found,
        gain=gain,
    )


def _terms(refinement: Refinement, relation: int) -> list[str]:
    """Return the terms of a relation of a model as people read them."""
    parts = (p for k in refinement.fit.present for p in refinement.space.mechanisms[k].parts)
    return [readable(p.product.term) for p in parts if p.relation == relation]
