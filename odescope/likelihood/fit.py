"""Fits of one structure: Levenberg-Marquardt on coefficients and initial states together."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.expansion import Expansion
from odescope.likelihood.gauge import inverse
from odescope.likelihood.kernel import Sums
from odescope.likelihood.program import Program

ITERATIONS = 40
CONVERGED = 1e-3  # fall of the cost, which is in units of chi-squared, that ends a fit
UNDAMPED = 1e-4  # damping to begin with
LARGEST_DAMPING = 1e8
PACE = 3  # last steps down: no step that is left is taken to lower the cost by more than the best of them
STALL = 0.05  # fall of the cost that a step has to bring, and
SLIP = 1.0  # rise above which one that failed was too long: of others
PATIENCE = 5  # one after the other end a fit, which no move of a search would notice
RUNAWAY = 1e10  # times the largest coefficient at first: what is held is nothing, all others grow without end
SAME = 0.01  # of its rise: a failed step whose cost is this near to that of the one before was hardly damped
CLOSING = 3  # steps more, at most, that close the defects which a long step left open


@dataclass(frozen=True, eq=False)
class Fit:
    """A converged structure: its coefficients, initial states, cost, and the information about the coefficients.

    Shapes: theta (mechanisms,) zero where absent; present the numbers of those in the model, held those of them that
    are no parameters, both ascending; x0 (J, n); information (p, p) of the others.
    """

    theta: FloatArray
    present: IntArray
    held: IntArray
    x0: FloatArray
    cost: float
    data_cost: float
    information: FloatArray
    converged: bool

    @cached_property
    def free(self) -> IntArray:
        """The mechanisms whose coefficients are parameters, (p,)."""
        return np.setdiff1d(self.present, self.held)

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters, (p, p), at the noise that the costs were weighed with."""
        return inverse(self.information)

    @property
    def variances(self) -> FloatArray:
        """Variances of the parameters, (p,)."""
        variances: FloatArray = np.diag(self.covariance).copy()
        return variances

    @property
    @np.errstate(over="ignore")  # of coefficients that ran away
    def wald(self) -> FloatArray:
        """Wald statistics of the parameters, (p,)."""
        wald: FloatArray = self.theta[self.free] ** 2 / np.maximum(self.variances, 1e-300)
        return wald

    @property
    def strength(self) -> FloatArray:
        """How well each coefficient is known (mechanisms,): infinitely where it is held, not at all where absent."""
        strength = np.zeros(len(self.theta))
        strength[self.free] = self.wald
        strength[self.held] = np.inf
        return strength

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of coefficients that ran away
    def foreseen_without(self, k: int) -> FloatArray:
        """Return the coefficients (mechanisms,) at the least cost without a parameter, as the information foresees it.

        Args:
            k: number of the mechanism.
        """
        theta, i = self.theta.copy(), int(np.searchsorted(self.free, k))
        theta[self.free] -= self.covariance[:, i] * (theta[k] / self.covariance[i, i])
        theta[k] = 0.0
        return theta


@dataclass(frozen=True, eq=False)
class _Point:
    """Where a fit stands: coefficients, initial states, and what the kernel returned there."""

    theta: FloatArray
    x0: FloatArray
    integrated: Sums
    data_cost: float
    cost: float


