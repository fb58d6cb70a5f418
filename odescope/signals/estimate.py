"""From records to signals: every state, target and input on one grid, at the rate the signals need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError, NoModelError
from odescope.recordings.checks import degrees_hints
from odescope.recordings.coordinate import Coordinate, Input, state_names
from odescope.recordings.periods import PERIODS_DIFFER
from odescope.recordings.record import Record, Records, Stretch, within
from odescope.signals.appearance import telling
from odescope.signals.coloured_noise import WHITE, Coloured, coloured_noise
from odescope.signals.differentiators import Derivatives, Differentiator, derivatives_like
from odescope.signals.filling import measured_derivatives
from odescope.signals.noise import least_noise
from odescope.signals.spectral import EDGE, EDGE_DEVIATIONS, Spectrum, differentiate, differentiate_smoothly

OVERSAMPLING = 8  # samples a period of the highest cutoff that regression sees; products of signals need the room
INPUT_BAND = 0.9  # of half the decimated rate: where inputs end
DENSE = 0.9  # of the samples of a recording, at least, were measured: its spectrum then tells its noise
SIGNAL_OVER_NOISE = 5.0  # times the variance that noise alone would leave below the cutoff


@dataclass(frozen=True)
class Channel:
    """What was found in one coordinate: noise (standard deviation, its unit), cutoff (hertz).

    The noise is no less than `floor`, see `odescope.signals.noise.least_noise`, and white up to `white`, a share of
    half the sampling rate, see `odescope.signals.coloured_noise`.
    """

    name: str
    noise: float
    cutoff: float
    floor: float = 0.0
    white: float = 1.0


@dataclass(frozen=True, eq=False)
class Signals:
    """Filtered coordinates with derivatives up to the targets, and inputs, without the margins at the ends.

    Shapes: one array (names, N_r) a record in `columns`; start holds the time of each first sample, in seconds.
    """

    names: tuple[str, ...]
    columns: tuple[FloatArray, ...]
    start: tuple[float, ...]
    period: float
    channels: tuple[Channel, ...]
    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: every coordinate, then the first derivatives, and so on."""
        return state_names(self.coordinates)

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets, one a coordinate."""
        return tuple(c.target for c in self.coordinates)

    @property
    def samples(self) -> int:
        """Samples in all records together."""
        return sum(c.shape[1] for c in self.columns)

    def row(self, name: str) -> int:
        """Return the row of a name in every array."""
        return self.names.index(name)

    def joined(self) -> FloatArray:
        """Return all records end to end, (names, N)."""
        return np.concatenate(self.columns, axis=1)


def estimate_signals(
    records: Records,
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    differentiator: Differentiator,
    margin: float = 0.5,
    decimate: bool = True,
    least: int = 0,
) -> Signals:
    """Return the signals of uniformly sampled records.

    Args:
        records: runs that hold a column for every coordinate and input, all at one sampling period.
        coordinates: what was measured.
        inputs: what drove it.
        differentiator: see `Differentiator`.
        margin: what is dropped at each end, in periods of the lowest cutoff, but at most a twentieth of a record.
        decimate: keep eight samples a period of the highest cutoff; the filtered signals hold no more.
        least: samples that are kept even so, where there are as many.

    Raises:
        InputError: the sampling periods differ.
        NoModelError: a coordinate holds nothing above its noise.
    """
    period = _common_period(records)
    found, channels = [], list[Channel]()
    for c in coordinates:
        derivatives = measured_derivatives(records, c, differentiator)
        # What was filled in, or is the mean of several, is off the steps of the sensor.
        measured = [run.column(c.name)[run.counted(c.name) == 1.0] for run in records]
        floor, coloured = least_noise(measured, derivatives.noise), _coloured(records, c)
        found.append(replace(derivatives, noise=max(derivatives.noise, floor, coloured.deviation)))
        _check_signal(records, c, found[-1], period)
        channels.append(Channel(c.name, found[-1].noise, found[-1].cutoff, floor, coloured.white))
    enough = max(1, records.samples // least) if least else records.samples
    stride = min(enough, max(1, int(1.0 / (period * OVERSAMPLING * max(d.cutoff for d in found))))) if decimate else 1
    names = (*state_names(coordinates), *(c.target for c in coordinates), *(i.name for i in inputs))
    signals = Signals(names, (), (), period * stride, tuple(channels), tuple(coordinates), tuple(inputs))
    return _gathered(signals, records.stretches, [d.values for d in found], margin)


def _coloured(records: Records, coordinate: Coordinate) -> Coloured:
    """Return the noise of a coordinate where its sensor filters; white where samples lack: what fills in is smooth."""
    dense = all(np.mean(run.counted(coordinate.name) > 0.0) >= DENSE for run in records)
    return coloured_noise([Spectrum.of(run.column(coordinate.name)) for run in records]) if dense else WHITE


def filter_notes(signals: Signals, period: float) -> tuple[str, ...]:
    """Return what to say of the coordinates whose sensors filter, of records that are sampled so."""
    ends = ((c.name, 0.5 * c.white / period) for c in signals.channels if c.white < 1.0)
    said = "the noise of {} ends near {:.3g} Hz, as behind a filter: its level is told from below that"
    return tuple(said.format(name, hertz) for name, hertz in ends)


def signals_like(
    like: Signals, stretches: Sequence[Stretch], differentiator: Differentiator, margin: float = 0.5
) -> Signals:
    """Return the signals of other records, filtered and decimated as those that are there already.

    A record that is cut out of a longer one is filtered with a smooth edge (see `differentiate_smoothly`), a whole one
    as `like` was.

    Args:
        like: signals whose cutoffs, noise, period, coordinates and inputs are taken over.
        stretches: uniformly sampled at the period of the records behind `like`.
        differentiator: that of `like`.
        margin: that of `like`.

    Raises:
        InputError: the sampling periods differ.
    """
    period = like.period / stride_of(like, stretches[0].record) if stretches else like.period
    values = [
        derivatives_like(
            differentiator,
            channel.cutoff,
            [s.record.column(c.name) for s in stretches],
            [s.cut for s in stretches],
            period,
            c.order,
        )
        for c, channel in zip(like.coordinates, like.channels, strict=True)
    ]
    return _gathered(like, stretches, values, margin)


def _gathered(
    like: Signals, stretches: Sequence[Stretch], values: Sequence[Sequence[FloatArray]], margin: float
) -> Signals:
    """Return what is kept of records of which values and derivatives are given, one list a coordinate."""
    columns, start = [], []
    for stretch, *own in zip(stretches, *values, strict=True):
        time, kept = _kept(like, stretch, own, stride_of(like, stretch.record), margin)
        if kept.shape[1]:
            columns.append(kept)
            start.append(time)
    return replace(like, columns=tuple(columns), start=tuple(start))


def stride_of(like: Signals, run: Record) -> int:
    """Return how many samples of a record make a period of signals; InputError where it is sampled otherwise."""
    stride = max(1, round(like.period / run.sample_period))
    if abs(run.sample_period - like.period / stride) > PERIODS_DIFFER * like.period / stride:
        raise InputError(
            f"a recording is sampled every {run.sample_period:g} s{within(run.source)}, which does not suit"
            f" the others, {like.period:g} s after decimation: resample them to one period, or study them apart"
        )
    return stride


def most_dropped(samples: int) -> int:
    """Return how many of so many samples are dropped at each end of a record at most."""
    return samples // 20


def _kept(
    signals: Signals, stretch: Stretch, values: Sequence[FloatArray], stride: int, margin: float
) -> tuple[float, FloatArray]:
    """Return the time of the first sample that is kept of a record, and the columns (names, n)."""
    run, period = stretch.record, signals.period / stride
    drop = min(round(margin / (min(c.cutoff for c in signals.channels) * period)), most_dropped(len(run)))
    first = max(stretch.first, drop) if stretch.begins else stretch.first
    stop = min(stretch.stop, len(run) - drop) if stretch.ends else stretch.stop
    found = zip(signals.coordinates, values, strict=True)
    rows = {c.derivative(k): v for c, derivatives in found for k, v in enumerate(derivatives)}
    rows |= {i.name: _held_back(_centred(run.column(i.name), i.hold), stride, stretch.cut) for i in signals.inputs}
    columns = np.ascontiguousarray([rows[name][first:stop:stride] for name in signals.names])
    return float(run.t[min(first, len(run) - 1)]), columns


def _centred(samples: FloatArray, hold: str) -> FloatArray:
    # A held sample acts until the next one: at its own instant the input is, on average, half-way from the one before.
    if hold != "zero":
        return samples
    centred: FloatArray = 0.5 * (samples + np.concatenate([samples[:1], samples[:-1]]))
    return centred


def _held_back(samples: FloatArray, stride: int, cut: bool) -> FloatArray:
    # An input is not band-limited; what lies above half the decimated rate would fold down onto the signals.
    if stride == 1:
        return samples
    if cut:
        band = INPUT_BAND / (1.0 + 2.0 * EDGE_DEVIATIONS * EDGE)
        smooth = differentiate_smoothly(samples, 1.0, 0.5 * band / stride, 0)
    else:
        smooth = differentiate(samples, 1.0, max(int(INPUT_BAND * len(samples) / stride), 1), 0)
    held: FloatArray = smooth[0]
    return held


def _common_period(records: Records) -> float:
    periods = [run.sample_period for run in records]
    if max(periods) - min(periods) > PERIODS_DIFFER * min(periods):
        raise InputError(
            f"the recordings are sampled at different periods, {min(periods):g} s to {max(periods):g} s:"
            " resample them to one period, or study them apart"
        )
    return float(np.median(periods))


def _check_signal(records: Records, coordinate: Coordinate, found: Derivatives, period: float) -> None:
    # Within each record: what differs between records that stand still says nothing of how they move.
    kept = np.concatenate([v[0] - v[0].mean() for v in found.values])
    # White noise alone leaves this much in the cosines below the cutoff and the cubic.
    bins = sum(2.0 * v.shape[1] * period * found.cutoff + 4.0 for v in found.values)
    alone = found.noise**2 * bins / len(kept)
    if kept.var() < SIGNAL_OVER_NOISE * alone:
        advice = (
            telling([run.column(coordinate.name) for run in records])
            or " ".join(degrees_hints(records, [coordinate]))
            or "record longer, excite it more, or measure it better"
        )
        raise NoModelError(
            "signals",
            f"{coordinate.name} holds nothing above its noise (standard deviation {found.noise:.3g}): {advice}",
        )
