"""What the likelihood sees: block averages of the measured coordinates, cut into short segments.

The signal ends at the cutoff, the noise does not: averages over blocks of k samples with a Nyquist frequency of several
times the cutoff carry the same information. What averaging does to the signal itself is taken out
with the filtered signal, whose own error does not matter there. An average of fewer samples, or more, weighs less, or
more; one without any weighs nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.likelihood.sampled_inputs import SampledInputs, sampled_inputs
from odescope.recordings.coordinate import Hold
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Differentiator, derivatives_like
from odescope.signals.estimate import DENSE, Signals
from odescope.signals.filling import BANDS
from odescope.signals.noise import noise_levels
from odescope.signals.relative_noise import noise_of_recordings, relative_noise
from odescope.signals.spectral import Spectrum

OVERSAMPLING = 8  # block averages a period of the highest cutoff
FEWEST = 4  # the same where a sensor's filter asks for longer averages
SEGMENT = 25  # block averages a segment
SHORT = 6  # block averages of a segment in which a model that lacks most is not lost
LEAST_SEGMENT = 4
FEW = 50  # averages in all: of fewer the residual variance, by which a model is judged, scatters by more than a fifth
SINGLE = 1000  # samples of a log, at most, that is not averaged where noise grows: each has a weight of its own
LARGEST = 60_000  # averages in all: of longer logs the likelihood takes the first part of every record, to bound memory


@dataclass(frozen=True, eq=False)
class Segments:
    """Block averages of all records end to end, and the segments they are cut into.

    Shapes: measured (N, c) averages; inputs (N, 3, i) on the nodes of the step that begins at each average; filtered
    (N, n) smoothed states; start, count (J,); joined (J,) whether a segment ends where the next begins; noise (c,) the
    standard deviation of an average, spread (n,) that of the smoothing error of each state; step in
    seconds; runs the first average of every record and the one after its last; weight (N, c) by what 1 / noise of an
    average is multiplied, 0 where nothing was measured, None for 1 throughout; driven the samples that inputs follow
    from, None where none can be late; share (N, c) that of `weight` which follows from the number of samples alone, the
    rest from noise that grows with the readings or differs between recordings; steady the channels whose noise cannot
    grow; floor (c,) what it is at least, None for nothing; decorrelation (n, n), unit lower triangular, makes
    independent parts of the defects between segments, None where they are independent; cuts (N,) at which share of
    each step inputs go on to their next samples, None where none does but at a sample.
    """

    measured: FloatArray
    inputs: FloatArray
    filtered: FloatArray
    start: IntArray
    count: IntArray
    joined: BoolArray
    noise: FloatArray
    spread: FloatArray
    step: float
    block: int
    runs: tuple[tuple[int, int], ...]
    weight: FloatArray | None = None
    driven: SampledInputs | None = None
    share: FloatArray | None = None
    steady: tuple[int, ...] = ()
    floor: FloatArray | None = None
    decorrelation: FloatArray | None = None
    cuts: FloatArray | None = None

    @cached_property
    def counted(self) -> IntArray:
        """Number of averages of every channel that the segments see, (c,)."""
        channels = len(self.noise)
        if self.weight is None:
            return np.full(channels, int(self.count.sum()))
        there = np.concatenate([np.zeros((1, channels), dtype=np.int64), np.cumsum(self.weight > 0.0, axis=0)])
        counted: IntArray = (there[self.start + self.count] - there[self.start]).sum(axis=0)
        return counted

    @property
    def log_noise(self) -> float:
        """-2 ln of what the density of the averages has before its exponential, but for a constant."""
        total = float(2.0 * np.sum(self.counted * np.log(self.noise)))
        if self.weight is None:
            return total
        kept = [self.weight[s : s + n] for s, n in zip(self.start, self.count, strict=True)]
        return total - 2.0 * sum(float(np.log(w[w > 0.0]).sum()) for w in kept)

    @property
    def samples(self) -> int:
        """Number of averages that the segments see, over all channels."""
        return int(self.counted.sum())

    def late(self, delays: Sequence[float]) -> tuple[FloatArray, FloatArray | None]:
        """Return the inputs (N, 3, 2 i) so many seconds late, after them what they gain with a second more, and `cuts`.

        Raises:
            ValueError: the segments were made without the samples of their inputs.
        """
        if self.driven is None:
            raise ValueError("segments without the samples of their inputs cannot tell what these are later")
        samples = (np.array(delays) / self.driven.period).tolist()
        return self.driven.nodes_and_gain(samples), self.driven.cuts(samples)

    @property
    def initial(self) -> FloatArray:
        """Smoothed states at the first average of every segment, (J, n)."""
        return self.filtered[self.start]

    def held(self, holds: Sequence[Hold]) -> Segments:
        """Return the same averages, with inputs that run so between samples.

        Raises:
            ValueError: the segments were made without the samples of their inputs.
        """
        if self.driven is None:
            raise ValueError("segments without the samples of their inputs cannot hold them otherwise")
        driven = replace(self.driven, holds=tuple(holds))
        late = [0.0] * len(holds)
        return replace(self, driven=driven, inputs=driven.nodes(late), cuts=driven.cuts(late))

    def cut_anew(self, length: int) -> Segments:
        """Return the same averages in segments of about so many."""
        start, count, joined = _cut(self.runs, length, self.weight)
        return replace(self, start=start, count=count, joined=joined)


def cut_segments(
    records: Records,
    signals: Signals,
    differentiator: Differentiator,
    length: int = SEGMENT,
    early: FloatArray | None = None,
) -> Segments:
    """Return the segments of uniformly sampled records.

    Args:
        records: what was measured.
        signals: coordinates, inputs, and the noise and cutoff that were found in the records.
        differentiator: that found them; it gives the smoothed states.
        length: averages a segment.
        early: (M, i) by how many samples held inputs go on to their next ones early, None for none.
    """
    period, block = records.runs[0].sample_period, _block(records, signals, records.runs[0].sample_period)
    seen = _seen(records, signals, differentiator, block)
    deviations = _deviations(seen, records, signals, period, block)
    if block > 1 and records.samples <= SINGLE and any(d is not None for d in deviations):
        block, seen = 1, _seen(records, signals, differentiator, 1)
        deviations = _deviations(seen, records, signals, period, block)
    y, share, smooth, runs = seen.measured, seen.share, seen.filtered, seen.runs
    noise = _noise(signals, y)
    largest, weights = noise.copy(), share.copy()
    for k, own in enumerate(deviations):
        if own is not None:
            there = share[:, k] > 0.0
            level = float(np.sqrt(np.mean(own[there] ** 2)))
            largest[k] = noise[k] * own[there].max()
            noise[k] *= level
            weights[there, k] *= level / own[there]
    unequal = None if np.all(weights == 1.0) else weights
    start, count, joined = _cut(runs, length, unequal)
    driven = sampled_inputs(records, signals.inputs, seen.centres, block, early)
    return Segments(
        measured=y,
        inputs=driven.nodes([0.0] * len(driven.holds)),
        filtered=smooth,
        start=start,
        count=count,
        joined=joined,
        noise=noise / np.sqrt(block),
        spread=_smoothing_error(signals, largest, period),
        step=block * period,
        block=block,
        runs=runs,
        weight=unequal,
        share=share,
        steady=_steady(signals),
        floor=np.array([c.floor for c in signals.channels]) / np.sqrt(block),
        driven=driven,
        cuts=driven.cuts([0.0] * len(driven.holds)),
    )


class _Seen(NamedTuple):
    """What `_averages` gives of all records, end to end, and the first average of every record and the one after."""

    measured: FloatArray
    share: FloatArray
    centres: tuple[IntArray, ...]
    filtered: FloatArray
    runs: tuple[tuple[int, int], ...]


def _seen(records: Records, signals: Signals, differentiator: Differentiator, block: int) -> _Seen:
    """Return the averages of records over so many samples, of a log that is too long those of the first parts."""
    period, total = records.runs[0].sample_period, 0
    share = min(1.0, LARGEST * block / sum(len(r) for r in records))
    parts, runs = [], list[tuple[int, int]]()
    for run in records:
        found = _averages(run, signals, differentiator, period, block)
        kept = max(round(share * len(found[0])), min(len(found[0]), LEAST_SEGMENT))
        parts.append([values[:kept] for values in found])
        runs.append((total, total + len(parts[-1][0])))
        total = runs[-1][1]
    y, w, centres, x = zip(*parts, strict=True)
    return _Seen(np.concatenate(y), np.concatenate(w), centres, np.concatenate(x), tuple(runs))


def _noise(signals: Signals, measured: FloatArray) -> FloatArray:
    """Return the standard deviation of a sample of every channel, no less than the digits of the averages (N, c)."""
    return np.array([max(c.noise, 1e-12 * float(np.ptp(measured[:, k]))) for k, c in enumerate(signals.channels)])


def _deviations(seen: _Seen, records: Records, signals: Signals, period: float, block: int) -> list[FloatArray | None]:
    """Return for every channel how noisy its averages (N,) are, in units of the noise that they seemed to have.

    None where that is the same for all: noise neither grows with the readings nor differs between recordings. Spectra
    tell the noise of a recording, but what grows with its readings, too, only once that is divided out. What is filled
    in between few samples is smoother than what was measured, and says nothing of their noise.

    Args:
        seen: the averages.
        records: that they are of.
        signals: coordinates and their noise.
        period: of the samples, in seconds.
        block: samples an average.
    """
    noise, found = _noise(signals, seen.measured), list[FloatArray | None]()
    error, steady = _smoothing_error(signals, noise, period), _steady(signals)
    for k, c in enumerate(signals.coordinates):
        row, share = signals.states.index(c.name), seen.share[:, k]
        smooth, there = seen.filtered[:, row], share > 0.0
        rest = share * (seen.measured[:, k] - smooth)
        below = signals.channels[k].cutoff * period * len(share) / max(float(np.sum(share**2)), 1e-300)
        # Only where half of the band of what was measured is above the cutoff is what the filter leaves noise for sure.
        grows = None
        if BANDS * below < 1.0 and k not in steady:
            grows = relative_noise(rest, smooth, there, float(error[row]))
        by = None if grows is None else grows.level * grows.deviations
        least = signals.channels[k].floor / noise[k]
        if len(seen.runs) < 2 or any(np.mean(share[low:high] ** 2) < DENSE for low, high in seen.runs):
            found.append(by)
        elif by is None:
            levels = noise_levels([Spectrum.of(run.column(c.name)) for run in records]) / noise[k]
            own = np.repeat(np.maximum(levels, least), [high - low for low, high in seen.runs])
            found.append(own if np.ptp(own) else None)
        else:
            told = 1.0 - 2.0 * below * block
            differs = noise_of_recordings(rest / by * np.sqrt(block) / noise[k], there, seen.runs, told, least)
            found.append(by if differs is None else by * differs)
    return found


def _steady(signals: Signals) -> tuple[int, ...]:
    """Return the channels whose noise cannot grow with their readings: angles, and what a solver or a step leaves."""
    both = zip(signals.coordinates, signals.channels, strict=True)
    return tuple(k for k, (c, channel) in enumerate(both) if c.angle or channel.noise <= channel.floor)


def _block(records: Records, signals: Signals, period: float) -> int:
    """Return how many samples make an average."""
    if any(i.hold == "zero" for i in signals.inputs):
        return 1  # what a held input does between its switches is not in an average over several of them
    ends = 1.0 / (max(c.cutoff for c in signals.channels) * period)
    # Averages over as many samples as a sensor has smoothed have white noise, but they must follow the signals.
    smoothed = min(math.ceil(1.0 / min(c.white for c in signals.channels)), int(ends / FEWEST))
    block = max(1, int(ends / OVERSAMPLING), smoothed)
    enough = sum(len(r) for r in records) // FEW
    block = max(1, min(block, enough, min(len(r) for r in records) // (4 * LEAST_SEGMENT)))
    return block - (block + 1) % 2  # the centre of an odd block is a sample, at which the filtered signal is known


def _cut(
    runs: Sequence[tuple[int, int]], length: int, weight: FloatArray | None
) -> tuple[IntArray, IntArray, BoolArray]:
    """Return start and count of segments of about so many averages, and whether each ends where the next begins.

    A segment of which a coordinate has too few averages that were measured goes on to the end of the next: by itself
    it would not determine a state. Shorter ones do not anyway: their neighbours help.
    """
    start, count, joined = list[int](), list[int](), list[bool]()
    for begin, end in runs:
        pieces = max(1, round((end - begin) / length))
        edges = np.linspace(0, end - begin, pieces + 1).astype(np.int64)
        if weight is not None:
            edges = _determined(edges, weight[begin:end] > 0.0, min(length, LEAST_SEGMENT))
            pieces = len(edges) - 1
        start += (begin + edges[:-1]).tolist()
        count += np.diff(edges).tolist()
        joined += [True] * (pieces - 1) + [False]
    return np.array(start, dtype=np.int64), np.array(count, dtype=np.int64), np.array(joined, dtype=np.bool_)


def _determined(edges: IntArray, measured: BoolArray, least: int) -> IntArray:
    """Return the edges between which every coordinate has at least so many averages that were `measured` (b, c)."""
    there = np.concatenate([np.zeros((1, measured.shape[1]), dtype=np.int64), np.cumsum(measured, axis=0)])
    kept = [0]
    for edge in edges[1:-1].tolist():
        if min((there[edge] - there[kept[-1]]).min(), (there[-1] - there[edge]).min()) >= least:
            kept.append(edge)
    return np.array([*kept, edges[-1]], dtype=np.int64)


def _averages(
    run: Record, signals: Signals, differentiator: Differentiator, period: float, block: int
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Return what is seen of one record.

    Measured averages (b, c) and their weights, the samples at their centres (b,), smoothed states (b, n).
    """
    blocks = len(run) // block
    centre = (block - 1) // 2 + block * np.arange(blocks)
    smooth: dict[str, FloatArray] = {}
    columns, weights = [], []
    for c, channel in zip(signals.coordinates, signals.channels, strict=True):
        samples = run.column(c.name)
        values = derivatives_like(differentiator, channel.cutoff, [samples], [False], period, c.order - 1)[0]
        at_centre = [v[centre] for v in values]
        smooth |= {c.derivative(k): v for k, v in enumerate(at_centre)}
        rest = (samples - values[0])[: blocks * block].reshape(blocks, block)
        average, weight = _weighed(rest, run.counted(c.name)[: blocks * block].reshape(blocks, block))
        columns.append(average + at_centre[0])
        weights.append(weight)
    states = np.column_stack([smooth[s] for s in signals.states])
    return np.column_stack(columns), np.column_stack(weights), centre, states


def _weighed(rest: FloatArray, counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the averages (b,) of residuals (b, block), and the root of the share of a full average behind each."""
    if np.all(counts == 1.0):
        return rest.mean(axis=1), np.ones(len(rest))
    total = counts.sum(axis=1)
    return (counts * rest).sum(axis=1) / np.maximum(total, 1.0), np.sqrt(total / counts.shape[1])


def _smoothing_error(signals: Signals, noise: FloatArray, period: float) -> FloatArray:
    """Return the standard deviation that white noise leaves in each filtered state below the cutoff."""
    found = {}
    for c, channel, sigma in zip(signals.coordinates, signals.channels, noise, strict=True):
        for k in range(c.order):
            power = (2.0 * np.pi) ** (2 * k) * channel.cutoff ** (2 * k + 1) / (2 * k + 1)
            found[c.derivative(k)] = sigma * np.sqrt(2.0 * period * power)
    return np.array([found[s] for s in signals.states])
