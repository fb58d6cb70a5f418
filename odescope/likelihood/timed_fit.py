"""The times of steps between samples, fitted together with the coefficients and the states of a model.

docs/method.md, Inputs between samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.expansion import Expansion
from odescope.likelihood.fit import Fit
from odescope.likelihood.gauge import inverse
from odescope.likelihood.kernel import Sums
from odescope.likelihood.program import Program
from odescope.likelihood.sampled_inputs import with_steps
from odescope.likelihood.search_space import SearchSpace

ANYWHERE = 12.0  # what is known of a time that is anywhere between two samples, 1 / variance
DIFFERENCE = 2e-3  # samples: of the difference quotients that say what a step earlier does
WITHIN = DIFFERENCE, 1.0 - DIFFERENCE  # of a sample: times that these quotients stay between two samples for
ITERATIONS = 30
CONVERGED = 0.1  # fall of the cost that ends a fit
UNDAMPED, LEAST_DAMPING, LARGEST_DAMPING = 1e-4, 1e-9, 1e6


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps that the segments of a space see.

    Shapes, for S of them: at (S,) the averages before them; own (S,) the segments of these; slot (S,) their numbers
    within these; rise (S, i) by what each input steps; now (S,) when, in samples before the one that shows them.
    """

    at: IntArray
    own: IntArray
    slot: IntArray
    rise: FloatArray
    now: FloatArray

    @staticmethod
    def of(space: SearchSpace, at: IntArray, rise: FloatArray, now: FloatArray) -> tuple[Steps, IntArray]:
        """Return those steps that segments see, and which of all these are.

        Args:
            space: whose segments have the steps when they are now.
            at: (S,) the averages before them, ascending.
            rise: (S, i) by what each input steps.
            now: (S,) when, in samples before the one that shows them.
        """
        segments = space.segments
        own = np.searchsorted(segments.start, at, side="right") - 1
        seen = np.flatnonzero((own >= 0) & (at < segments.start[own] + segments.count[own]))
        own = own[seen]
        slot = np.arange(len(own)) - np.searchsorted(own, own)
        return Steps(at[seen], own, slot, rise[seen], now[seen]), seen


class Timed(NamedTuple):
    """A model with the times of steps that are best beside it, and by how much the cost is less than at those before.

    Shapes: early (S,) the times, known (S,) what the record says of each, 1 / variance; theta (mechanisms,)
    coefficients; variances (p,) of the parameters, times open.
    """

    early: FloatArray
    known: FloatArray
    theta: FloatArray
    variances: FloatArray
    cost: float
    fall: float


class _Point(NamedTuple):
    """Where a fit stands, and what the kernel returned there; times as in `Timed`."""

    theta: FloatArray
    x0: FloatArray
    early: FloatArray
    integrated: Sums
    cost: float


