"""Fits of one structure: Levenberg-Marquardt on coefficients and initial states together."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.library.derivative import derivative
from odescope.library.expression import Term
from odescope.library.tape import Tape, write_tape
from odescope.likelihood.elimination import eliminate, substitute
from odescope.likelihood.kernel import LANES, integrate
from odescope.likelihood.segments import Segments

ITERATIONS = 40
CONVERGED = 1e-3  # fall of the cost, which is in units of chi-squared, that ends a fit
LARGEST_DAMPING = 1e8
CLOSING = 3  # steps more, at most, that close the joints which a long step left open
LEAST = 1e-200  # information about a coefficient: what rounding leaves of none can be negative
SINGULAR = 1e-10  # least eigenvalue of a scaled information matrix, over the largest, that is not rounding


@dataclass(frozen=True)
class Slot:
    """One term of one relation: coefficient * factor * term; `factor` is a target's number or -1 for none.

    The coefficient of a fixed slot is 1 and no parameter.
    """

    relation: int
    factor: int
    term: Term
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class Program:
    """Slots compiled for the kernel: a tape of their terms and gradients. Shapes: one entry a slot; grad (K, 3)."""

    slots: tuple[Slot, ...]
    tape: Tape
    grad: IntArray
    following: IntArray
    measured: IntArray

    @staticmethod
    def of(slots: Sequence[Slot], variables: Sequence[str], following: IntArray, measured: IntArray) -> Program:
        """Return the program; `following` and `measured` as in the kernel."""
        states = variables[: len(following)]
        gradients = []
        for k, slot in enumerate(slots):
            for i, state in enumerate(states):
                if state in slot.term.names:
                    combination = derivative(slot.term, state)
                    if combination.parts:
                        gradients.append((k, i, combination))
        tape = write_tape(variables, [*(s.term for s in slots), *(g for _, _, g in gradients)])
        places = tape.outputs[len(slots) :]
        grad = np.array([(k, i, place) for (k, i, _), place in zip(gradients, places, strict=True)], dtype=np.int64)
        return Program(tuple(slots), tape, grad.reshape(-1, 3), following, measured)


@dataclass(frozen=True, eq=False)
class Expansion:
    """Cost and its quadratic expansion after the initial states are eliminated.

    Shapes: information (p, p) reduced Gauss-Newton matrix, gradient (p,) reduced; both of half the cost.
    """

    data_cost: float
    joint_cost: float
    information: FloatArray
    gradient: FloatArray
    log_det: float
    factor: FloatArray
    border: FloatArray
    carry: FloatArray

    @property
    def cost(self) -> float:
        """Data and joints together."""
        return self.data_cost + self.joint_cost

    @property
    def finite(self) -> bool:
        """Whether no sensitivity overflowed."""
        return bool(np.isfinite(self.information).all() and np.isfinite(self.gradient).all())


def scaled(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the information as correlations, and the scale of each coefficient, its square root."""
    scale = np.sqrt(np.maximum(np.diag(information), LEAST))
    with np.errstate(over="ignore"):  # two coefficients of which the data say nothing: rounding over next to nothing
        correlations: FloatArray = np.clip(information / scale / scale[:, None], -1.0, 1.0)
    return correlations, scale


