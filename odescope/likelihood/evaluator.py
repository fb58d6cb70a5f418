"""The likelihood of segments around one structure: its cost, and its expansion with the initial states eliminated."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.likelihood.block_cholesky import substitute
from odescope.likelihood.budget import Budget
from odescope.likelihood.expansion import Expansion, correlated, costs, decorrelated, eliminate, scaled
from odescope.likelihood.kernel import LANES, Averages, Settings, Sums, integrate
from odescope.likelihood.program import Program, effects_of
from odescope.likelihood.segments import Segments


@lru_cache(maxsize=1)
def _pool(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process: none survive a fork, and to start them costs more than a small integration."""
    return ThreadPoolExecutor(os.cpu_count() or 1, f"odescope-{process}")


class _Driven(NamedTuple):
    """Inputs on the nodes of the steps (N, 3, i), their cuts (N,), and the delays that they are for."""

    delays: tuple[float, ...] | None
    nodes: FloatArray
    cuts: FloatArray


class Evaluator:
    """Evaluates segments in two or more threads."""

    def __init__(self, segments: Segments, substeps: int = 1, budget: Budget | None = None) -> None:
        self.segments = segments
        self.threads = os.cpu_count() or 1
        self.substeps = substeps
        self.budget = Budget() if budget is None else budget
        self._uncut = np.ones(len(segments.measured))
        self._driven = _Driven(None, np.ascontiguousarray(segments.inputs), self._or_uncut(segments.cuts))
        self._weight = np.ones_like(segments.measured) if segments.weight is None else segments.weight

    def _data(self, delays: tuple[float, ...] | None) -> Averages:
        """Return the measurements, with inputs so late, and beside them what they gain with their delays."""
        known, data = self._driven, self.segments
        if delays != known.delays:
            nodes, cuts = (data.inputs, data.cuts) if delays is None else data.late(delays)
            known = self._driven = _Driven(delays, nodes, self._or_uncut(cuts))
        seen = data.start, data.count, data.measured, self._weight
        return Averages(1.0 / data.noise, data.step, self.substeps, *seen, known.nodes, known.cuts)

    def _or_uncut(self, cuts: FloatArray | None) -> FloatArray:
        return self._uncut if cuts is None else cuts

    def integrate(self, program: Program, theta: FloatArray, free: IntArray, x0: FloatArray) -> Sums:
        """Return cost, gradient, Gauss-Newton matrix, end and its derivatives of every segment.

        Args:
            program: the mechanisms.
            theta: (mechanisms,) coefficients.
            free: mechanisms whose coefficients are parameters.
            x0: (J, n) initial states.

        Raises:
            Stopped: the run is to end.
        """
        self.budget.monitor.check()
        j, n, p = len(self.segments.start), x0.shape[1], len(free)
        number = np.full(len(program.mechanisms), -1, dtype=np.int64)
        number[free] = np.arange(p)
        places = program.places
        with np.errstate(over="ignore"):  # of a step that ran away
            weight = places.share * theta[places.mechanism]
        data, offsets = self._data(program.delays(theta)), program.offsets
        settings = Settings(
            program.constants(theta),
            np.where(offsets < 0, 0.0, theta[offsets]),
            np.where(offsets < 0, -1, number[offsets]),
        )
        effects = effects_of(places, weight, number, p)
        threads = min(self.threads, -(-j // LANES))
        out = Sums(
            cost=np.empty(j),
            gradient=np.empty((j, n + p)),
            hessian=np.empty((j, n, n + p)),
            inner=np.empty((threads, p, p)),
            last=np.empty((j, n)),
            jacobian=np.empty((j, n, n + p)),
        )

        def part(thread: int, begin: int, end: int) -> int:
            code, layers = program.tape.instructions, program.layers
            taken: int = integrate(code, places, layers, effects, weight, settings, data, x0, thread, begin, end, out)
            return taken

        parts = list(enumerate(pairwise(np.linspace(0, j, threads + 1).astype(int))))
        others = [_pool(os.getpid()).submit(part, k, *edges) for k, edges in parts[1:]]
        taken = sum(part(k, *edges) for k, edges in parts[:1]) + sum(other.result() for other in others)
        self.budget.spend(self.segments, program, p, taken)
        with np.errstate(over="ignore", invalid="ignore"):  # of a segment that ran away
            return out._replace(inner=out.inner.sum(axis=0))

    def costs(self, sums: Sums, x0: FloatArray, defect_std: FloatArray) -> tuple[float, float] | None:
        """Return the cost of the data and that of the defects, or None where there is no expansion.

        Args:
            sums: what `integrate` returned.
            x0: (J, n) initial states.
            defect_std: (n,) standard deviations of the defects between segments.
        """
        sums, x0 = decorrelated(sums, x0, self.segments.decorrelation)
        return costs(sums, x0, self._joined(defect_std), defect_std)

    def expand(
        self,
        program: Program,
        theta: FloatArray,
        free: IntArray,
        x0: FloatArray,
        defect_std: FloatArray,
        damping: float = 0.0,
        integrated: Sums | None = None,
    ) -> Expansion | None:
        """Return cost and expansion, or None where a segment blows up or the states' block is singular.

        Args:
            program: the mechanisms.
            theta: (mechanisms,) coefficients.
            free: mechanisms whose coefficients are parameters.
            x0: (J, n) initial states.
            defect_std: (n,) standard deviations of the defects between segments.
            damping: of Levenberg and Marquardt: multiplies the diagonal by 1 + damping.
            integrated: what `integrate` returned at the same place, if it was called before.
        """
        sums = self.integrate(program, theta, free, x0) if integrated is None else integrated
        with np.errstate(over="ignore"):  # of a segment that ran away
            total = sums.cost.sum()
        if not np.isfinite(total) or not np.all(np.isfinite(sums.last)):
            return None
        sums, x0 = decorrelated(sums, x0, self.segments.decorrelation)
        return eliminate(sums, x0, self._joined(defect_std), defect_std, damping)

    def change(
        self, expansion: Expansion, defect_std: FloatArray, least: FloatArray, largest: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return the step of parameters and initial states that the expansion asks for.

        Args:
            expansion: of the cost.
            defect_std: (n,) standard deviations of the defects between segments.
            least: (p,) of the steps of parameters; what would go further ends there, and the others step beside it.
            largest: (p,) of these.
        """
        step, open_ = np.zeros(len(expansion.gradient)), np.ones(len(expansion.gradient), dtype=np.bool_)
        while open_.any():
            information, scale = scaled(expansion.information[np.ix_(open_, open_)])
            pull = expansion.gradient[open_] + expansion.information[np.ix_(open_, ~open_)] @ step[~open_]
            try:
                with np.errstate(over="ignore"):  # of a parameter of which the data say nothing
                    step[open_] = np.linalg.solve(information, -pull / scale) / scale
            except np.linalg.LinAlgError:
                return None
            beyond = open_ & ((step < least) | (step > largest))
            if not beyond.any():
                break
            step[beyond] = np.clip(step, least, largest)[beyond]
            open_ &= ~beyond
        moved = substitute(expansion.factor, expansion.border, expansion.carry, self._joined(defect_std), step)
        return step, correlated(moved, self.segments.decorrelation)

    def _joined(self, defect_std: FloatArray) -> BoolArray:
        """Return (J,) whether the end of a segment is tied to the begin of the next."""
        joined: BoolArray = self.segments.joined & bool(np.all(np.isfinite(defect_std)))
        return joined
