"""From hundreds of candidate relations to one a target: what is discarded and why, held-out scores, families."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec
import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.errors import NoModelError
from odescope.regression.problem import Problem
from odescope.regression.proposers import Support
from odescope.selection.criterion import penalty
from odescope.selection.score import Scores, score
from odescope.selection.sweep import Sweep
from odescope.selection.unmeasured import FOLLOWS, own_dynamics

MOST_HELD_OUT = 0.9  # of a target's power: what is left elsewhere, as of a system at rest, does not tell its law
USUAL = 2  # order of a coordinate, at most: to one whose order is higher a higher one still is no advice
LACKING = (
    "Either the library lacks the right terms, or something that drives the system was not recorded, or a state of it"
    " was not measured, or there is too much noise"
)


class Ranking(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How candidates are kept and ranked.

    Attributes:
        terms: how many terms a relation has at most.
        consensus: from how many guesses of the left-hand side, at least, a relation must have been found.
        explain: the least part of the target's power on held-out data, as weighted in the regression, that the chosen
            relation must predict.
    """

    terms: Annotated[int, msgspec.Meta(ge=1)] = 15
    consensus: Annotated[int, msgspec.Meta(ge=1)] = 2
    explain: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.5


@dataclass(frozen=True, eq=False)
class Candidate:
    """One relation for one target.

    xi (m,) are its coefficients over the library, that of the target's first term 1. `criterion` is what ranks it:
    n ln(held-out residual^2) + terms (ln n + 2 ln m), and what data beyond the signals add. `explained` is the part of
    the target's weighted power that it predicts on held-out data, `target_rmse` the error of its prediction there in
    units of the target.
    """

    target: str
    support: Support
    guesses: tuple[int, ...]
    guess: int
    xi: FloatArray
    implicit_rmse: float
    target_rmse: float
    target_r2: float
    explained: float
    criterion: float
    cluster: int
    family: int


@dataclass(frozen=True)
class Ranked:
    """The candidates of one target, best first, and the tally of what was discarded and why."""

    candidates: tuple[Candidate, ...]
    discarded: tuple[tuple[str, int], ...]


def rank(problem: Problem, found: Sweep, options: Ranking) -> Ranked:
    """Return the candidates of one target, best first.

    Args:
        problem: of the target.
        found: supports, and who found them.
        options: what is kept.

    Raises:
        NoModelError: nothing is left, or what is left predicts nothing.
    """
    ranked = ranking(problem, found, options)
    require_law(problem, ranked, options)
    return ranked


def ranking(problem: Problem, found: Sweep, options: Ranking) -> Ranked:
    """Return the candidates of one target, best first, whatever they predict; there may be none.

    Where one fold holds nearly all that happens, as in a record that comes to rest, the others do not tell what is
    asked of them. If no relation passes, relations are then tried on what they are fitted on.

    Args:
        problem: of the target.
        found: supports, and who found them.
        options: what is kept.
    """
    discarded: Counter[str] = Counter()
    keep = []
    for k, (support, guesses) in enumerate(zip(found.supports, found.guesses, strict=True)):
        reason = _refusal(problem, support, guesses, options)
        if reason:
            discarded[reason] += 1
        else:
            keep.append(k)
    if not keep:
        return Ranked((), tuple(discarded.items()))
    kept = found.restrict(keep)
    labels = kept.clusters()
    scores = score(problem, kept.supports, [left_column(problem, s) for s in kept.supports])
    poles = int((~scores.sound).sum())
    if poles:
        discarded["with a denominator that changes sign inside the data"] = poles
    criteria = _criteria(problem, kept.supports, scores)
    scored = [
        (int(k), _candidate(problem, kept, labels, scores, criteria, int(k))) for k in np.flatnonzero(scores.sound)
    ]
    if not scored:
        return Ranked((), tuple(discarded.items()))
    ranked = _families(problem, sorted(scored, key=lambda pair: pair[1].criterion), scores)
    poor = ranked[0].explained < options.explain
    if poor and len(problem.folds) > 1 and problem.most_held_out > MOST_HELD_OUT:
        return ranking(problem.in_one_fold, found, options)
    return Ranked(ranked, tuple(discarded.items()))


def require_law(problem: Problem, ranked: Ranked, options: Ranking) -> None:
    """Refuse candidates among which none can be the law of the target.

    Args:
        problem: of the target.
        ranked: its candidates.
        options: what the best one must predict.

    Raises:
        NoModelError: there are none, or the best one predicts too little.
    """
    if not ranked.candidates:
        tally = "; ".join(f"{count} {reason}" for reason, count in ranked.discarded)
        count = sum(count for _, count in ranked.discarded)
        raise NoModelError(
            "selection", f"of {count} relations that were found for {problem.target} none is left: {tally}. {LACKING}"
        )
    best = ranked.candidates[0]
    if best.explained < options.explain:
        raise NoModelError(
            "selection",
            f"the best of {len(ranked.candidates)} relations for {problem.target} predicts"
            f" {max(best.explained, 0.0):.0%} of it on"
            f" held-out data, less than the {options.explain:.0%} asked for ([selection] explain)."
            f" {LACKING}{_higher_order(problem, best)}",
        )


def _higher_order(problem: Problem, best: Candidate) -> str:
    """Return what to say where what a relation leaves, or the target itself, behaves as a state; else nothing."""
    alone = np.zeros(len(best.xi))
    alone[problem.left] = 1.0
    part = max(own_dynamics(problem, best.xi), own_dynamics(problem, alone))
    if part < FOLLOWS:
        return ""
    c = next(c for c in problem.signals.coordinates if c.target == problem.target)
    if c.order > USUAL:
        return f". Try a lower order for {c.name}: 1 for an amount, 2 for a position"
    return (
        f". What it leaves has dynamics of its own, though: {part:.0%} of its rate follow from itself and from what was"
        f" recorded, as for a state that was not measured. Try order = {c.order + 1} for {c.name}"
    )


