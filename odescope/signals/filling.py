"""What was not measured is filled in by the filtered signal (Papoulis 1975: missing samples of a band-limited one)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records, Stretch
from odescope.signals.cutoff import LeastRisk
from odescope.signals.differentiators import Derivatives, Differentiator, Spectral, derivatives_like
from odescope.signals.noise import noise_level
from odescope.signals.spectral import TREND_DEGREE, Spectrum
from odescope.signals.supported import bears_fits, supported_cutoff

SPARSE = 0.5  # of the samples of the densest record in the same time
BANDS = 4.0  # measured samples a period of the cutoff: the upper half of their band is then above it
MANY = 300  # samples: the median power of half of the bins of fewer scatters by more than a tenth
LEFT = 0.2  # of the samples, at least, as degrees of freedom of what a filter leaves
ROUNDS = 8  # of filtering and filling in: a lost sample is settled after two, a gap of half a period after all


def measured_derivatives(records: Records, coordinate: Coordinate, differentiator: Differentiator) -> Derivatives:
    """Return values and derivatives of a coordinate, and the noise of one measured sample.

    Records with less than half as many samples in the same time as the densest take no part in finding noise and
    cutoff: what is filled in between their samples is smoother than what was measured. The noise is told from what the
    filter leaves of the samples that were measured, one after another, if there are enough of them for half of their
    band to lie above the cutoff.

    Args:
        records: uniformly sampled, at one period.
        coordinate: what was measured.
        differentiator: filters it.
    """
    period = float(np.median([run.sample_period for run in records]))
    channel = [run.column(coordinate.name) for run in records]
    if all(run.counts is None for run in records):
        return differentiator.derivatives(channel, period, coordinate.order)
    counts = [run.counted(coordinate.name) for run in records]
    density = np.array([np.mean(n > 0.0) for n in counts])
    dense = [k for k, d in enumerate(density) if d >= SPARSE * density.max()]
    found = _supported(
        differentiator, differentiator.derivatives([channel[k] for k in dense], period, coordinate.order),
        [channel[k] for k in dense], [counts[k] for k in dense], period,
    )  # fmt: skip
    values = dict(zip(dense, found.values, strict=True))
    sparse = [k for k in range(len(channel)) if k not in values]
    others = [channel[k] for k in sparse]
    like = derivatives_like(differentiator, found.cutoff, others, [False] * len(others), period, coordinate.order)
    values |= dict(zip(sparse, like, strict=True))
    rest = [(np.sqrt(counts[k]) * (channel[k] - values[k][0]))[counts[k] > 0.0] for k in dense]
    noise = _noise(rest, [len(channel[k]) for k in dense], found.cutoff * period, found.noise)
    return Derivatives(tuple(values[k] for k in range(len(channel))), noise, found.cutoff)


def _supported(
    differentiator: Differentiator,
    found: Derivatives,
    channel: Sequence[FloatArray],
    counts: Sequence[FloatArray],
    period: float,
) -> Derivatives:
    """Return values and derivatives with a cutoff no higher than the measured samples support, if nobody set it.

    Args:
        differentiator: of the channel.
        found: what it returned.
        channel: (N,) a record.
        counts: (N,) measured samples behind each value.
        period: of the grid.
    """
    by_risk = isinstance(differentiator, Spectral) and isinstance(differentiator.cutoff, LeastRisk)
    if not by_risk or not bears_fits(counts):
        return found
    hertz = min(found.cutoff, supported_cutoff(channel, counts, period, found.cutoff))
    values = derivatives_like(differentiator, hertz, channel, [False] * len(channel), period, len(found.values[0]) - 1)
    return Derivatives(tuple(values), found.noise, hertz)


def _noise(rest: Sequence[FloatArray], lengths: Sequence[int], cutoff: float, before: float) -> float:
    """Return the noise of a measured sample.

    That is what a filter leaves of the measured samples, one after another, above the cutoff, if enough of their band
    is there. Of few samples that scatters: the mean square of all that is left is then told apart from what the filter
    took with it, as many degrees of freedom as it has cosines and powers.

    Args:
        rest: (n,) what is left of the measured samples of a record.
        lengths: of the records, in points of the grid.
        cutoff: in periods of the grid.
        before: the noise that was found with the cutoff.
    """
    measured, points = sum(map(len, rest)), sum(lengths)
    free = measured - sum(2.0 * n * cutoff + 1.0 + TREND_DEGREE for n in lengths)
    if measured < MANY and free > LEFT * measured:
        return float(np.sqrt(sum(float(r @ r) for r in rest) / free))
    return noise_level([Spectrum.of(r) for r in rest]) if measured > BANDS * cutoff * points else before


def filled(records: Records, coordinates: Sequence[Coordinate], differentiator: Differentiator) -> Records:
    """Return the records with the filtered signal where nothing was measured.

    Args:
        records: uniformly sampled, at one period.
        coordinates: what was measured.
        differentiator: filters them; it finds the cutoffs in the records as they are.
    """
    if not any(_lacks(run, c) for run in records for c in coordinates):
        return records
    cutoffs = [measured_derivatives(records, c, differentiator).cutoff for c in coordinates]
    return Records.of(s.record for s in filled_like(records.stretches, coordinates, differentiator, cutoffs))


def filled_like(
    stretches: Sequence[Stretch],
    coordinates: Sequence[Coordinate],
    differentiator: Differentiator,
    cutoffs: Sequence[float],
) -> tuple[Stretch, ...]:
    """Return stretches with the filtered signal where nothing was measured.

    Args:
        stretches: uniformly sampled, at one period.
        coordinates: what was measured.
        differentiator: filters them.
        cutoffs: one a coordinate, in hertz.
    """
    found = []
    for stretch in stretches:
        values = stretch.record.values.copy()
        lacking = [(c, hertz) for c, hertz in zip(coordinates, cutoffs, strict=True) if _lacks(stretch.record, c)]
        for c, hertz in lacking:
            values[:, stretch.record.names.index(c.name)] = _filled(stretch, c, differentiator, hertz)
        found.append(replace(stretch, record=replace(stretch.record, values=values)) if lacking else stretch)
    return tuple(found)


def _lacks(run: Record, coordinate: Coordinate) -> bool:
    return bool(np.any(run.counted(coordinate.name) == 0.0))


def _filled(stretch: Stretch, coordinate: Coordinate, differentiator: Differentiator, hertz: float) -> FloatArray:
    """Return a column (N,), filtered and filled again until nothing moves that matters."""
    run = stretch.record
    column, period, missing = run.column(coordinate.name), run.sample_period, run.counted(coordinate.name) == 0.0
    for _ in range(ROUNDS):
        smooth = derivatives_like(differentiator, hertz, [column], [stretch.cut], period, 0)[0][0]
        column = np.where(missing, smooth, column)
    return column