@dataclass(frozen=True, eq=False)
class _Timing:
    """What stays the same from step to step of such a fit: the model, where steps are, and the defects' widths (n,)."""

    space: SearchSpace
    found: Fit
    steps: Steps
    defect_std: FloatArray

    @cached_property
    def program(self) -> Program:
        """That of the model's mechanisms."""
        return self.space.program(self.found.present)

    @cached_property
    def free(self) -> IntArray:
        """Which of these have coefficients that are parameters, (p,)."""
        return np.searchsorted(self.found.present, self.found.free)

    def integrated(self, theta: FloatArray, x0: FloatArray, early: FloatArray) -> Sums:
        """Return what the kernel does with steps at such times (S,)."""
        segments, steps = self.space.segments, self.steps
        inputs, cuts = with_steps(segments.inputs, segments.cuts, steps.at, steps.rise, early)
        moved = replace(segments, inputs=inputs, cuts=cuts)
        there = Evaluator(moved, self.space.evaluator.substeps, self.space.budget)
        return there.integrate(self.program, theta[self.found.present], self.free, x0)

    def at(self, theta: FloatArray, x0: FloatArray, early: FloatArray) -> _Point:
        """Return the point, its times within reach of differences; its cost is infinite where there is none."""
        early = np.clip(early, *WITHIN)
        sums = self.integrated(theta, x0, early)
        costs = self.space.evaluator.costs(sums, x0, self.defect_std)
        cost = np.inf if costs is None else sum(costs) + ANYWHERE * float(np.sum((early - 0.5) ** 2))
        return _Point(theta, x0, early, sums, cost)

    def expansion(self, here: _Point, timed: Sums, damping: float) -> Expansion | None:
        """Return the expansion about a point from its sums `with_times`; None where there is none."""
        theta, evaluator = here.theta[self.found.present], self.space.evaluator
        found = evaluator.expand(self.program, theta, self.free, here.x0, self.defect_std, damping, timed)
        return found if found is not None and found.finite else None

    def after(self, here: _Point, timed: Sums, damping: float) -> _Point | None:
        """Return the point that the expansion asks for, or None where that is none."""
        damped, free = self.expansion(here, timed, damping), self.found.free
        if damped is None:
            return None
        least, largest = (limit[self.free] - here.theta[free] for limit in self.program.limits)
        below, above = (np.concatenate([b, t - here.early]) for b, t in zip((least, largest), WITHIN, strict=True))
        change = self.space.evaluator.change(damped, self.defect_std, below, above)
        if change is None:
            return None
        theta, own = here.theta.copy(), change[0]
        theta[free] += own[: len(free)]
        return self.at(theta, here.x0 + change[1], here.early + own[len(free) :])

    def covariance(self, here: _Point) -> FloatArray:
        """Return the covariance (p + S, p + S) of parameters and times.

        Where there is no expansion, that of times that are anywhere beside the model's own.
        """
        expansion = self.expansion(here, self.with_times(here), 0.0)
        if expansion is not None:
            return inverse(expansion.information)
        apart: FloatArray = block_diag(self.found.covariance, np.eye(len(here.early)) / ANYWHERE)
        return apart

    def with_times(self, here: _Point) -> Sums:
        """Return sums with the times of steps as further parameters, by differences: each matters in one segment."""
        sums, early = here.integrated, here.early
        n, p, s = here.x0.shape[1], len(self.found.free), len(early)
        gradient, hessian, jacobian = (
            np.concatenate([part, np.zeros((*part.shape[:-1], s))], axis=-1)
            for part in (sums.gradient, sums.hessian, sums.jacobian)
        )
        inner = np.zeros((p + s, p + s))
        inner[:p, :p] = sums.inner
        earlier = list[FloatArray]()
        for k in range(int(self.steps.slot.max()) + 1):
            one = np.flatnonzero(self.steps.slot == k)
            own, place, more = self.steps.own[one], p + one, np.where(self.steps.slot == k, DIFFERENCE, 0.0)
            up, down = (self.integrated(here.theta, here.x0, early + moved) for moved in (more, -more))
            slope = ((up.gradient - down.gradient) / (2.0 * DIFFERENCE))[own]
            bend = (up.cost - 2.0 * sums.cost + down.cost)[own] / DIFFERENCE**2
            gradient[own, n + place] = (up.cost - down.cost)[own] / (4.0 * DIFFERENCE)
            hessian[own, :, n + place] = slope[:, :n]
            jacobian[own, :, n + place] = ((up.last - down.last) / (2.0 * DIFFERENCE))[own]
            inner[place, :p], inner[:p, place] = slope[:, n:], slope[:, n:].T
            inner[place, place] = np.maximum(0.5 * bend, 0.0)
            for back, before in enumerate(reversed(earlier), start=1):  # steps before it in the same segment
                both = more.copy()
                both[one - back] = DIFFERENCE
                together = self.integrated(here.theta, here.x0, early + both).cost
                mixed = 0.5 * (together - up.cost - before + sums.cost)[own] / DIFFERENCE**2
                inner[place, place - back] = inner[place - back, place] = mixed
            earlier.append(up.cost)
        times = p + np.arange(s)
        gradient[self.steps.own, n + times] += ANYWHERE * (early - 0.5)
        inner[times, times] += ANYWHERE
        return sums._replace(gradient=gradient, hessian=hessian, jacobian=jacobian, inner=inner)


@np.errstate(over="ignore", invalid="ignore")  # of segments that ran away
def timed_fit(space: SearchSpace, found: Fit, steps: Steps, defect_std: FloatArray) -> Timed:
    """Return a model with its steps at the times that are best beside it.

    A step is anywhere between the two samples, and the times are further parameters of the joined record: what follows
    a step long after tells when it came, where windows around it with states of their own know little.

    Args:
        space: whose segments have the steps at the times at which they are taken for now.
        found: the model; none of its mechanisms is a delay.
        steps: that its segments see.
        defect_std: (n,) standard deviations of the defects between segments.
    """
    timing, damping = _Timing(space, found, steps, defect_std), UNDAMPED
    here = begun = timing.at(found.theta, found.x0, steps.now)
    for _ in range(ITERATIONS):
        trial, fall, timed = None, -np.inf, timing.with_times(here)
        while fall < 0.0 and damping <= LARGEST_DAMPING:
            trial = timing.after(here, timed, damping)
            fall = -np.inf if trial is None else here.cost - trial.cost
            damping *= 10.0
        if trial is None or fall < 0.0:
            break
        here, damping = trial, max(damping / 100.0, LEAST_DAMPING)
        if fall < CONVERGED:
            break
    variances, free = np.diag(timing.covariance(here)), len(found.free)
    known = np.maximum(1.0 / variances[free:] - ANYWHERE, 0.0)
    return Timed(here.early, known, here.theta, variances[:free], here.cost, begun.cost - here.cost)


def covariance_with_times(space: SearchSpace, found: Fit, steps: Steps, defect_std: FloatArray) -> FloatArray:
    """Return the covariance (p, p) of a model's parameters where nobody knows when the steps come, at its costs' noise.

    Where it has delays, which move all steps, or no expansion, that of the model itself.

    Args:
        space: whose segments have the steps at the times at which they are taken for now.
        found: the model.
        steps: that its segments see.
        defect_std: (n,) standard deviations of the defects between segments.
    """
    timing = _Timing(space, found, steps, defect_std)
    free = len(found.free)
    return timing.covariance(timing.at(found.theta, found.x0, steps.now))[:free, :free]