def _refusal(problem: Problem, support: Support, guesses: tuple[int, ...], options: Ranking) -> str:
    if not set(support) & set(problem.own):
        return f"without {problem.target}"
    if len(support) > options.terms:
        return f"with more than {options.terms} terms"
    if len(support) > problem.factor.rows:
        return "with a coefficient for every independent value of the record"
    if len(guesses) < options.consensus:
        return f"that fewer than {options.consensus} of the searches agree on"
    return ""


def left_column(problem: Problem, support: Support) -> int:
    """Return the target term that gets the coefficient 1: the target itself, else its first product."""
    return problem.left if problem.left in support else next(j for j in problem.own if j in support)


def criteria(problem: Problem, supports: Sequence[Support]) -> FloatArray:
    """Return the criterion of each relation (C,), infinite where its denominator changes sign inside the data."""
    scores = score(problem, supports, [left_column(problem, s) for s in supports])
    return np.where(scores.sound, _criteria(problem, supports, scores), np.inf)


def as_candidate(problem: Problem, support: Support, found: Sweep) -> Candidate | None:
    """Return a relation as a candidate in a cluster and a family of its own; None where its denominator changes sign.

    Args:
        problem: of the target.
        support: its columns, a target term among them.
        found: what searches came upon: the guesses that led to it, if any.
    """
    if not set(support) & set(problem.own):
        return None
    scores = score(problem, [support], [left_column(problem, support)])
    if not scores.sound[0]:
        return None
    known = dict(zip((tuple(sorted(s)) for s in found.supports), found.guesses, strict=True))
    guesses = known.get(tuple(sorted(support)), ())
    alone = Sweep((support,), (guesses or support,), found.width)
    candidate = _candidate(
        problem, alone, np.zeros(1, dtype=np.int64), scores, _criteria(problem, [support], scores), 0
    )
    return replace(candidate, guesses=guesses, cluster=-1)


def _criteria(problem: Problem, supports: Sequence[Support], scores: Scores) -> FloatArray:
    """Return what ranks each relation, (C,).

    Where the signals are but a sample, all the data rank relations with the same target terms, and the best of these
    compete on the signals.
    """
    dear = float(penalty(problem.factor.rows, 1.0 / len(problem.terms)))
    terms = np.array([len(s) for s in supports])
    here = scores.rows * np.log(_noise(scores)) + terms * dear
    if scores.elsewhere is None:
        return here
    everywhere, ranked = here + scores.elsewhere, here.copy()
    groups: dict[frozenset[int], list[int]] = {}
    for k in np.flatnonzero(scores.sound).tolist():
        groups.setdefault(frozenset(supports[k]) & frozenset(problem.own), []).append(k)
    for members in groups.values():
        best = min(members, key=lambda k: everywhere[k])
        ranked[members] = here[best] + everywhere[members] - everywhere[best]
    return ranked


def _noise(scores: Scores) -> FloatArray:
    """Return the mean square of the held-out residual in rows, (C,).

    A residual of rounding alone cannot rank: the floor makes exact relations equal, and the simplest of them wins.
    """
    noise: FloatArray = np.maximum(scores.weighted, 1e-20 * scores.total) / scores.rows
    return noise


def _candidate(
    problem: Problem, kept: Sweep, labels: IntArray, scores: Scores, criteria: FloatArray, k: int
) -> Candidate:
    """Return one of the relations that were scored."""
    support, guesses, factor = kept.supports[k], kept.guesses[k], problem.factor
    implicit = {g: factor.unexplained(support, g) for g in guesses}
    guess = min(implicit, key=lambda g: implicit[g] / factor.scale[g])
    return Candidate(
        target=problem.target,
        support=support,
        guesses=guesses,
        guess=guess,
        xi=scores.xi[k],
        implicit_rmse=implicit[guess],
        target_rmse=float(np.sqrt(scores.squares[k] / scores.samples)),
        target_r2=1.0 - float(scores.squares[k]) / scores.power if scores.power > 0 else 0.0,
        explained=1.0 - float(scores.weighted[k]) / scores.total if scores.total > 0 else 0.0,
        criterion=float(criteria[k]),
        cluster=int(labels[k]),
        family=0,
    )


def _families(problem: Problem, ranked: list[tuple[int, Candidate]], scores: Scores) -> tuple[Candidate, ...]:
    """Label candidates that predict the target alike, and let the simplest of each family go first.

    Alike: the difference of two predictions is no larger than one term more has to earn by the criterion.
    """
    rows = problem.factor.rows  # of the signals there may be fewer, and differences as much smaller
    allowed = float(penalty(rows, 1.0 / len(problem.terms))) * scores.rows / rows
    noise = _noise(scores)
    heads: list[int] = []
    members: list[list[Candidate]] = []
    for k, candidate in ranked:
        for head, family in zip(heads, members, strict=True):
            apart = scores.gram[k, k] + scores.gram[head, head] - 2.0 * scores.gram[k, head]
            if apart <= allowed * noise[head]:
                family.append(candidate)
                break
        else:
            heads.append(k)
            members.append([candidate])
    return tuple(
        replace(c, family=k)
        for k, family in enumerate(members)
        for c in sorted(family, key=lambda c: (len(c.support), _degree(problem, c.support), c.criterion))
    )


def _degree(problem: Problem, support: Support) -> float:
    return sum(problem.terms[j].degree for j in support)