@lru_cache(maxsize=1)
def _pool(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process: none survive a fork, and to start them costs more than a small integration."""
    return ThreadPoolExecutor(os.cpu_count() or 1, f"odescope-{process}")


class Evaluator:
    """Evaluates segments in two or more threads; keeps the arrays that the kernel writes to."""

    def __init__(self, segments: Segments, substeps: int = 1) -> None:
        self.segments = segments
        self.threads = os.cpu_count() or 1
        self.substeps = substeps
        # Inputs are parabolas over a step; finer steps take more of their values.
        s = np.linspace(-1.0, 1.0, 2 * substeps + 1)
        between = np.column_stack([0.5 * s * (s - 1.0), 1.0 - s**2, 0.5 * s * (s + 1.0)])
        self.inputs = np.ascontiguousarray(np.einsum("kn,mni->mki", between, segments.inputs))

    def integrate(self, program: Program, theta: FloatArray, free: IntArray, x0: FloatArray) -> tuple[FloatArray, ...]:
        """Return cost (J,), gradient, hessian, last, jacobian of every segment (see the kernel).

        Args:
            program: the slots.
            theta: (slots,) coefficients.
            free: slots that are parameters.
            x0: (J, n) initial states.
        """
        data, tape = self.segments, program.tape
        j, n, p = len(data.start), x0.shape[1], len(free)
        param = np.full(len(program.slots), -1, dtype=np.int64)
        param[free] = np.arange(p)
        owner = np.array([s.relation for s in program.slots], dtype=np.int64)
        factor = np.array([s.factor for s in program.slots], dtype=np.int64)
        out = (
            np.empty(j),
            np.empty((j, n + p)),
            np.empty((j, n + p, n + p)),
            np.empty((j, n)),
            np.empty((j, n, n + p)),
        )

        def part(begin: int, end: int) -> None:
            integrate(
                *tape.instructions, tape.outputs[: len(program.slots)], owner, factor,
                param, theta, program.grad, program.following, program.measured, 1.0 / data.noise, data.step,
                self.substeps, p, data.start, data.count, data.measured, self.inputs, x0, begin, end, *out,
            )  # fmt: skip

        edges = np.linspace(0, j, min(self.threads, -(-j // LANES)) + 1).astype(int)
        others = [_pool(os.getpid()).submit(part, a, b) for a, b in pairwise(edges[1:])]
        part(0, edges[1])
        for other in others:
            other.result()
        return out

    def expand(
        self,
        program: Program,
        theta: FloatArray,
        free: IntArray,
        x0: FloatArray,
        gap: FloatArray,
        damping: float = 0.0,
        integrated: tuple[FloatArray, ...] | None = None,
    ) -> Expansion | None:
        """Return cost and expansion, or None where a segment blows up or the states' block is singular."""
        cost, gradient, hessian, last, jacobian = integrated or self.integrate(program, theta, free, x0)
        if not np.isfinite(cost.sum()) or not np.all(np.isfinite(last)):
            return None
        joined: BoolArray = self.segments.joined & bool(np.all(np.isfinite(gap)))
        joints, information, reduced, factor, border, carry, log_det, ok = eliminate(
            hessian, gradient, last, jacobian, x0, joined, gap, damping, x0.shape[1], len(free)
        )
        if not ok:
            return None
        return Expansion(float(cost.sum()), joints, information, reduced, log_det, factor, border, carry)

    def change(self, expansion: Expansion, gap: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return the step of parameters and initial states that the expansion asks for."""
        joined: BoolArray = self.segments.joined & bool(np.all(np.isfinite(gap)))
        if len(expansion.gradient):
            information, scale = scaled(expansion.information)
            try:
                solved = np.linalg.solve(information, -expansion.gradient / scale)
            except np.linalg.LinAlgError:
                return None
            step = solved / scale
        else:
            step = np.zeros(0)
        return step, substitute(expansion.factor, expansion.border, expansion.carry, joined, step)


@dataclass(frozen=True, eq=False)
class Fit:
    """A converged structure: theta (slots,) zero where absent, present slots, initial states, cost and information."""

    theta: FloatArray
    present: IntArray
    x0: FloatArray
    cost: float
    data_cost: float
    information: FloatArray
    converged: bool

    @property
    def variances(self) -> FloatArray:
        """Variances of the present coefficients, (p,), at the noise that the costs were weighed with."""
        information, scale = scaled(self.information)
        values, vectors = np.linalg.eigh(information)
        # What two terms cannot be told apart by is rounding, of either sign: large variances, never negative ones.
        values = np.maximum(values, SINGULAR * values.max(initial=0.0))
        variances: FloatArray = (vectors**2 @ (1.0 / values)) / scale**2
        return variances


@dataclass(frozen=True, eq=False)
class _Point:
    """Where a fit stands: coefficients, initial states, what the kernel returned there, and the expansion of that."""

    theta: FloatArray
    x0: FloatArray
    integrated: tuple[FloatArray, ...]
    expansion: Expansion


@dataclass(frozen=True, eq=False)
class _Descent:
    """What stays the same from step to step of a fit."""

    evaluator: Evaluator
    program: Program
    present: IntArray
    gap: FloatArray

    def at(self, theta: FloatArray, x0: FloatArray) -> _Point | None:
        """Return the point, or None where a segment blows up."""
        integrated = self.evaluator.integrate(self.program, theta, self.present, x0)
        expansion = self.evaluator.expand(self.program, theta, self.present, x0, self.gap, 0.0, integrated)
        return None if expansion is None or not expansion.finite else _Point(theta, x0, integrated, expansion)

    def after(self, here: _Point, damping: float) -> _Point | None:
        """Return the point that the expansion asks for, or None where that is none."""
        damped = self.evaluator.expand(
            self.program, here.theta, self.present, here.x0, self.gap, damping, here.integrated
        )
        step = None if damped is None else self.evaluator.change(damped, self.gap)
        if step is None:
            return None
        theta = here.theta.copy()
        theta[self.present] += step[0]
        return self.at(theta, here.x0 + step[1])

    def lower(self, here: _Point, damping: float) -> _Point | None:
        """Return the next point, which may be no lower than this one.

        Narrow gaps make a valley that is steep and curved: a long step along it leaves joints open by its square, which
        costs more than the step gains, while short steps take for ever. One or two steps more close the joints again,
        so that a step is judged after them, where only the joints are against it.
        """
        trial = self.after(here, damping)
        for _ in range(CLOSING):
            if trial is None or not trial.expansion.data_cost < here.expansion.cost < trial.expansion.cost:
                break
            closed = self.after(trial, damping)
            if closed is None or closed.expansion.cost >= trial.expansion.cost:
                break
            trial = closed
        return trial


def fit(
    evaluator: Evaluator,
    program: Program,
    theta: FloatArray,
    present: IntArray,
    x0: FloatArray,
    gap: FloatArray,
    iterations: int = ITERATIONS,
) -> Fit | None:
    """Return the fit of the present slots from a start, or None where the start itself cannot be integrated.

    Steps are accepted only when they lower the cost; `gap` (n,) are the standard deviations of the joints' gaps,
    infinite for independent segments.
    """
    damping, converged = 1e-4, False
    descent = _Descent(evaluator, program, present, gap)
    here = descent.at(theta, x0)
    if here is None:
        return None
    for _ in range(iterations):
        trial = descent.lower(here, damping)
        fall = -np.inf if trial is None else here.expansion.cost - trial.expansion.cost
        converged = abs(fall) < (CONVERGED if fall >= 0.0 else CONVERGED * 1e-3)
        if trial is not None and fall >= 0.0:
            here = trial
            damping = max(damping / 10.0, 1e-9)
        else:
            damping *= 10.0
        if converged or damping > LARGEST_DAMPING:
            break
    end = here.expansion
    return Fit(here.theta, present, here.x0, end.cost, end.data_cost, end.information, converged)
