"""From hundreds of candidate relations to one a target: what is discarded and why, held-out scores, families."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import NoModelError
from odescope.regression.proposers import Support
from odescope.selection.problem import Problem
from odescope.selection.sweep import Sweep


class Ranking(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How candidates are kept and ranked.

    A relation is kept with at most `terms` terms, found from at least `consensus` guesses. `explain` is the least part
    of the target's power on held-out data, as weighted in the regression, that the chosen relation must predict.
    """

    terms: Annotated[int, msgspec.Meta(ge=1)] = 15
    consensus: Annotated[int, msgspec.Meta(ge=1)] = 2
    explain: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.5


@dataclass(frozen=True, eq=False)
class Candidate:
    """One relation for one target.

    xi (m,) are its coefficients over the library, that of the target's first term 1. `criterion` is what ranks it:
    n ln(held-out residual^2) + terms (ln n + 2 ln m). `explained` is the part of the target's weighted power that it
    predicts on held-out data, `target_rmse` the error of its prediction there in units of the target.
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
    prediction: FloatArray


@dataclass(frozen=True)
class Ranked:
    """The candidates of one target, best first, and the tally of what was discarded and why."""

    candidates: tuple[Candidate, ...]
    discarded: tuple[tuple[str, int], ...]


def rank(problem: Problem, found: Sweep, options: Ranking) -> Ranked:
    """Return the candidates of one target, best first.

    Raises:
        NoModelError: nothing is left, or what is left predicts nothing.
    """
    discarded: Counter[str] = Counter()
    keep = []
    for k, (support, guesses) in enumerate(zip(found.supports, found.guesses, strict=True)):
        reason = _refusal(problem, support, guesses, options)
        if reason:
            discarded[reason] += 1
        else:
            keep.append(k)
    kept = found.restrict(keep)
    labels = kept.clusters()
    scored = []
    for k, (support, guesses) in enumerate(zip(kept.supports, kept.guesses, strict=True)):
        candidate = _score(problem, support, guesses, int(labels[k]))
        if candidate is None:
            discarded["its denominator changes sign inside the data"] += 1
        else:
            scored.append(candidate)
    if not scored:
        tally = "; ".join(f"{count} {reason}" for reason, count in discarded.items())
        raise NoModelError(
            "selection", f"of {len(found.supports)} relations for {problem.target} none is left: {tally}"
        )
    ranked = _families(problem, sorted(scored, key=lambda c: c.criterion))
    best = ranked[0]
    if best.explained < options.explain:
        raise NoModelError(
            "selection",
            f"the best of {len(ranked)} relations for {problem.target} predicts {max(best.explained, 0.0):.0%} of it on"
            f" held-out data, less than the {options.explain:.0%} asked for ([selection] explain). Either the library"
            " lacks the right terms, or something that drives the system was not recorded, or there is too much noise",
        )
    return Ranked(ranked, tuple(discarded.items()))


def _refusal(problem: Problem, support: Support, guesses: tuple[int, ...], options: Ranking) -> str:
    if not set(support) & set(problem.own):
        return "without the target"
    if len(support) > options.terms:
        return f"with more than {options.terms} terms"
    if len(guesses) < options.consensus:
        return f"found from fewer than {options.consensus} guesses"
    return ""


def left_column(problem: Problem, support: Support) -> int:
    """Return the target term that gets the coefficient 1: the target itself, else its first product."""
    return problem.left if problem.left in support else next(j for j in problem.own if j in support)


def _score(problem: Problem, support: Support, guesses: tuple[int, ...], cluster: int) -> Candidate | None:
    left = left_column(problem, support)
    weighted = total = squares = power = 0.0
    rows = 0
    numbers = sorted({b.fold for b in problem.blocks})
    solutions = [f.solve(support, left) for f in problem.training]
    xi = problem.factor.solve(support, left)
    # A denominator may keep its sign in every block and yet change it from one recording to the next.
    if len({float(np.sign(xi[list(problem.own)] @ m[:, 0])) for m in problem.multipliers}) > 1:
        return None
    predictions = []
    for k, block in enumerate(problem.blocks):
        held_out = problem.residual(k, solutions[numbers.index(block.fold) % len(solutions)])
        final = problem.residual(k, xi)
        if held_out is None or final is None:
            return None
        joined = problem.row_map.rows(block, np.array([held_out, problem.measured[k], problem.measured[k] - final]))
        weighted += float(joined[:, 0] @ joined[:, 0])
        total += float(joined[:, 1] @ joined[:, 1])
        predictions.append(joined[:, 2])
        rows += len(joined)
        squares += float(held_out @ held_out)
        power += float(np.sum((problem.measured[k] - problem.measured[k].mean()) ** 2))
    # A residual of rounding alone cannot rank: the floor makes exact relations equal, and the simplest of them wins.
    noise = max(weighted, 1e-20 * total) / rows
    criterion = rows * np.log(noise) + len(support) * (np.log(rows) + 2.0 * np.log(len(problem.terms)))
    implicit = {g: problem.factor.residual(problem.factor.solve(support, g)) for g in guesses}
    guess = min(implicit, key=lambda g: implicit[g] / problem.factor.scale[g])
    return Candidate(
        target=problem.target,
        support=support,
        guesses=guesses,
        guess=guess,
        xi=xi,
        implicit_rmse=implicit[guess],
        target_rmse=float(np.sqrt(squares / problem.samples)),
        target_r2=1.0 - squares / power if power > 0 else 0.0,
        explained=1.0 - weighted / total if total > 0 else 0.0,
        criterion=float(criterion),
        cluster=cluster,
        family=0,
        prediction=np.concatenate(predictions),
    )


def _families(problem: Problem, ranked: list[Candidate]) -> tuple[Candidate, ...]:
    """Label candidates that predict the target alike, and let the simplest of each family go first.

    Alike: the difference of two predictions is no larger than one term more has to earn by the criterion.
    """
    rows = len(ranked[0].prediction)
    allowed = np.log(rows) + 2.0 * np.log(len(problem.terms))
    heads: list[Candidate] = []
    members: list[list[Candidate]] = []
    for candidate in ranked:
        for head, family in zip(heads, members, strict=True):
            noise = np.exp((head.criterion - len(head.support) * allowed) / rows)
            if np.sum((candidate.prediction - head.prediction) ** 2) <= allowed * noise:
                family.append(candidate)
                break
        else:
            heads.append(candidate)
            members.append([candidate])
    return tuple(
        replace(c, family=k)
        for k, family in enumerate(members)
        for c in sorted(family, key=lambda c: (len(c.support), _degree(problem, c.support), c.criterion))
    )


def _degree(problem: Problem, support: Support) -> float:
    return sum(abs(power) for j in support for _, power in problem.rests[j].factors)
