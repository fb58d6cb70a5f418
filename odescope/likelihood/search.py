"""Structure search by likelihood: score tests add, Wald tests drop, while continuity grows (METHOD section 9)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec
import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.expression import ONE, Term
from odescope.likelihood.data import Segments
from odescope.likelihood.fit import ITERATIONS, Evaluator, Fit, Program, Slot, fit

GAPS = (np.inf, 1.0, 0.1, 0.01, 0.001)  # widths of the joints' gaps, in smoothing errors of each state
NEAR_NOISE = 2.0  # residual variance over noise variance above which continuity is not tightened
TRIALS = 3  # absent terms tried by refitting before a search for more is given up
WHITE = 1.1  # residual variance over noise variance of a model that lacks nothing
THIN = 4.0  # times the criterion: a term that earns less may be due to what else was chosen
LOOK_BACK = 0.1  # width of the gaps from which on the search looks back and swaps
LOOK_ALIKE = 40.0  # times the criterion: a term that earns more is not swapped
PROMISING = 0.5  # of what a term was worth, the score a look-alike must show to be tried
GAIN = 0.5  # fall of the cost that makes a swap
PATIENCE = 4  # rounds a relation after which a search ends
HOPELESS = 10.0  # if the residual variance is still above this many times that of the noise
MOST_TERMS = 15  # a relation: a search that wants more is explaining something that is not in the library
ROUNDS = 40  # additions and drops at one width


class LikelihoodSearch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the likelihood stage.

    Without `enabled` the model is what regression proposes. `starts` are the proposals that searches begin from, beside
    a sparse forward selection; after `seconds` the best model so far is returned.
    """

    enabled: bool = True
    starts: Annotated[int, msgspec.Meta(ge=1)] = 1
    seconds: Annotated[float, msgspec.Meta(gt=0.0)] = 60.0


