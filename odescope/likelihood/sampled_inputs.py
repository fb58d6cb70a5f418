"""The inputs on the nodes of integration steps, however late they act."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.parallel.kernels import kernel
from odescope.recordings.between_samples import FINER, laid_out
from odescope.recordings.coordinate import Hold, Input
from odescope.recordings.record import Records

DIFFERENCE = 0.02  # samples: of the difference quotient that says how an input changes with its delay
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, eq=False)
class SampledInputs:
    """The inputs of all records end to end, from which those of every step follow, however late they act.

    Shapes: samples (M, i) as they act without more delay; holds (i,) names; at (N,) the sample at every average, first
    and last (N,) those of its record; block samples a step, of `period` seconds each; early (M, i) by how many samples
    before the next one a held input that is sampled once a step goes on to it, None for none.
    """

    samples: FloatArray
    holds: tuple[Hold, ...]
    at: IntArray
    first: IntArray
    last: IntArray
    block: int
    period: float
    early: FloatArray | None = None

    def nodes(self, late: Sequence[float]) -> FloatArray:
        """Return the inputs (N, 3, i) at begin, middle and end of the step after each average, so many samples late.

        The nodes are those of the parabola that is nearest to the input over the step: smooth inputs keep their values,
        and of rough or switching ones RK4's Simpson rule sees the right mean. Of inputs that step at `cuts` they are
        what is before, NaN, and what is after.
        """
        return self._found(late, [0.0], np.ones((1, 1)))

    def nodes_and_gain(self, late: Sequence[float]) -> FloatArray:
        """Return the `nodes`, and after them what they gain with a second more (N, 3, 2 i)."""
        quotient = 0.5 / (DIFFERENCE * self.period)
        return self._found(
            late, [0.0, DIFFERENCE, -DIFFERENCE], np.array([[1.0, 0.0, 0.0], [0.0, quotient, -quotient]])
        )

    def _found(self, late: Sequence[float], besides: Sequence[float], shares: FloatArray) -> FloatArray:
        """Return sums (N, 3, r i) of the `nodes` at delays that differ by `besides` (b,), each by its shares (r, b).

        The samples around each step are gathered once.
        """
        sums = np.empty((len(self.at), 3, len(shares), len(self.holds)))
        stepping = self._steps(late)[0]
        for j, (hold, samples) in enumerate(zip(self.holds, self._within(late), strict=True)):
            if j in stepping:
                sums[:, :, 0, j] = stepping[j]
                sums[:, :, 1:, j] = ((stepping[j][:, 0] - stepping[j][:, 2]) / self.period)[:, None, None]
                continue
            finer = FINER if hold == "band-limited" else 1
            column = self._laid_out[j] if hold == "band-limited" else np.ascontiguousarray(self.samples[:, j])
            block, shifts = finer * self.block, [finer * (samples + more) for more in besides]
            wholes = [int(np.floor(shift)) for shift in shifts]
            last, width = max(wholes), block + 2 + max(wholes) - min(wholes)
            weights = np.zeros((len(besides), 3, width))
            for k, (shift, whole) in enumerate(zip(shifts, wholes, strict=True)):
                weights[k, :, last - whole : last - whole + block + 2] = _parabola(block, hold == "zero", shift - whole)
            summed = np.tensordot(shares, weights, axes=1)
            begin, whole = finer * self.at - last - 1, shares.sum(axis=1)
            _weigh(column, begin, finer * self.first, finer * self.last, summed, whole, sums[..., j])
        return sums.reshape(len(self.at), 3, -1)

    def cuts(self, late: Sequence[float]) -> FloatArray | None:
        """Return at which share of each step (N,) held inputs go on to their next samples, 1 where none does.

        The middle of their `nodes` is NaN there. None where no input steps between samples at all.
        """
        return self._steps(late)[1]

    def _within(self, late: Sequence[float]) -> list[float]:
        """Return delays (i,) no longer than twice the records, as a fit that goes astray may ask for."""
        longest = 2.0 * len(self.samples)
        found: list[float] = np.clip(late, -longest, longest).tolist()
        return found

    def _steps(self, late: Sequence[float]) -> tuple[dict[int, FloatArray], FloatArray | None]:
        """Return the nodes (N, 3) of those held inputs that step between samples, by their numbers, and the `cuts`.

        One that steps within a step of the integration in which another one has stepped elsewhere has its mean there.
        """
        found, cuts = dict[int, FloatArray](), np.ones(len(self.at))
        for j, samples in enumerate(self._within(late)):
            if self.early is None or self.holds[j] != "zero" or not self.early[:, j].any():
                continue
            whole, nodes, own = int(np.floor(samples)), np.empty((len(self.at), 3)), np.empty(len(self.at))
            column, early = np.ascontiguousarray(self.samples[:, j]), np.ascontiguousarray(self.early[:, j])
            _step(column, early, self.at - whole, self.first, self.last, samples - whole, nodes, own)
            twice = (own < 1.0) & (cuts < 1.0) & (own != cuts)
            nodes[twice] = (nodes[:, 2] + own * (nodes[:, 0] - nodes[:, 2]))[twice, None]
            found[j], cuts = nodes, np.where(twice, cuts, np.minimum(own, cuts))
        return found, cuts if found else None

    @cached_property
    def _laid_out(self) -> dict[int, FloatArray]:
        """The band-limited inputs (FINER M,) on a grid on which they run linearly, by their numbers."""
        found = {j: np.empty(FINER * len(self.samples)) for j, hold in enumerate(self.holds) if hold == "band-limited"}
        for first, last in zip(np.unique(self.first), np.unique(self.last), strict=True):
            for j, column in found.items():
                column[FINER * first : FINER * (last + 1)] = laid_out(self.samples[first : last + 1, j])
        return found


@kernel()
def _weigh(
    column: FloatArray,
    begin: IntArray,
    first: IntArray,
    last: IntArray,
    weights: FloatArray,
    whole: FloatArray,
    sums: FloatArray,
) -> None:
    """Write weighted sums (N, 3, r) of the samples from each begin on; beyond its ends a record stays as it is there.

    What differs from the first of them is weighed: of an input that stays, rounding leaves no gain.

    Args:
        column: samples of all records.
        begin: (N,) the first sample of each sum.
        first: (N,) first sample of its record.
        last: (N,) last sample of its record.
        weights: (r, 3, width) of the samples.
        whole: (r,) sum of the weights at each node.
        sums: written.
    """
    for k in range(len(begin)):
        base = column[min(max(begin[k], first[k]), last[k])]
        for r in range(weights.shape[0]):
            for node in range(weights.shape[1]):
                total = whole[r] * base
                for m in range(1, weights.shape[2]):
                    total += weights[r, node, m] * (column[min(max(begin[k] + m, first[k]), last[k])] - base)
                sums[k, node, r] = total


def with_steps(
    inputs: FloatArray, cuts: FloatArray | None, at: IntArray, rise: FloatArray, early: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return nodes (N, 3, i) and `cuts` (N,) with inputs that step so many samples before the next one.

    Args:
        inputs: nodes, with whatever steps there are.
        cuts: theirs, None where there are none.
        at: (S,) the averages that steps are after.
        rise: (S, i) by what each input steps.
        early: (S,) when, in samples before the next.
    """
    inputs, cuts = inputs.copy(), np.ones(len(inputs)) if cuts is None else cuts.copy()
    moving, row = rise != 0.0, inputs[at]
    row[:, 1] = np.where(moving, np.nan, row[:, 1])
    row[:, 2] = np.where(moving, row[:, 0] + rise, row[:, 2])
    inputs[at], cuts[at] = row, 1.0 - early
    return inputs, cuts


