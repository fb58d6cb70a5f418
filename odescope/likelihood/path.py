"""The path of models from many mechanisms to few, and where on it to stop.

What a model of a real machine misses is coloured, and every criterion for white noise keeps far more terms than are
physics. Free runs of what a fit has not seen do not: the choice is the shortest model that runs no worse than the best,
stretch by stretch, but for chance, or whose error is too small to matter. docs/method.md, The path of models.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.library.mechanism import Mechanism
from odescope.likelihood.fit import CONVERGED, ITERATIONS, Fit
from odescope.likelihood.fit_without import fit_without
from odescope.likelihood.held_out import WINDOWS, free_run_errors, stretches
from odescope.likelihood.lacking import has_dry_friction, lacking
from odescope.likelihood.negligible import contributions
from odescope.likelihood.search_space import SearchSpace

VERY = 0.005  # standard deviations of what was measured: a free run as near to the record, but for the spread of
FAITHFUL = 0.01  # stretches, needs no more terms; where the misfit is not white, nor does one as near as this
WORTH = 3.0  # times the least error: but what a term improves as much is physics, however near the runs are
TELLING = 0.1  # standard deviations: where even the best free runs are further from the record, shorter ones tell more
SHORT = 8  # averages, of the shortest runs
QUICK = 2  # steps of a fit without a mechanism, which are enough
FORETOLD = 1.1  # if they raise the cost by no more than so many times its Wald statistic, as in a linear model
FAR = 10  # steps of other fits where they are rough, and
NEAR = 0.01  # of what the cost is above that of the longest: how near they come
SURE = 2.5  # times its price: where the misfit is white, a mechanism that earns more stays unless runs are near anyway
SLIGHT = 0.01  # of the largest term of its relation: a sure one that makes more stays, however near runs are
HALVES = 1.0  # times the samples: without what has such a Wald statistic, what is unexplained has twice the variance
LOST = 0.5  # standard deviations of what was measured: further away a free run follows nothing,
KEPT = 0.25  # and where a longer model was nearer than this, no shorter one than a lost one is worth its fit


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
        return _rms(self.errors)

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
            k = int(here.free[weak])
            shorter = fit_without(seen, here, k, defect_std, QUICK)
            if shorter is not None and shorter.cost - here.cost > FORETOLD * float(here.wald[weak]):
                how = (FAR, NEAR * (shorter.cost - steps[0].fit.cost)) if rough else (ITERATIONS, CONVERGED)
                rest = here.present[here.present != k]
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
    def keeping_sure(self) -> ModelPath:
        """The path with no model chosen that lacks what earned more than SURE times its price in a longer one.

        Unless that was slight, no zero of an input, and runs are near enough: a misfit of thousandths may look white,
        and holds ever more that is sure.
        """
        price, allowed, lacks = surely(self.space), 0, False
        for k, (longer, step) in enumerate(pairwise(self.steps[: self.chosen + 1]), start=1):
            dropped = self.space.mechanisms.index(step.dropped)
            if step.statistic > price[dropped]:
                lacks = True
                if dropped in self.space.zeros or contributions(self.space, longer.fit.theta)[dropped] > SLIGHT:
                    break
            if not lacks or near_enough(self.steps, k, VERY):
                allowed = k
        return replace(self, chosen=allowed)

    def at_knee(self, faithful: float = FAITHFUL) -> ModelPath:
        """Return the path with the shortest model chosen that runs freely no worse than the best, or near enough.

        None that lacks what halves the variance of what is unexplained: that is physics, however near runs are.

        Args:
            faithful: error of a free run that is near enough, in standard deviations of what was measured.
        """
        pieces, unseen = telling(self.space, [s.fit.theta for s in self.steps], [s.errors for s in self.steps])
        over = stretches(self.space.segments)
        steps = self.steps[: 1 + self._last_with(lambda _: HALVES * self.space.segments.samples)]
        return replace(
            self, chosen=knee(steps, unseen, lambda step: _errors(self.space, step.fit.theta, over, pieces), faithful)
        )

    @property
    def keeping_friction(self) -> ModelPath:
        """The path with no model chosen that lacks dry friction which a longer one has, where what it leaves shows it.

        A small friction moves a free run by little. But what is unexplained goes with the sign of a velocity then.
        """
        here = self
        while (k := here._last_with_friction()) is not None:
            here = replace(self, chosen=k)
        return here

    def _last_with_friction(self) -> int | None:
        """Return the number of the last model that has a friction that the chosen one is seen to lack."""
        shown = {m.cause for m in lacking(self.space, self.choice.fit) if m.friction}
        having = (
            k
            for k, step in enumerate(self.steps[1 : self.chosen + 1])
            if step.dropped is not None and any(has_dry_friction([step.dropped], v) for v in shown)
        )
        return max(having, default=None)

    def _last_with(self, enough: Callable[[Mechanism], float]) -> int:
        """Return the number of the last model that has all whose Wald statistic is more than enough."""
        lost = (s.dropped is not None and s.statistic > enough(s.dropped) for s in self.steps)
        return next((k - 1 for k, lacks in enumerate(lost) if lacks), len(self.steps) - 1)

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


def surely(space: SearchSpace) -> FloatArray:
    """Return what each mechanism has to earn (mechanisms,) to stay whatever free runs say: SURE times its price.

    The zero of an input stays for its price, as that of a sensor does: it moves free runs by little, and is usual.
    """
    times = np.full(len(space.mechanisms), SURE)
    times[space.zeros] = 1.0
    return times * space.penalty


def telling(
    space: SearchSpace, models: Sequence[FloatArray], whole: Sequence[FloatArray] | None = None
) -> tuple[int, list[FloatArray]]:
    """Return the errors of models over what is held out, in free runs so short that the best one follows.

    Before them stands in how many pieces a stretch is run, 0 if to its end.

    Args:
        space: the data and candidates.
        models: (mechanisms,) coefficients of each.
        whole: their errors in runs to the end of each stretch, where these are known.
    """
    length, pieces = min(high - low for low, high in stretches(space.segments)), 0
    errors = [_errors(space, theta) for theta in models] if whole is None else list(whole)
    while min(map(_rms, errors)) > TELLING and (shorter := 2 * pieces or WINDOWS) < length // SHORT:
        pieces = shorter
        errors = [_errors(space, theta, None, pieces) for theta in models]
    return pieces, errors


def _lost(steps: Sequence[PathStep]) -> bool:
    """Say whether the last model follows nothing of what is held out, where a longer one did."""
    return steps[-1].error > LOST and min(s.error for s in steps) < KEPT


def knee(
    steps: Sequence[PathStep],
    unseen: Sequence[FloatArray],
    anywhere: Callable[[PathStep], FloatArray],
    faithful: float = FAITHFUL,
) -> int:
    """Return the number of the shortest model that runs freely no worse than the best, or near enough.

    The best is that of the least error over what is held out. No worse is one for which neither the runs there nor
    those over the whole record say otherwise: the former may be few, and the latter have been fitted to.

    Args:
        steps: the models.
        unseen: errors (n,) of each in free runs over what is held out.
        anywhere: returns those of one over the whole record (m,).
        faithful: error of a free run that is near enough, in standard deviations of what was measured.
    """
    best = min(range(len(steps)), key=lambda k: _rms(unseen[k]))
    of_the_best = anywhere(steps[best])
    return max(
        k
        for k, s in enumerate(steps)
        if near_enough(steps, k, faithful)
        or (_no_worse(unseen[k], unseen[best]) and _no_worse(anywhere(s), of_the_best))
    )


def near_enough(steps: Sequence[PathStep], k: int, faithful: float) -> bool:
    """Say whether free runs of a model are so near that none can be nearer by what matters.

    Args:
        steps: the models.
        k: number of the one.
        faithful: error of a free run that is near enough, in standard deviations of what was measured; half a percent
            is, but for the spread of the errors.
    """
    error, worth = steps[k].error, WORTH * min(s.error for s in steps)
    return error - steps[k].spread <= min(VERY, worth) or error <= min(faithful, worth)


def _no_worse(errors: FloatArray, best: FloatArray) -> bool:
    """Say whether errors (n,) are no larger than those of the best, but for the standard error of the mean difference.

    What every model finds hard in a stretch is in both, and cancels.
    """
    worse = errors - best
    chance = float(worse.std(ddof=1)) / np.sqrt(len(worse)) if len(worse) > 1 else 0.0
    return bool(worse.mean() <= chance)


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _errors(
    space: SearchSpace, theta: FloatArray, over: Sequence[tuple[int, int]] | None = None, pieces: int = 0
) -> FloatArray:
    """Return root mean square errors of free runs, see `free_run_errors`."""
    errors: FloatArray = np.sqrt(free_run_errors(space, theta, over, pieces))
    return errors


def _step(seen: SearchSpace, found: Fit, dropped: Mechanism | None = None, statistic: float = 0.0) -> PathStep:
    terms = sum(bool(seen.mechanisms[k].parts) for k in found.present)
    return PathStep(found, _errors(seen, found.theta), dropped, statistic, terms)