@dataclass(frozen=True)
class Move:
    """One step of the trail: what was tried, the score or Wald statistic that asked for it, and the cost after it."""

    gap: float
    action: str
    relation: int
    term: str
    statistic: float
    cost: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of a search: the fit over all slots, the width of the gaps it holds for, and the trail.

    `scale` is the residual variance over the noise variance; `criterion` what a term had to earn.
    """

    fit: Fit
    gap: float
    scale: float
    criterion: float
    trail: tuple[Move, ...]
    finished: bool

    @property
    def penalised(self) -> float:
        """Cost in units of the noise variance, plus the criterion for every term."""
        return self.fit.cost + self.criterion * len(self.fit.present)

    @property
    def clear(self) -> bool:
        """Whether another start is unlikely to end elsewhere: white residuals, and no term whose case is thin."""
        wald = self.fit.theta[self.fit.present] ** 2 / np.maximum(self.fit.variances, 1e-300) / max(self.scale, 1.0)
        tight = self.finished and self.gap == GAPS[-1] and self.scale < WHITE
        return bool(tight and np.all(wald > THIN * self.criterion))

    @property
    def rank(self) -> tuple[float, float]:
        """Starts compete by how far continuity carried them, then by cost and number of terms; less is better."""
        return self.gap, self.penalised


def universe(libraries: Sequence[Sequence[tuple[int, Term]]]) -> tuple[Slot, ...]:
    """Return the slots of all relations.

    Args:
        libraries: for each relation its candidates as (target's number or -1, product without the target). The target's
            own bare term is fixed to 1.
    """
    return tuple(
        Slot(r, factor, term, fixed=factor == r and term == ONE)
        for r, candidates in enumerate(libraries)
        for factor, term in candidates
    )


@dataclass(frozen=True, eq=False)
class Searcher:
    """Everything a search needs that does not change on the way."""

    evaluator: Evaluator
    slots: tuple[Slot, ...]
    variables: tuple[str, ...]
    following: IntArray
    measured: IntArray
    deadline: float

    @property
    def segments(self) -> Segments:
        """The data."""
        return self.evaluator.segments

    @property
    def free(self) -> IntArray:
        """Slots that may be parameters."""
        return np.array([k for k, s in enumerate(self.slots) if not s.fixed], dtype=np.int64)

    @property
    def relations(self) -> int:
        """Number of relations."""
        return 1 + max(s.relation for s in self.slots)

    @property
    def criterion(self) -> float:
        """What a term has to earn: 2 ln(candidates) + ln(samples)."""
        return float(2.0 * np.log(len(self.free)) + np.log(self.segments.samples))

    def program(self, present: IntArray) -> tuple[Program, IntArray]:
        """Return the program of these and the fixed slots alone, and their numbers."""
        kept = np.array(sorted({*present.tolist(), *(k for k, s in enumerate(self.slots) if s.fixed)}), dtype=np.int64)
        return Program.of([self.slots[k] for k in kept], self.variables, self.following, self.measured), kept

    def fit(
        self, theta: FloatArray, present: IntArray, x0: FloatArray, gap: FloatArray, iterations: int = ITERATIONS
    ) -> Fit | None:
        """Return the fit of the present slots; only they are on the tape."""
        program, kept = self.program(present)
        place = {int(k): i for i, k in enumerate(kept)}
        free = np.array([place[int(k)] for k in present], dtype=np.int64)
        found = fit(self.evaluator, program, theta[kept], free, x0, gap, iterations)
        if found is None:
            return None
        whole = np.zeros(len(self.slots))
        whole[kept] = found.theta
        return replace(found, theta=whole, present=present)

    def move(self, width: float, action: str, k: int, statistic: float, cost: float) -> Move:
        """Return the step of the trail that did something to slot k."""
        slot = self.slots[k]
        text = slot.term.text if slot.factor < 0 else f"target {slot.factor + 1} * {slot.term.text}"
        return Move(width, action, slot.relation, text, statistic, cost)

    def scores(self, program: Program, found: Fit, gap: FloatArray) -> FloatArray:
        """Return the score statistic of every slot, zero for those present or fixed."""
        free = self.free
        expansion = self.evaluator.expand(program, found.theta, free, found.x0, gap)
        result = np.zeros(len(self.slots))
        if expansion is None:
            return result
        here = np.isin(free, found.present)
        scale = np.sqrt(np.maximum(np.diag(expansion.information), 1e-300))
        information = expansion.information / np.outer(scale, scale)
        gradient = expansion.gradient / scale
        absent = np.flatnonzero(~here)
        inner = information[np.ix_(here, here)]
        cross = information[np.ix_(here, ~here)]
        try:
            solved = np.linalg.solve(inner, np.column_stack([cross, gradient[here]]))
        except np.linalg.LinAlgError:
            return result
        own = np.diag(information)[absent] - np.einsum("ij,ij->j", cross, solved[:, :-1])
        slope = gradient[absent] - cross.T @ solved[:, -1]
        # A candidate with nothing of its own beside the present terms cannot be told from them.
        result[free[absent]] = np.where(own > 1e-6, slope**2 / np.maximum(own, 1e-6), 0.0)
        return result


def search(searcher: Searcher, theta: FloatArray, present: Sequence[int]) -> Outcome | None:
    """Return where a search from these slots ends, or None where the start cannot be integrated.

    Args:
        searcher: data and candidates.
        theta: (slots,) coefficients to begin with, 1 in fixed slots.
        present: the slots to begin with.
    """
    segments, trail = searcher.segments, list[Move]()
    program = Program.of(searcher.slots, searcher.variables, searcher.following, searcher.measured)
    spread = segments.spread
    best: tuple[Fit, float, float] | None = None
    here = searcher.fit(theta, np.array(sorted(present), dtype=np.int64), segments.initial, spread * np.inf)
    if here is None:
        return None
    finished = True
    for width in GAPS:
        gap = spread * width
        refitted = searcher.fit(here.theta, here.present, here.x0, gap)
        if refitted is None:
            break
        here = _settle(searcher, program, refitted, width, trail)
        scale = _scale(searcher, here, width)
        if best is not None and (scale > NEAR_NOISE * max(best[2], 1.0) or _torn(searcher, here)):
            break
        best = (here, width, scale)
        if scale > NEAR_NOISE:
            break  # nothing that is absent explains the record: joining segments would only invent terms
        if time.monotonic() > searcher.deadline:
            finished = False
            break
    if best is None:
        best = (here, float(GAPS[0]), _scale(searcher, here, float(GAPS[0])))
    return Outcome(best[0], best[1], best[2], searcher.criterion, tuple(trail), finished)


def _torn(searcher: Searcher, found: Fit) -> bool:
    """Say whether the joints are stretched beyond their width: the record does not support a tighter one."""
    joints = int(searcher.segments.joined.sum()) * found.x0.shape[1]
    return bool(joints > 0 and found.cost - found.data_cost > joints)


def _scale(searcher: Searcher, found: Fit, width: float) -> float:
    """Return the residual variance over the noise variance, degrees of freedom of loose initial states counted."""
    segments = searcher.segments
    states = found.x0.size if np.isinf(width) else found.x0.shape[1] * (1 + int((~segments.joined).sum()))
    freedom = max(segments.samples - states - len(found.present), 1)
    return max(found.data_cost / freedom, 1e-12)


def _settle(searcher: Searcher, program: Program, here: Fit, width: float, trail: list[Move]) -> Fit:
    """Add, drop and swap at one width until nothing moves."""
    gap = searcher.segments.spread * width
    for round_ in range(ROUNDS):
        scale = max(_scale(searcher, here, width), 1.0)
        lost = round_ >= PATIENCE * searcher.relations and scale > HOPELESS
        full = len(here.present) > MOST_TERMS * searcher.relations
        if lost or full or time.monotonic() > searcher.deadline:
            return here
        moved = _drop(searcher, here, gap, width, scale, trail)
        if moved is None:
            moved = _add(searcher, program, here, gap, width, scale, trail)
        if moved is None and width <= LOOK_BACK:
            moved = _swap(searcher, program, here, gap, width, scale, trail)
        if moved is None:
            return here
        here = moved
    return here


def _add(
    searcher: Searcher, program: Program, here: Fit, gap: FloatArray, width: float, scale: float, trail: list[Move]
) -> Fit | None:
    scores = searcher.scores(program, here, gap) / scale
    for k in np.argsort(scores)[::-1][:TRIALS]:
        if scores[k] < searcher.criterion:
            return None
        present = np.array(sorted([*here.present.tolist(), int(k)]), dtype=np.int64)
        trial = searcher.fit(here.theta, present, here.x0, gap)
        if trial is not None and (here.cost - trial.cost) / scale > searcher.criterion:
            trail.append(searcher.move(width, "add", int(k), float(scores[k]), trial.cost))
            return trial
    return None


def _drop(searcher: Searcher, here: Fit, gap: FloatArray, width: float, scale: float, trail: list[Move]) -> Fit | None:
    if not len(here.present):
        return None
    wald = here.theta[here.present] ** 2 / np.maximum(here.variances, 1e-300) / scale
    weakest = int(np.argmin(wald))
    if wald[weakest] >= searcher.criterion:
        return None
    k = int(here.present[weakest])
    theta = here.theta.copy()
    theta[k] = 0.0
    trial = searcher.fit(theta, np.delete(here.present, weakest), here.x0, gap)
    if trial is None or (trial.cost - here.cost) / scale > searcher.criterion:
        return None
    trail.append(searcher.move(width, "drop", k, float(wald[weakest]), trial.cost))
    return trial


def _swap(
    searcher: Searcher, program: Program, here: Fit, gap: FloatArray, width: float, scale: float, trail: list[Move]
) -> Fit | None:
    """Put a look-alike in the place of a present term whose case is thin, if that lowers the cost.

    A term that came early may hold the place of another; once it is gone, the score of the right one stands out.
    """
    wald = here.theta[here.present] ** 2 / np.maximum(here.variances, 1e-300) / scale
    for weak in np.argsort(wald):
        if wald[weak] > LOOK_ALIKE * searcher.criterion or time.monotonic() > searcher.deadline:
            return None
        k = int(here.present[weak])
        theta = here.theta.copy()
        theta[k] = 0.0
        without = searcher.fit(theta, np.delete(here.present, weak), here.x0, gap)
        if without is None:
            continue
        scores = searcher.scores(program, without, gap) / scale
        scores[k] = 0.0
        for other in np.argsort(scores)[::-1][:TRIALS]:
            # A swap keeps the number of terms: it has to gain, by more than the fits are accurate to.
            if scores[other] < (without.cost - here.cost) / scale * PROMISING:
                break
            present = np.array(sorted([*without.present.tolist(), int(other)]), dtype=np.int64)
            trial = searcher.fit(without.theta, present, without.x0, gap)
            if trial is not None and trial.cost < here.cost - GAIN * scale:
                trail.append(searcher.move(width, "swap", int(other), float(scores[other]), trial.cost))
                return trial
    return None