@kernel()
def _step(
    column: FloatArray,
    early: FloatArray,
    at: IntArray,
    first: IntArray,
    last: IntArray,
    fraction: float,
    nodes: FloatArray,
    cuts: FloatArray,
) -> None:
    """Write the nodes (N, 3) of a held input that goes on to its next sample early, and where it does (N,), 1 for not.

    Args:
        column: samples of all records.
        early: of all samples, by how many each goes on to the next one.
        at: (N,) the sample that begins in each step.
        first: (N,) first sample of its record.
        last: (N,) last sample of its record.
        fraction: of a step after its begin, at which the sample begins.
        nodes: written.
        cuts: written.
    """
    for k in range(len(at)):
        before = column[min(max(at[k] - 1, first[k]), last[k])]
        now = column[min(max(at[k], first[k]), last[k])]
        after = column[min(max(at[k] + 1, first[k]), last[k])]
        sooner = early[at[k] - 1] if first[k] < at[k] <= last[k] else 0.0
        soon = early[at[k]] if first[k] <= at[k] < last[k] else 0.0
        nodes[k, :], cuts[k] = now, 1.0
        if sooner < fraction and before != now:
            nodes[k, 0], nodes[k, 1], cuts[k] = before, np.nan, fraction - sooner
        elif soon > fraction and now != after:
            nodes[k, 1], nodes[k, 2], cuts[k] = np.nan, after, 1.0 + fraction - soon


