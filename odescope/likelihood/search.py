"""Structure search by likelihood: score tests add, Wald tests drop, while continuity grows (METHOD section 9)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import msgspec
import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.expression import ONE, Term
from odescope.likelihood.fit import ITERATIONS, Evaluator, Fit, Program, Slot, fit, scaled
from odescope.likelihood.segments import Segments

GAPS = (np.inf, 1.0, 0.1, 0.01, 0.001)  # widths of the joints' gaps, in smoothing errors of each state
NEAR_NOISE = 2.0  # residual variance over noise variance above which continuity is not tightened
TRIALS = 3  # absent terms tried by refitting before a search for more is given up
WHITE = 1.1  # residual variance over noise variance of a model that lacks nothing
THIN = 4.0  # times its price: a term that earns less may be due to what else was chosen
LOOK_BACK = 0.1  # width of the gaps from which on the search looks back and swaps
LOOK_ALIKE = 40.0  # times its price: a term that earns more is in its place
DETOUR = 6  # additions and drops until a search without a term has to be better than that with it
GAIN = 0.5  # fall of the penalised cost that makes it better: fits are no more accurate than this
RARER = 2.0  # a product with one factor more is half as likely
PATIENCE = 4  # rounds a relation after which a search ends
HOPELESS = 10.0  # if the residual variance is still above this many times that of the noise; so does a detour
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
    """One step of the trail: the score or Wald statistic that asked for it, the term's price, and the cost after it."""

    gap: float
    action: str
    slot: Slot
    statistic: float
    price: float
    cost: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of a search: the fit over all slots, the width of the gaps it holds for, and the trail.

    `scale` is the residual variance over the noise variance; `prices` what each slot had to earn.
    """

    fit: Fit
    gap: float
    scale: float
    prices: FloatArray
    trail: tuple[Move, ...]
    finished: bool

    @property
    def penalised(self) -> float:
        """Cost in units of the noise variance, plus the price of every term."""
        return self.fit.cost + float(self.prices[self.fit.present].sum())

    @property
    def clear(self) -> bool:
        """Whether another start is unlikely to end elsewhere: white residuals, and no term whose case is thin."""
        wald = self.fit.theta[self.fit.present] ** 2 / np.maximum(self.fit.variances, 1e-300) / max(self.scale, 1.0)
        tight = self.finished and self.gap == GAPS[-1] and self.scale < WHITE
        return bool(tight and np.all(wald > THIN * self.prices[self.fit.present]))

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
    """Everything a search needs that does not change on the way.

    `deadline` is when it gives up, in seconds of the clock that all machines share (`time.time`).
    """

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

    @cached_property
    def price(self) -> FloatArray:
        """What each slot has to earn as a parameter: ln(samples) - 2 ln(its share of the prior).

        Every factor of a product divides the prior by RARER: noise often leaves it to a hair which of two look-alikes
        fits better, and laws are simple. All shares together are 1, so the price is 2 ln(candidates) on the whole.
        """
        size = np.array([(s.factor >= 0) + sum(abs(power) for _, power in s.term.factors) for s in self.slots])
        share = RARER ** -size.astype(np.float64)
        price: FloatArray = np.log(self.segments.samples) - 2.0 * np.log(share / share[self.free].sum())
        return price

    def program(self, present: IntArray) -> tuple[Program, IntArray]:
        """Return the program of these and the fixed slots alone, and their numbers."""
        kept = np.array(sorted({*present.tolist(), *(k for k, s in enumerate(self.slots) if s.fixed)}), dtype=np.int64)
        return Program.of([self.slots[k] for k in kept], self.variables, self.following, self.measured), kept

    def move(self, width: float, action: str, k: int, statistic: float, after: Fit) -> Move:
        """Return the step of the trail that did something to slot k."""
        return Move(width, action, self.slots[k], statistic, float(self.price[k]), after.cost)

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

    def scores(self, program: Program, found: Fit, gap: FloatArray) -> FloatArray:
        """Return the score statistic of every slot, zero for those present or fixed."""
        free = self.free
        expansion = self.evaluator.expand(program, found.theta, free, found.x0, gap)
        result = np.zeros(len(self.slots))
        if expansion is None:
            return result
        here = np.isin(free, found.present)
        information, scale = scaled(expansion.information)
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
        if time.time() > searcher.deadline:
            finished = False
            break
    if best is None:
        best = (here, float(GAPS[0]), _scale(searcher, here, float(GAPS[0])))
    return Outcome(best[0], best[1], best[2], searcher.price, tuple(trail), finished)


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
    """Add, drop and go round weak terms at one width until nothing moves."""
    for round_ in range(ROUNDS):
        scale = max(_scale(searcher, here, width), 1.0)
        lost = round_ >= PATIENCE * searcher.relations and scale > HOPELESS
        full = len(here.present) > MOST_TERMS * searcher.relations
        if lost or full or time.time() > searcher.deadline:
            return here
        stand = _Stand(searcher, program, width, scale, trail)
        moved = stand.drop(here) or stand.add(here)
        if moved is None and width <= LOOK_BACK:
            moved = stand.look_back(here)
        if moved is None:
            return here
        here = moved
    return here


@dataclass(frozen=True, eq=False)
class _Stand:
    """What a move at one width is judged by; statistics are in units of `scale`, the residual variance."""

    searcher: Searcher
    program: Program
    width: float
    scale: float
    trail: list[Move]

    @property
    def gap(self) -> FloatArray:
        """Standard deviations of the joints' gaps."""
        return self.searcher.segments.spread * self.width

    def penalised(self, found: Fit) -> float:
        """Cost and the prices of the present terms."""
        return found.cost / self.scale + float(self.searcher.price[found.present].sum())

    def wald(self, found: Fit) -> FloatArray:
        """Wald statistics of the present terms."""
        wald: FloatArray = found.theta[found.present] ** 2 / np.maximum(found.variances, 1e-300) / self.scale
        return wald

    def without(self, here: Fit, k: int) -> Fit | None:
        """Return the fit without a present term."""
        theta = here.theta.copy()
        theta[k] = 0.0
        return self.searcher.fit(theta, here.present[here.present != k], here.x0, self.gap)

    def drop(self, here: Fit) -> Fit | None:
        """Drop a term that is not worth its price; of look-alikes that are worthless together, only one is."""
        wald, price = self.wald(here), self.searcher.price[here.present]
        for weak in np.argsort(wald - price)[:TRIALS]:
            if wald[weak] >= price[weak]:
                return None
            k = int(here.present[weak])
            trial = self.without(here, k)
            if trial is not None and self.penalised(trial) <= self.penalised(here):
                self._note("drop", k, float(wald[weak]), trial)
                return trial
        return None

    def add(self, here: Fit, barred: int | None = None) -> Fit | None:
        """Add a term that is worth its price."""
        scores = self.searcher.scores(self.program, here, self.gap) / self.scale
        if barred is not None:
            scores[barred] = 0.0
        earned = scores - self.searcher.price
        for k in np.argsort(earned)[::-1][:TRIALS]:
            if earned[k] < 0.0:
                return None
            present = np.array(sorted([*here.present.tolist(), int(k)]), dtype=np.int64)
            trial = self.searcher.fit(here.theta, present, here.x0, self.gap)
            if trial is not None and self.penalised(trial) < self.penalised(here):
                self._note("add", int(k), float(scores[k]), trial)
                return trial
        return None

    def look_back(self, here: Fit) -> Fit | None:
        """Return the end of a search that a thin term is barred from, if it is better.

        A term that came early may hold the place of another, or with others that of several; once it is gone, the
        scores of the right ones stand out.
        """
        wald = self.wald(here)
        for weak in np.argsort(wald):
            k = int(here.present[weak])
            if wald[weak] > LOOK_ALIKE * self.searcher.price[k]:
                return None
            detour = replace(self, trail=[])
            there = detour.without(here, k)
            if there is not None:
                detour._note("drop", k, float(wald[weak]), there)
            for _ in range(DETOUR):
                if there is None or there.cost > HOPELESS * here.cost or time.time() > self.searcher.deadline:
                    break
                if self.penalised(there) < self.penalised(here) - GAIN:
                    self.trail.extend(detour.trail)
                    return there
                there = detour.drop(there) or detour.add(there, k)
        return None

    def _note(self, action: str, k: int, statistic: float, after: Fit) -> None:
        self.trail.append(self.searcher.move(self.width, action, k, statistic, after))
