"""Searches under what suits the record best of what inputs may do between samples: their holds, and when they step.

docs/method.md, Inputs between samples.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.events import Monitor
from odescope.likelihood.add_and_drop import GAIN
from odescope.likelihood.before_records import measured_where_known, misses_the_unknown
from odescope.likelihood.fit import Fit
from odescope.likelihood.held_out import thinned
from odescope.likelihood.holds import DEAREST, TRIAL_STEPS, choose_holds, holds_of
from odescope.likelihood.search import THIN, Outcome
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import searches
from odescope.likelihood.segments import SEGMENT, Segments, cut_segments
from odescope.likelihood.step_times import WORTH, StepTimes, price_of_times
from odescope.likelihood.steps import with_fine_steps
from odescope.likelihood.timed_fit import Steps, Timed, covariance_with_times, timed_fit
from odescope.parallel.workers import Workers
from odescope.recordings.coordinate import Hold
from odescope.recordings.record import Records
from odescope.signals.differentiators import Differentiator
from odescope.signals.estimate import Signals

ANEW = 3  # searches, at most, under other holds of inputs, and with other times of their steps


@dataclass(frozen=True, eq=False)
class Between:
    """What is known, and what is open, of what the inputs of a record do between its samples.

    `open` are the inputs whose holds are open, with the hold that the log itself shows; `steps` those of inputs that
    may come between samples, with what is known of when, None where there are none; `unknown` is the share of the
    record that does not count, as inputs that act late were not known then.
    """

    records: Records
    signals: Signals
    differentiator: Differentiator
    open: Mapping[str, Hold]
    steps: StepTimes | None
    unknown: float = 0.0

    @staticmethod
    def of(records: Records, signals: Signals, differentiator: Differentiator, held: Collection[str]) -> Between:
        """Return what is known before any search.

        Args:
            records: uniformly sampled, at one period.
            signals: found in them.
            differentiator: that they were found with.
            held: names of the inputs whose holds are open.
        """
        steps = StepTimes.of(records, signals.inputs, held)
        by_clock = set[str]() if steps is None else steps.by_clock([i.name for i in signals.inputs])
        inputs = [msgspec.structs.replace(i, hold="zero") if i.name in by_clock else i for i in signals.inputs]
        open_ = {i.name: i.hold for i in signals.inputs if i.name in held and i.name not in by_clock}
        return Between(records, replace(signals, inputs=tuple(inputs)), differentiator, open_, steps)

    @property
    def names(self) -> list[str]:
        """Those of the inputs."""
        return [i.name for i in self.signals.inputs]

    @property
    def holds(self) -> list[Hold]:
        """What inputs do between samples as far as the log itself shows."""
        return [i.hold for i in self.signals.inputs]

    @property
    def placed(self) -> dict[str, int]:
        """How many steps come between samples, by input."""
        return {} if self.steps is None else self.steps.placed(self.names)

    @property
    def moved(self) -> bool:
        """Whether some step is taken to come at another time than is expected."""
        return self.steps is not None and self.steps.moved

    def cut(self, holds: Sequence[Hold], length: int) -> Segments:
        """Return the segments of about so many averages, under these holds of the inputs."""
        return self._cut(holds, length, None if self.steps is None else self.steps.on_samples(self.records))

    def _cut(self, holds: Sequence[Hold], length: int, early: FloatArray | None = None) -> Segments:
        inputs = (msgspec.structs.replace(i, hold=hold) for i, hold in zip(self.signals.inputs, holds, strict=True))
        signals = replace(self.signals, inputs=tuple(inputs))
        return cut_segments(self.records, signals, self.differentiator, length, early)

    def first(self, space: SearchSpace, begun: Sequence[FloatArray]) -> tuple[Between, SearchSpace]:
        """Return this and a space with fine steps as suits the start that fits best in loose segments.

        Args:
            space: under the first holds.
            begun: (mechanisms,) coefficients of each start.
        """
        space = with_fine_steps(space, begun)
        loose, wanted = np.full_like(space.segments.spread, np.inf), self.open or self.steps is not None
        fits = [
            space.fit(theta, np.flatnonzero(theta), space.segments.initial, loose, iterations=TRIAL_STEPS)
            for theta in (begun if wanted else ())
        ]
        able = [f for f in fits if f is not None]
        if not able:
            return self, space
        best = min(able, key=lambda f: f.cost)
        holds = choose_holds(space, best, self.open).holds if self.open else holds_of(space)
        scale = max(best.cost / space.segments.samples, 1.0)  # many terms take the effect of a step for their own
        stepping = self.stepping(space, min(able, key=lambda f: f.cost / scale + space.price(f)), holds)
        if stepping is None and holds == holds_of(space):
            return self, space
        between, holds = (self, holds) if stepping is None else stepping[:2]
        return between, with_fine_steps(space.on(between.cut(holds, SEGMENT)), begun)

    def stepping(
        self,
        space: SearchSpace,
        found: Fit,
        holds: Sequence[Hold],
        end: Outcome | None = None,
        others: Sequence[FloatArray] = (),
    ) -> tuple[Between, tuple[Hold, ...], Fit] | None:
        """Return this and the holds with inputs that step when it suits a model, and that without delays.

        None where the record has no need of other times. Of a model that holds in joined segments they are those that
        suit the joined record best.

        Args:
            space: of the model.
            found: the model.
            holds: what every input does between samples by now.
            end: that of the search for it, None before any.
            others: (mechanisms,) coefficients of other models.
        """
        period = space.segments.step / space.segments.block
        if self.steps is None or any(abs(found.theta[k]) > period for k in _delays(space, found)):
            return None  # what comes late by more than a sample is another matter
        prompt, present = _at_once(space, found.theta), np.setdiff1d(found.present, _delays(space, found))
        found = replace(found, theta=prompt, present=present)
        steps = self.steps.settled(self._cut, space, found, holds)
        moving = dict(zip(self.names, (steps or self.steps).stepping.tolist(), strict=True))
        held: tuple[Hold, ...] = tuple("zero" if moving[n] else h for n, h in zip(self.names, holds, strict=True))
        still = {name: hold for name, hold in self.open.items() if not moving[name]}
        placed = self.steps.moved or steps is not None
        other = replace(self, open=still, steps=steps or (self.steps if placed else self.steps.anywhere()))
        timed = None
        if other.moved and end is not None and np.isfinite(end.width) and (placed or not end.clear):
            timed = other.timed(space, held, end, [found.theta, *others], placed)
        if timed is not None:
            return timed[0], held, timed[1]
        return None if steps is None else (other, held, found)

    def timed(
        self,
        space: SearchSpace,
        holds: Sequence[Hold],
        end: Outcome,
        others: Sequence[FloatArray],
        known: bool,
    ) -> tuple[Between, Fit] | None:
        """Return this and a model with steps when it suits the joined record; None where it hardly asks for others.

        Times that suit a model with a term too many suit no other: shorter models get times of their own, that without
        what is not worth its price while times are open, too.

        Args:
            space: of the model.
            holds: what every input does between samples.
            end: that of the search for the model, which is tried without its delays.
            others: (mechanisms,) coefficients of other models.
            known: whether times were known before, else they have to be worth more than none.
        """
        there = space.on(thinned(self.cut(holds, SEGMENT)))
        seen = None if self.steps is None else self.steps.seen(self.records, self.names, there)
        if self.steps is None or seen is None or there.segments.samples != space.segments.samples:
            return None
        steps, among = seen
        own = _timed(there, _at_once(there, end.fit.theta), steps, end.width)
        if own is None:
            return None
        shorter = [_at_once(there, theta) for theta in (_without_weak(there, *own), *others)]
        shorter = [t for t in shorter if there.penalty[t != 0.0].sum() < there.penalty[own[0].present].sum()]
        trials = [own, *(t for theta in shorter if (t := _timed(there, theta, steps, end.width)) is not None)]
        fit, best = min(trials, key=lambda t: t[1].cost + there.price(t[0]))
        scale, after = _scale(there, best), best.cost + there.price(fit)
        if known:
            least = DEAREST * scale if fit is own[0] else GAIN
            better = own[1].cost + own[1].fall + there.price(own[0]) - after > least
        else:
            # What a model lacks that leaves far more than times explain is something else.
            enough = end.fit.cost - best.cost > WORTH * (end.fit.cost - there.segments.samples)
            price = scale * float(price_of_times(best.known, scale).sum())
            better = enough and end.penalised - after - price > DEAREST * scale
        if not better:
            return None
        early = self.steps.early.copy()
        early[among] = best.early
        return replace(self, steps=replace(self.steps, early=early)), replace(fit, theta=best.theta)

    def covariance(self, space: SearchSpace, found: Fit, width: float) -> FloatArray:
        """Return the covariance (p, p) of a model's parameters, times of steps open, at the noise that its costs have.

        Args:
            space: whose segments have the steps at these times.
            found: the model.
            width: of the defects.
        """
        seen = self.steps.seen(self.records, self.names, space) if self.steps is not None and self.moved else None
        if seen is None:
            return found.covariance
        return covariance_with_times(space, found, seen[0], space.segments.spread * width)

    def searched(
        self,
        space: SearchSpace,
        begun: Sequence[FloatArray],
        outcomes: Sequence[Outcome],
        monitor: Monitor,
        workers: Workers,
    ) -> tuple[Between, SearchSpace, list[Outcome], dict[str, float]]:
        """Return this, the space and the ends of searches as suits the record best, and the gains of holds.

        A wrong hold, or a step at the wrong time, looks like noise of the process, and asks for terms that stand for
        it: the search begins anew.

        Args:
            space: that was searched.
            begun: (mechanisms,) coefficients of each start.
            outcomes: the ends of the searches so far.
            monitor: told what goes on, and asked whether to stop.
            workers: where it is searched.
        """
        between, outcomes, gains = self, list(outcomes), dict[str, float]()
        for _ in range(ANEW if self.open or self.steps is not None else 0):
            best = min(outcomes, key=lambda o: o.rank, default=None)
            if best is None:
                break
            choice = choose_holds(space.with_constants(best.constants), best.fit, between.open, best.width)
            lean = None if self.steps is None else _without_thin(choice.space, choice.fit, best)
            stepping = between.stepping(choice.space, lean or choice.fit, choice.holds, best, begun)
            if stepping is None and choice.holds == holds_of(space):
                gains = {name: min(gain, gains.get(name, gain)) for name, gain in choice.gains.items()}
                break
            other, holds, found = (between, choice.holds, choice.fit) if stepping is None else stepping
            anew, ends = other.anew(space, holds, [found.theta, *begun], monitor, workers)
            if not ends or (stepping is not None and min(o.rank for o in ends) >= best.rank):
                break
            space.budget.spent += sum(o.spent for o in outcomes)
            between, space, outcomes, gains = other, anew, ends, choice.gains
        best = min(outcomes, key=lambda o: o.rank, default=None)
        if best is None:
            return between, space, outcomes, gains
        known = between.where_known(space.with_constants(best.constants), best.fit, anyway=best.clear)
        if known is not None:
            anew, ends = known.anew(space, holds_of(space), [best.fit.theta, *begun], monitor, workers)
            if ends:  # of other samples: what suited all of them does not compare
                space.budget.spent += sum(o.spent for o in outcomes)
                return known, anew, ends, gains
        if best.clear or not between.moved:
            return between, space, outcomes, gains
        # A beginning that lacks much may have asked for times that no law is found under.
        other = between.as_expected()
        anew, ends = other.anew(space, holds_of(space), begun, monitor, workers)
        if not ends or min(o.rank for o in ends) >= best.rank:
            return between, space, outcomes, gains
        space.budget.spent += sum(o.spent for o in outcomes)
        return other, anew, ends, gains

    def where_known(self, space: SearchSpace, found: Fit, anyway: bool = False) -> Between | None:
        """Return this without what was measured before late inputs were known; None where that does not matter.

        Args:
            space: of the model.
            found: the model.
            anyway: whether it matters though the model is near to all: terms may be there for it.
        """
        names = [c.name for c in self.signals.coordinates]
        delays = [float(found.theta[k]) for k in _delays(space, found)]
        records = measured_where_known(self.records, names, delays)
        if records is None:
            return None
        known = replace(self, records=records)
        whole, rest = (space.on(thinned(b.cut(holds_of(space), SEGMENT))) for b in (self, known))
        left = rest.segments.samples / whole.segments.samples
        if left == 1.0 or not (anyway or misses_the_unknown(whole, rest, found)):
            return None
        return replace(known, unknown=1.0 - left * (1.0 - self.unknown))

    def as_expected(self) -> Between:
        """Return this with every step as is expected."""
        return self if self.steps is None else replace(self, steps=self.steps.as_expected())

    def anew(
        self,
        space: SearchSpace,
        holds: Sequence[Hold],
        starts: Sequence[FloatArray],
        monitor: Monitor,
        workers: Workers,
    ) -> tuple[SearchSpace, list[Outcome]]:
        """Return the space under these holds, with steps when they come by now, and the ends of searches in it.

        Args:
            space: that was searched before.
            holds: of the inputs.
            starts: (mechanisms,) coefficients of each start.
            monitor: told what goes on, and asked whether to stop.
            workers: where it is searched.
        """
        there = with_fine_steps(space.on(thinned(self.cut(holds, SEGMENT))), starts)
        return there, searches(there, starts, None, monitor, workers)


def _timed(space: SearchSpace, theta: FloatArray, steps: Steps, width: float) -> tuple[Fit, Timed] | None:
    """Return a model in joined segments, and the same with times of steps that are best beside it; None where lost.

    Args:
        space: whose segments see the steps.
        theta: (mechanisms,) coefficients to begin with, no delays among them.
        steps: of the inputs.
        width: of the defects.
    """
    defect_std = space.segments.spread * width
    joined = space.begin(theta, defect_std)
    return None if joined is None else (joined, timed_fit(space, joined, steps, defect_std))


def _scale(space: SearchSpace, timed: Timed) -> float:
    """Return the residual variance over that of the noise, no less than 1."""
    return max(timed.cost / space.segments.samples, 1.0)


def _without_weak(space: SearchSpace, found: Fit, timed: Timed) -> FloatArray:
    """Return the coefficients of a model, zero for terms that are not worth their prices while times are open.

    Args:
        space: of the model.
        found: the model.
        timed: the same with times.
    """
    wald = timed.theta[found.free] ** 2 / np.maximum(timed.variances, 1e-300) / _scale(space, timed)
    weak = [k for k, w in zip(found.free.tolist(), wald.tolist(), strict=True) if w < space.penalty[k]]
    theta = found.theta.copy()
    theta[[k for k in weak if space.mechanisms[k].parts]] = 0.0
    return theta


def _at_once(space: SearchSpace, theta: FloatArray) -> FloatArray:
    """Return coefficients (mechanisms,) without delays, which steps that come early or late ask for."""
    prompt = theta.copy()
    prompt[[k for k, m in enumerate(space.mechanisms) if m.kind == "delay"]] = 0.0
    return prompt


def _delays(space: SearchSpace, found: Fit) -> list[int]:
    """Return the numbers of the delays that a model has."""
    return [k for k in found.present.tolist() if space.mechanisms[k].kind == "delay"]


def _without_thin(space: SearchSpace, found: Fit, best: Outcome) -> Fit | None:
    """Return a model without terms whose case is thin, fitted; None where there are none.

    Steps may have come to be when such a term has them.

    Args:
        space: of the model.
        found: the model.
        best: the end of the search that found it.
    """
    wald = found.wald / max(best.scale, 1.0)
    thin = [k for k, w in zip(found.free.tolist(), wald.tolist(), strict=True) if w < THIN * space.penalty[k]]
    thin = [k for k in thin if space.mechanisms[k].parts]
    if not thin:
        return None
    theta = found.theta.copy()
    theta[thin] = 0.0
    return space.fit(theta, np.setdiff1d(found.present, thin), found.x0, space.segments.spread * best.width)