def sampled_inputs(
    records: Records,
    inputs: Sequence[Input],
    centres: Sequence[IntArray],
    block: int,
    early: FloatArray | None = None,
) -> SampledInputs:
    """Return the inputs of records for the steps of the likelihood.

    Args:
        records: M samples in all, every recording at the same sample period.
        inputs: which columns they are, and how each runs between samples.
        centres: of every recording, the sample at the centre of each of its averages, counted from its own first.
        block: samples a step.
        early: (M, i) as of `SampledInputs`.
    """
    begin = np.concatenate([[0], np.cumsum([len(run) for run in records])])
    names = [i.name for i in inputs]
    samples = [np.column_stack([run.column(n) for n in names]) if names else np.empty((len(run), 0)) for run in records]
    kept = [len(c) for c in centres]
    return SampledInputs(
        samples=np.concatenate(samples),
        holds=tuple(i.hold for i in inputs),
        at=np.concatenate([b + c for b, c in zip(begin, centres, strict=False)]),
        first=np.repeat(begin[:-1], kept),
        last=np.repeat(begin[1:] - 1, kept),
        block=block,
        period=records.runs[0].sample_period,
        early=early if block == 1 else None,
    )


@kernel()
def _parabola(block: int, held: bool, fraction: float) -> FloatArray:
    """Return the weights (3, block + 2) of samples in the nodes of the nearest parabola over a step of `block`.

    Between samples the input is held, or else linear. The first sample is the one before the step begins, if the input
    acts a `fraction` of a sample late.
    """
    moments = np.zeros((3, block + 2))  # of Legendre's polynomials
    for k in range(2 * block):  # pieces between samples and their late copies; on time, every second is empty
        sample, after = divmod(k, 2)
        low, high = (sample + fraction, sample + 1.0) if after else (float(sample), sample + fraction)
        below = sample + after
        for point in range(len(POINTS)):
            at = low + 0.5 * (POINTS[point] + 1.0) * (high - low)  # in samples since the step began
            s, share = 2.0 * at / block - 1.0, 0.5 * (high - low) / block * WEIGHTS[point]
            rise = 0.0 if held else at - fraction - (below - 1)
            for row, value in enumerate((1.0, 3.0 * s, 5.0 * (1.5 * s**2 - 0.5))):
                moments[row, below] += share * value * (1.0 - rise)
                moments[row, below + 1] += share * value * rise
    nodes = np.empty_like(moments)
    nodes[0] = moments[0] - moments[1] + moments[2]
    nodes[1] = moments[0] - 0.5 * moments[2]
    nodes[2] = moments[0] + moments[1] + moments[2]
    return nodes
