"""Steps of inputs between two samples: when each came, by what it does to the states around it.

A valve that is turned, a heater that switches, a pump that is set by hand: a log shows that the input is another from
one sample to the next, not when between them. docs/method.md, Inputs between samples.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.holds import DEAREST
from odescope.likelihood.sampled_inputs import with_steps
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments
from odescope.likelihood.timed_fit import ANYWHERE, Steps
from odescope.recordings.between_samples import steps_of
from odescope.recordings.clocks import times_by_clock
from odescope.recordings.coordinate import Hold, Input
from odescope.recordings.record import Records

REACH = 50  # samples to each side of a step that say when it came
NEEDED = 3  # samples on each side, at least
NEWTON = 3  # steps of the states at the begin of a window
WORTH = 0.4  # of what a model leaves beyond noise, at least, that times between samples explain
MOST = 500  # steps whose times are fitted to a joined record
TRIED = (0.0, 0.5, 1.0)  # samples before the one that shows the step

Cut = Callable[[Sequence[Hold], int], Segments]


@dataclass(frozen=True, eq=False)
class _SeenInWindows:
    """What windows around steps say: parabolas of their costs by the times of these, and costs as they are.

    Shapes: able (S,) which of all steps have a window, W of them, with so many samples in all; first, slope, bend (W,)
    of the parabolas, in samples before the one that shows the step; now (W,) at the times of now, linear (W,) with
    lines between samples.
    """

    able: BoolArray
    samples: int
    first: FloatArray
    slope: FloatArray
    bend: FloatArray
    now: FloatArray
    linear: FloatArray

    @property
    def fine(self) -> BoolArray:
        """Which windows did not run away, (W,)."""
        return np.isfinite(self.bend + self.now + self.linear)

    @property
    def best(self) -> FloatArray:
        """The most likely times (W,) of steps that may come anywhere between two samples."""
        bend, known = np.where(self.bend > 0.0, self.bend, 1.0), np.maximum(self.bend, 0.0)
        steep: FloatArray = np.where(self.slope + self.bend < 0.0, 1.0, 0.0)
        least = np.where(self.bend > 0.0, np.clip(-0.5 * self.slope / bend, 0.0, 1.0), steep)
        found: FloatArray = (ANYWHERE * 0.5 + known * least) / (ANYWHERE + known)
        return found

    def cost_at(self, early: FloatArray) -> FloatArray:
        """Return the costs (W,) at such times (W,)."""
        return self.first + early * (self.slope + early * self.bend)


@dataclass(frozen=True, eq=False)
class StepTimes:
    """Where inputs step, and when between the samples before and after.

    Shapes, for S steps: record, sample (S,) the last one before the step; inputs (S, i) which of them step there; early
    (S,) in samples before the next, where it is taken to step; clock (S,) the same as a clock makes it step, 0 where
    none does; expected (S,) that, or 0 where an input acts from sample to sample though a clock sets it; free (S,)
    whether it is of an input that may step at other times: what a controller sets does not, whatever else is set by
    hand.
    """

    record: IntArray
    sample: IntArray
    inputs: BoolArray
    early: FloatArray
    clock: FloatArray
    expected: FloatArray
    free: BoolArray

    @staticmethod
    def of(records: Records, inputs: Sequence[Input], open_: Collection[str]) -> StepTimes | None:
        """Return the steps of inputs, each at the sample that shows it or by its clock; None where there are none.

        Args:
            records: uniformly sampled.
            inputs: of these.
            open_: names of the inputs whose steps are looked for.
        """
        found = dict[tuple[int, int, float], BoolArray]()
        for r, run in enumerate(records):
            for j, name in enumerate(i.name for i in inputs):
                steps, early = _expected(run.column(name), run.sample_period) if name in open_ else ((), ())
                for at in zip(steps, early, strict=True):
                    found.setdefault((r, *at), np.zeros(len(inputs), dtype=np.bool_))[j] = True
        if not found:
            return None
        record, sample, clock = (np.array(column) for column in zip(*sorted(found), strict=True))
        stepping = np.array([found[key] for key in sorted(found)])
        free: BoolArray = ~np.any(stepping & stepping[clock > 0.0].any(axis=0), axis=1)
        return StepTimes(record, sample, stepping, clock, clock, clock, free)

    @property
    def stepping(self) -> BoolArray:
        """Which inputs step, (i,), but for those that step at samples alone."""
        return np.asarray(self.inputs[self.free | (self.expected > 0.0)].any(axis=0))

    @property
    def moved(self) -> bool:
        """Whether some step is taken to come at another time than is expected."""
        return not np.array_equal(self.early, self.expected)

    def by_clock(self, names: Sequence[str]) -> set[str]:
        """Return which inputs step by a clock between samples, by the names of all inputs."""
        there: BoolArray = np.any(self.inputs[self.expected > 0.0], axis=0)
        return {name for name, steps in zip(names, there.tolist(), strict=True) if steps}

    def placed(self, names: Sequence[str]) -> dict[str, int]:
        """Return how many steps of each input come before the sample that shows them, by the names of all inputs."""
        between = self.inputs & (self.early > 0.0)[:, None]
        counts: list[int] = np.count_nonzero(between, axis=0).tolist()
        return {name: count for name, count in zip(names, counts, strict=True) if count}

    def as_expected(self) -> StepTimes:
        """Return the same with every step at the sample that shows it, or by its clock."""
        return replace(self, early=self.expected)

    def anywhere(self) -> StepTimes:
        """Return the same in the middle between samples where nothing is known of when they come."""
        return replace(self, early=np.where(self.free, 0.5, self.expected))

    def on_samples(self, records: Records) -> FloatArray | None:
        """Return by how many samples inputs go on to their next ones early (M, i), None where all step at samples.

        Args:
            records: that the steps were found in, M samples.
        """
        if not self.early.any():
            return None
        begin = np.concatenate([[0], np.cumsum([len(run) for run in records])])
        found = np.zeros((begin[-1], self.inputs.shape[1]))
        steps, columns = np.nonzero(self.inputs)
        found[begin[self.record[steps]] + self.sample[steps], columns] = self.early[steps]
        return found

    @np.errstate(over="ignore", invalid="ignore")  # of windows that ran away
    def settled(self, cut: Cut, space: SearchSpace, found: Fit, holds: Sequence[Hold]) -> StepTimes | None:
        """Return the steps when they come by a model, None where the record does not ask for other times than these.

        Where it no longer asks for any, each comes as is expected.

        Around each step, from the one before it to the one after, the cost is a parabola of its time; what it leaves
        once the state is free is compared with that at these times and with lines between samples. Times that are
        anywhere between two samples have a price, the share of this that the record leaves; an input whose times are
        not worth theirs steps as is expected.

        Args:
            cut: cuts the data that the steps were found in.
            space: of the model.
            found: the model.
            holds: what every input does between samples by now.
        """
        seen = self._seen_in_windows(cut, space, found, holds)
        if seen is None:
            return None
        fine, known, early = seen.fine, np.maximum(seen.bend, 0.0), seen.best
        expected, left = self.expected[seen.able], seen.cost_at(early)
        freedom = max(seen.samples - found.x0.shape[1] * len(early), 1)
        scale = max(float(left[fine].sum()) / freedom, 1.0)
        dear = price_of_times(known, scale)
        if (otherwise := self._otherwise(seen, scale)) is not None:
            return otherwise

        def beyond_chance(before: FloatArray, among: BoolArray = fine) -> float:
            """Return what these times are worth where none were, less what few of them say, which may be by chance."""
            worth = np.sort(((before - left) / scale - dear)[among])
            return float(worth[: -1 - len(worth) // 10].sum())

        as_expected, stepping = seen.cost_at(expected), self.inputs[seen.able]
        moving = np.array([beyond_chance(as_expected, fine & own) > 0.0 for own in stepping.T])
        free = (stepping & (moving if moving.any() else ~moving)).any(axis=1)
        early, left = np.where(free, early, expected), np.where(free, left, as_expected)
        dear = np.where(free, dear, 0.0)
        placed = self.moved
        if placed and beyond_chance(as_expected) < DEAREST:  # a model that lacked something had asked for them
            return self.as_expected()
        now = seen.now
        without = seen.linear if seen.linear[fine].sum() < now[fine].sum() else now
        if not placed and float((without - left)[fine].sum()) < WORTH * (float(left[fine].sum()) - freedom):
            return None  # a model that leaves far more than they explain lacks something else, such as a delay
        if (float((now - left)[fine].sum()) / scale if placed else beyond_chance(without)) < DEAREST:
            return None
        times, some = self.early.copy(), (self.inputs & moving).any(axis=1)
        times[np.flatnonzero(seen.able)[fine]] = early[fine]
        return replace(self, early=np.where(some, times, self.expected), free=some)

    def _otherwise(self, seen: _SeenInWindows, scale: float) -> StepTimes | None:
        """Return the same with inputs at samples instead of by their clocks, or by these again; None for no need.

        Args:
            seen: what windows around the steps say.
            scale: residual variance over the noise variance.
        """
        other = np.where(self.expected > 0.0, 0.0, self.clock)
        gains = (seen.cost_at(self.expected[seen.able]) - seen.cost_at(other[seen.able])) / scale
        suits = [float(gains[seen.fine & own].sum()) > DEAREST for own in self.inputs[seen.able].T]
        turned = np.any(self.inputs & np.array(suits), axis=1)
        if not turned.any():
            return None
        expected = np.where(turned, other, self.expected)
        free = np.where(turned, bool(self.expected[turned].any()), self.free)
        return replace(self, early=expected, expected=expected, free=free)

    def seen(self, records: Records, names: Sequence[str], space: SearchSpace) -> tuple[Steps, IntArray] | None:
        """Return the steps that the segments of a space see, and which of all these are.

        None where it sees none, or so many that their times would take longer than a search.

        Args:
            records: that the steps were found in.
            names: of all inputs.
            space: whose segments have the steps at these times.
        """
        runs, rise = np.array(space.segments.runs)[self.record], np.zeros(self.inputs.shape)
        for s, (r, k) in enumerate(zip(self.record.tolist(), self.sample.tolist(), strict=True)):
            run = records.runs[r]
            columns = [run.names.index(n) for n in names]
            rise[s] = np.where(self.inputs[s], run.values[k + 1, columns] - run.values[k, columns], 0.0)
        there = np.flatnonzero(self.free & (runs[:, 0] + self.sample < runs[:, 1] - 1))
        steps, among = Steps.of(space, runs[there, 0] + self.sample[there], rise[there], self.early[there])
        return (steps, there[among]) if 0 < len(among) <= MOST else None

    def _seen_in_windows(
        self, cut: Cut, space: SearchSpace, found: Fit, holds: Sequence[Hold]
    ) -> _SeenInWindows | None:
        """Return what windows around the steps say of when these come; None where none has samples enough.

        Args:
            cut: cuts the data that the steps were found in.
            space: of the model.
            found: the model.
            holds: what every input does between samples by now.
        """
        ever: BoolArray = np.any(self.inputs, axis=0)
        held = tuple("zero" if steps else h for h, steps in zip(holds, ever.tolist(), strict=True))
        segments, lines = cut(held, REACH), tuple("linear" if h == "zero" else h for h in held)
        able, at, windows = self._windows(segments, found.x0.shape[1])
        if not able.any():
            return None
        rise = np.where(self.inputs[able], segments.inputs[at + 1, 0] - segments.inputs[at, 0], 0.0)

        def costs(early: FloatArray) -> FloatArray:
            inputs, cuts = with_steps(segments.inputs, None, at, rise, early)
            return _costs(space, found, replace(windows, inputs=inputs, cuts=cuts))

        first, half, last = (costs(np.full(len(at), early)) for early in TRIED)
        return _SeenInWindows(
            able=able,
            samples=int(windows.counted.sum()),
            first=first,
            slope=4.0 * half - 3.0 * first - last,
            bend=2.0 * (first - 2.0 * half + last),
            now=costs(self.early[able]),
            linear=_costs(space, found, replace(windows, inputs=segments.held(lines).inputs)),
        )

    def _windows(self, segments: Segments, states: int) -> tuple[BoolArray, IntArray, Segments]:
        """Return which steps have samples enough around them (S,), the averages before these, and their windows."""
        runs, same = np.array(segments.runs)[self.record], np.diff(self.record) == 0
        at: IntArray = runs[:, 0] + self.sample
        low, high = np.maximum(runs[:, 0], at - REACH + 1), np.minimum(runs[:, 1] - 1, at + REACH)
        low[1:] = np.where(same, np.maximum(low[1:], at[:-1] + 1), low[1:])
        high[:-1] = np.where(same, np.minimum(high[:-1], at[1:]), high[:-1])
        able: BoolArray = np.greater_equal(np.minimum(at - low + 1, high - at), max(NEEDED, states))
        start, count = low[able], (high - low + 1)[able]
        return able, at[able], replace(segments, start=start, count=count, joined=np.zeros(len(start), np.bool_))


def _expected(samples: FloatArray, period: float) -> tuple[list[int], list[float]]:
    """Return the samples before the steps of an input (N,), and by how much each comes early as is expected.

    A clock tells of all changes when they came, however small; where it does not, those count that are steps.
    """
    steps = steps_of(samples)
    if not len(steps):
        return [], []
    for there in (np.flatnonzero(np.diff(samples)), steps):
        times = times_by_clock(there, period)
        if times is not None:
            return there.tolist(), (there + 1.0 - times).tolist()
    return steps.tolist(), [0.0] * len(steps)


def price_of_times(known: FloatArray, scale: float) -> FloatArray:
    """Return what times have to earn (S,), that may be anywhere between two samples.

    Args:
        known: (S,) what the record says of each, 1 / variance.
        scale: residual variance over the noise variance.
    """
    price: FloatArray = np.log1p(known / (2.0 * np.pi * scale))
    return price


@np.errstate(over="ignore", invalid="ignore")  # of windows that ran away
def _costs(space: SearchSpace, found: Fit, windows: Segments) -> FloatArray:
    """Return the cost of every window (S,) at the state that is best for it, as far as a few steps of Newton reach."""
    there, program, theta = space.on(windows).evaluator, space.program(found.present), found.theta[found.present]
    none, x0 = np.zeros(0, dtype=np.int64), windows.initial
    best = np.full(len(x0), np.inf)
    for _ in range(NEWTON + 1):
        sums = there.integrate(program, theta, none, x0)
        best = np.fmin(best, sums.cost)
        fine = np.isfinite(sums.hessian.sum(axis=(1, 2)) + sums.gradient.sum(axis=1))
        hessian = np.where(fine[:, None, None], sums.hessian, np.eye(x0.shape[1]))
        size = np.sqrt(np.maximum(np.einsum("jii->ji", hessian), 1e-300))
        scaled = hessian / size[:, :, None] / size[:, None] + 1e-12 * np.eye(x0.shape[1])
        step = np.linalg.solve(scaled, (sums.gradient / size)[:, :, None])[:, :, 0] / size
        x0 = x0 - np.where(fine[:, None], step, 0.0)
    return best