@dataclass(frozen=True, eq=False)
class _Descent:
    """What stays the same from step to step of a fit."""

    evaluator: Evaluator
    program: Program
    free: IntArray
    defect_std: FloatArray

    def at(self, theta: FloatArray, x0: FloatArray) -> _Point | None:
        """Return the point, or None where a segment blows up or the states' block is singular."""
        integrated = self.evaluator.integrate(self.program, theta, self.free, x0)
        costs = self.evaluator.costs(integrated, x0, self.defect_std)
        return None if costs is None else _Point(theta, x0, integrated, costs[0], sum(costs))

    def expansion(self, here: _Point, damping: float) -> Expansion | None:
        """Return the expansion about a point, or None where it overflows or the states' block is singular.

        Args:
            here: the point.
            damping: of Levenberg and Marquardt.
        """
        found = self.evaluator.expand(
            self.program, here.theta, self.free, here.x0, self.defect_std, damping, here.integrated
        )
        return found if found is not None and found.finite else None

    def after(self, here: _Point, damping: float) -> _Point | None:
        """Return the point that the expansion asks for, or None where that is none."""
        damped = self.expansion(here, damping)
        if damped is None:
            return None
        least, largest = (limit[self.free] - here.theta[self.free] for limit in self.program.limits)
        step = self.evaluator.change(damped, self.defect_std, least, largest)
        if step is None:
            return None
        theta = here.theta.copy()
        theta[self.free] += step[0]
        return self.at(theta, here.x0 + step[1])

    def lower(self, here: _Point, damping: float) -> _Point | None:
        """Return the next point, which may be no lower than this one.

        Tight continuity makes a valley that is steep and curved: a long step along it leaves defects of the size of its
        square, which cost more than the step gains, while short steps take for ever. One or two steps more close them
        again, so that a step is judged after them, where only the defects are against it.
        """
        trial = self.after(here, damping)
        for _ in range(CLOSING):
            if trial is None or not trial.data_cost < here.cost < trial.cost:
                break
            closed = self.after(trial, damping)
            if closed is None or closed.cost >= trial.cost:
                break
            trial = closed
        return trial


def fit(
    evaluator: Evaluator,
    program: Program,
    theta: FloatArray,
    held: IntArray,
    x0: FloatArray,
    defect_std: FloatArray,
    iterations: int = ITERATIONS,
    tolerance: float = CONVERGED,
    limit: float = np.inf,
) -> Fit | None:
    """Return the fit of a program from a start, or None where the start itself cannot be integrated.

    Steps are accepted only when they lower the cost.

    Args:
        evaluator: the data.
        program: the mechanisms.
        theta: (mechanisms,) coefficients to begin with.
        held: mechanisms whose coefficients stay.
        x0: (J, n) initial states to begin with.
        defect_std: (n,) standard deviations of the defects between segments, infinite for independent segments.
        iterations: steps at most.
        tolerance: fall of the cost that ends it.
        limit: a cost above which the fit is of no use: where it will hardly come below, it ends.
    """
    damping, more, failed, stalled, converged = UNDAMPED, 10.0, np.inf, 0, False
    falls = deque[float](maxlen=PACE)
    present = np.arange(len(program.mechanisms))
    descent = _Descent(evaluator, program, np.setdiff1d(present, held), defect_std)
    here = descent.at(theta, x0)
    if here is None:
        return None
    largest = np.abs(theta).max(initial=1e-300)
    for left in reversed(range(iterations)):
        trial = descent.lower(here, damping)
        fall = -np.inf if trial is None else here.cost - trial.cost
        converged = abs(fall) < (tolerance if fall >= 0.0 else tolerance * 1e-3)
        stalled = 0 if fall > STALL else stalled + int(fall > -SLIP)
        if trial is not None and fall >= 0.0:
            # What had to be damped once would have to be again.
            damping = max(damping / 10.0, 1e-9) if np.isinf(failed) else damping
            here, more, failed = trial, 10.0, np.inf
            falls.append(fall)
            runaway = np.abs(here.theta).max(initial=0.0) > RUNAWAY * largest
            if runaway or (len(falls) == PACE and here.cost - left * max(falls) > limit):
                break
        else:
            more = 10.0 * more if abs(fall + failed) < SAME * abs(fall) else 10.0
            damping, failed = max(damping * more, UNDAMPED), -fall
        converged = converged or stalled >= PATIENCE
        if converged or damping > LARGEST_DAMPING:
            break
    end = descent.expansion(here, 0.0)
    if end is None:
        return None
    return Fit(here.theta, present, held, here.x0, here.cost, here.data_cost, end.information, converged)
