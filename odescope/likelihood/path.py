"""The path of models from many mechanisms to few, and where on it to stop.

What a model of a real machine misses is coloured, and every criterion for white noise keeps far more terms than are
physics. Free runs of what a fit has not seen do not: the choice is the shortest model whose error is within one spread
of the least, or too small to matter. docs/method.md, The path of models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.library.mechanism import Mechanism
from odescope.likelihood.fit import CONVERGED, ITERATIONS, Fit
from odescope.likelihood.held_out import free_run_errors
from odescope.likelihood.search_space import SearchSpace

FAITHFUL = 0.005  # standard deviations of what was measured: a free run as near to the record needs no more terms
WORTH = 3.0  # times the least error: but what a term improves as much is physics, however near the runs are
TELLING = 0.1  # standard deviations: where even the best free run is further from the record, runs tell little of terms
QUICK = 2  # steps of a fit without a mechanism, which are enough
FORETOLD = 1.1  # if they raise the cost by no more than so many times its Wald statistic, as in a linear model
FAR = 10  # steps of other fits where they are rough, and
NEAR = 0.01  # of what the cost is above that of the longest: how near they come
LOST = 0.5  # standard deviations of what was measured: further away a free run follows nothing,
KEPT = 0.25  # and where a longer model was nearer than this, no shorter one than a lost one is worth its fit
TENTH = 0.1  # of the least error: where free runs tell little, no more than that is given away for fewer terms


@dataclass(frozen=True, eq=False)
class PathStep:
    """A model on the path: its fit to what is not held out, and its errors on what is.

    `errors` are the root mean square errors of free runs in every stretch that is held out, in standard deviations of
    what was measured and saturating at 1; `dropped` is what the model before it had beside, `statistic` the Wald
    statistic of that; `terms` the number of mechanisms that have parts.
    """

    fit: Fit
    errors: FloatArray
    dropped: Mechanism | None
    statistic: float
    terms: int

    @property
    def error(self) -> float:
        """Root mean square of the errors."""
        return float(np.sqrt(np.mean(self.errors**2)))

    @property
    def spread(self) -> float:
        """Standard deviation of the errors of stretches."""
        return float(self.errors.std(ddof=1)) if len(self.errors) > 1 else 0.0


@dataclass(frozen=True, eq=False)
class ModelPath:
    """Models from the longest to the shortest, each without what the one before it needed least, and which is chosen.

    `space` is what they were fitted in, without what is held out.
    """

    space: SearchSpace
    steps: tuple[PathStep, ...]
    chosen: int

    @staticmethod
    def back(seen: SearchSpace, found: Fit, defect_std: FloatArray, rough: bool = False) -> ModelPath:
        """Return the path from a fit, which is chosen.

        Args:
            seen: the space without what is held out.
            found: the longest model, fitted there.
            defect_std: (n,) standard deviations of the defects between segments.
            rough: whether models that lack much are fitted to a part of what they lack: what is chosen is fitted anew.
        """
        steps = [_step(seen, found)]
        while not (seen.budget.over or _lost(steps)):
            here = steps[-1].fit
            wald = [w for w, k in zip(here.wald, here.free, strict=True) if seen.mechanisms[k].parts]
            if len(wald) < 2:
                break
            weak = int(np.flatnonzero(here.wald == min(wald))[0])
            k, theta = int(here.free[weak]), here.theta.copy()
            theta[k] = 0.0
            rest = here.present[here.present != k]
            shorter = seen.fit(theta, rest, here.x0, defect_std, here.strength, QUICK)
            if shorter is not None and shorter.cost - here.cost > FORETOLD * float(here.wald[weak]):
                how = (FAR, NEAR * (shorter.cost - steps[0].fit.cost)) if rough else (ITERATIONS, CONVERGED)
                shorter = seen.fit(shorter.theta, rest, shorter.x0, defect_std, shorter.strength, *how)
            if shorter is None:
                break
            steps.append(_step(seen, shorter, seen.mechanisms[k], float(here.wald[weak])))
        return ModelPath(seen, tuple(steps), 0)

    @property
    def choice(self) -> PathStep:
        """The model that is chosen."""
        return self.steps[self.chosen]

    @property
    def at_knee(self) -> ModelPath:
        """The path with the shortest model chosen whose error is within its spread of the least, or small enough."""
        best = min(self.steps, key=lambda s: s.error)
        enough = max(best.error if best.error < TELLING else 0.0, min(FAITHFUL, WORTH * best.error))
        within = [k for k, s in enumerate(self.steps) if s.error - s.spread <= enough or _as_well(s, best)]
        return replace(self, chosen=max(within))

    def chosen_at(self, terms: int) -> ModelPath:
        """Return the path with the model of so many mechanisms chosen.

        Raises:
            InputError: it has none.
        """
        for k, step in enumerate(self.steps):
            if step.terms == terms:
                return replace(self, chosen=k)
        shortest, longest = self.steps[-1].terms, self.steps[0].terms
        raise InputError(
            f"[likelihood] terms = {terms}: the path of models goes from {longest} terms down to {shortest}; choose"
            " one of these"
        )


def _lost(steps: Sequence[PathStep]) -> bool:
    """Say whether the last model follows nothing of what is held out, where a longer one did."""
    return steps[-1].error > LOST and min(s.error for s in steps) < KEPT


def _as_well(step: PathStep, best: PathStep) -> bool:
    """Say whether a model is no worse than the best, but for the standard error of their difference over stretches."""
    worse = step.errors - best.errors
    chance = float(worse.std(ddof=1)) / np.sqrt(len(worse)) if len(worse) > 1 else 0.0
    return bool(worse.mean() <= chance and step.error <= (1.0 + TENTH) * best.error)


def _step(seen: SearchSpace, found: Fit, dropped: Mechanism | None = None, statistic: float = 0.0) -> PathStep:
    errors: FloatArray = np.sqrt(free_run_errors(seen, found.theta))
    terms = sum(bool(seen.mechanisms[k].parts) for k in found.present)
    return PathStep(found, errors, dropped, statistic, terms)
