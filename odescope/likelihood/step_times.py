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
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments
from odescope.likelihood.timed_fit import ANYWHERE, Steps
from odescope.recordings.between_samples import steps_of
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
class StepTimes:
    """Where inputs step, and when between the samples before and after.

    Shapes, for S steps: record, sample (S,) the last one before the step; inputs (S, i) which of them step there; early
    (S,) in samples before the next, where it is taken to step.
    """

    record: IntArray
    sample: IntArray
    inputs: BoolArray
    early: FloatArray

    @staticmethod
    def of(records: Records, inputs: Sequence[Input], open_: Collection[str]) -> StepTimes | None:
        """Return the steps of inputs, each at the sample that shows it; None where there are none.

        Args:
            records: uniformly sampled.
            inputs: of these.
            open_: names of the inputs whose steps are looked for.
        """
        names = [i.name for i in inputs]
        found = list[tuple[int, int, BoolArray]]()
        for r, run in enumerate(records):
            there = np.zeros((len(run), len(names)), dtype=np.bool_)
            for j, name in enumerate(names):
                if name in open_:
                    there[steps_of(run.column(name)), j] = True
            found += [(r, k, there[k]) for k in np.flatnonzero(there.any(axis=1)).tolist()]
        if not found:
            return None
        record, sample, inputs = zip(*found, strict=True)
        return StepTimes(np.array(record), np.array(sample), np.array(inputs), np.zeros(len(found)))

    @property
    def stepping(self) -> BoolArray:
        """Which inputs step at all, (i,)."""
        return np.asarray(self.inputs.any(axis=0))

    def placed(self, names: Sequence[str]) -> dict[str, int]:
        """Return how many steps of each input come before the sample that shows them, by the names of all inputs."""
        between = self.inputs & (self.early > 0.0)[:, None]
        counts: list[int] = np.count_nonzero(between, axis=0).tolist()
        return {name: count for name, count in zip(names, counts, strict=True) if count}

    def anywhere(self) -> StepTimes:
        """Return the same in the middle between samples: nothing is known of when they come."""
        return replace(self, early=np.full(len(self.early), 0.5))

    def retimed(self, records: Records, names: Sequence[str]) -> Records:
        """Return records whose inputs, held from sample to sample, have the right means between them.

        Args:
            records: that the steps were found in.
            names: of all inputs.
        """
        if not self.early.any():
            return records
        runs = []
        for r, run in enumerate(records):
            values = run.values.copy()
            for s in np.flatnonzero(self.record == r):
                k = int(self.sample[s])
                columns = [run.names.index(n) for n, steps in zip(names, self.inputs[s], strict=True) if steps]
                values[k, columns] += self.early[s] * (run.values[k + 1, columns] - run.values[k, columns])
            runs.append(replace(run, values=values))
        return Records(tuple(runs))

    @np.errstate(over="ignore", invalid="ignore")  # of windows that ran away
    def settled(self, cut: Cut, space: SearchSpace, found: Fit, holds: Sequence[Hold]) -> StepTimes | None:
        """Return the steps when they come by a model, None where the record does not ask for other times than these.

        Where it no longer asks for any, each comes at the sample that shows it.

        Around each step, from the one before it to the one after, the cost is a parabola of its time; what it leaves
        once the state is free is compared with that at these times and with lines between samples. Times that are
        anywhere between two samples have a price, the share of this that the record leaves.

        Args:
            cut: cuts the data that the steps were found in.
            space: of the model.
            found: the model.
            holds: what every input does between samples by now.
        """
        held = tuple("zero" if steps else h for h, steps in zip(holds, self.stepping.tolist(), strict=True))
        segments, lines = cut(held, REACH), tuple("linear" if h == "zero" else h for h in held)
        able, at, windows = self._windows(segments, found.x0.shape[1])
        if not able.any():
            return None
        stepping, rise = self.inputs[able], segments.inputs[at + 1, 0] - segments.inputs[at, 0]
        nodes = list[FloatArray]()
        for early in (*TRIED, self.early[able][:, None]):
            nodes.append(segments.inputs.copy())
            nodes[-1][at] += (np.where(stepping, early * rise, 0.0))[:, None]
        nodes.append(segments.held(lines).inputs)
        first, half, last, now, linear = (_costs(space, found, replace(windows, inputs=u)) for u in nodes)
        bend, slope = 2.0 * (first - 2.0 * half + last), 4.0 * half - 3.0 * first - last
        fine, known = np.isfinite(bend + now + linear), np.maximum(bend, 0.0)
        least = np.where(bend > 0.0, np.clip(-0.5 * slope / np.where(bend > 0.0, bend, 1.0), 0.0, 1.0), last < first)
        early = (ANYWHERE * 0.5 + known * least) / (ANYWHERE + known)
        left = first + early * (slope + early * bend)
        freedom = max(int(windows.counted.sum()) - found.x0.shape[1] * len(at), 1)
        scale = max(float(left[fine].sum()) / freedom, 1.0)
        dear = price_of_times(known, scale)

        def beyond_chance(before: FloatArray) -> float:
            """Return what these times are worth where none were, less what few of them say, which may be by chance."""
            worth = np.sort(((before - left) / scale - dear)[fine])
            return float(worth[: -1 - len(worth) // 10].sum())

        placed = bool(self.early.any())
        if placed and beyond_chance(first) < DEAREST:  # a model that lacked something had asked for them
            return replace(self, early=np.zeros(len(self.early)))
        without = linear if linear[fine].sum() < now[fine].sum() else now
        if not placed and float((without - left)[fine].sum()) < WORTH * (float(left[fine].sum()) - freedom):
            return None  # a model that leaves far more than they explain lacks something else, such as a delay
        if (float((now - left)[fine].sum()) / scale if placed else beyond_chance(without)) < DEAREST:
            return None
        times = self.early.copy()
        times[np.flatnonzero(able)[fine]] = early[fine]
        return replace(self, early=times)

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
        there = np.flatnonzero(runs[:, 0] + self.sample < runs[:, 1] - 1)
        steps, among = Steps.of(space, runs[there, 0] + self.sample[there], rise[there], self.early[there])
        return (steps, there[among]) if 0 < len(among) <= MOST else None

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
