"""Noise that a sensor has filtered: how dense it is where signals are, and not near half the sampling rate alone.

An anti-aliasing filter, a moving average, exponential smoothing or a logger that reads more often than its sensor takes
noise away near half the sampling rate: what is left there says little of the noise below. docs/method.md, Signals.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray
from odescope.signals.relative_noise import BY_MEDIAN, SURE
from odescope.signals.spectral import MEDIAN_CHI_SQUARED, Spectrum

SENSOR = 1e-5  # standard deviations of a channel: the white noise of most sensors is more than that
THIRDS = 3  # bands an octave
BANDS = 5 * THIRDS  # no sensor is filtered to less than a thirtieth of half the sampling rate
FEWEST = 6  # bins of a band
CORNERS = np.geomspace(1e-3, 1e2, 60)  # of the shape of noise, sin^2(w / 2); beyond 1 there is next to no corner
SCATTER = 0.1  # natural logarithms by which the noise of a sensor may differ from that shape
SLIGHT = 6.0  # times less dense at half the sampling rate: no more than the foot of a signal may look like
DEPARTS = 3.0  # standard deviations by which a band is more or less where something else begins
FAR = 0.5  # natural logarithms by which it is at most, however few bins it has
STEEPEST = float(np.log(4.0))  # fall an octave of noise behind a filter of first order
LARGEST = 0.0025  # of the variance of a channel: what is more is signal


class _Bands(NamedTuple):
    """Thirds of octaves from half the sampling rate down, of all spectra together, (bands,) each.

    `median` and `mean` tell the variance of the white noise that is as dense; `sine` is sin^2(w / 2) in the middle.
    """

    median: FloatArray
    mean: FloatArray
    bins: FloatArray
    sine: FloatArray

    @property
    def weight(self) -> FloatArray:
        """The inverse variances of the logarithms of the medians."""
        weight: FloatArray = 1.0 / (BY_MEDIAN / self.bins + SCATTER**2)
        return weight

    def part(self, first: int, last: int) -> _Bands:
        """Return bands `first` to `last` - 1."""
        return _Bands(*(values[first:last] for values in self))


class Coloured(NamedTuple):
    """Noise that is not white: `deviation` of white noise as dense as it is where signals are, `white` up to where.

    That is a share of half the sampling rate: up to there it is half as dense or more.
    """

    deviation: float
    white: float


WHITE = Coloured(0.0, 1.0)


def coloured_noise(spectra: Sequence[Spectrum]) -> Coloured:
    """Return how dense the noise is where the signals are; a deviation of 0 where it is white.

    It is 0, too, where there is less near half the sampling rate than any sensor has: a solver has no noise.

    The density of noise is s0 / (1 + sin^2(w / 2) / corner), that of exponential smoothing, from the octave in which
    the spectrum is flattest, up and down as far as that holds. Signals begin where there is more than that below it. A
    sensor that takes more away above is no concern.
    """
    top = _bands(spectra, THIRDS + 1)
    if len(top.bins) <= THIRDS or _white(top):
        return WHITE
    bands = _bands(spectra, BANDS)
    power = float(np.mean([np.mean(s.values[1:] ** 2) for s in spectra]))
    above = float(bands.bins[:THIRDS] @ bands.median[:THIRDS] / bands.bins[:THIRDS].sum())
    if above < SENSOR**2 * power:
        return WHITE
    flat = np.ptp(np.lib.stride_tricks.sliding_window_view(np.log(bands.median), THIRDS + 1), axis=1)
    for first in np.argsort(flat).tolist():
        if flat[first] > STEEPEST:
            break
        found = _around(bands, first)
        if SLIGHT * above < found.deviation**2 <= LARGEST * power:
            return found
    return WHITE


def _around(bands: _Bands, first: int) -> Coloured:
    """Return the noise an octave below what has its shape from this octave on.

    No corner is known better than that. It is taken to be white unless there is less above, which a filter takes away,
    or the shape is seen over two octaves: white noise and the foot of a signal look so in one and a little more.
    """
    level, last = np.log(bands.median), first + THIRDS + 1
    within = np.minimum(DEPARTS / np.sqrt(bands.weight), FAR)
    while True:
        s0, corner = _shape(bands.part(first, last))
        more = level - s0 + np.log1p(bands.sine / corner)
        if first > 0 and abs(more[first - 1]) < within[first - 1]:
            first -= 1
        elif last < len(more) and more[last] < within[last]:
            last += 1
        else:
            break
    seen = more[first - 1] < 0.0 if first > 0 else last >= 2 * THIRDS
    if not seen or corner < bands.sine[last - 1]:
        return WHITE
    white = min(2.0 ** (-first / THIRDS), 2.0 / np.pi * float(np.arcsin(min(1.0, np.sqrt(corner)))))
    return Coloured(float(np.exp(0.5 * (s0 - np.log1p(0.25 * bands.sine[last - 1] / corner)))), white)


def _white(bands: _Bands) -> bool:
    """Say whether noise may be equally dense in these bands, by the likelihood that it is beside that of any levels."""
    told = bands.bins @ (np.log(bands.mean @ bands.bins / bands.bins.sum()) - np.log(bands.mean))
    return bool(told < SURE + 2.0 * (len(bands.bins) - 1))


def _shape(bands: _Bands) -> tuple[float, float]:
    """Return ln(s0) and the corner of the density that is nearest to these bands."""
    shapes, level = -np.log1p(bands.sine / CORNERS[:, None]), np.log(bands.median)
    s0 = (level - shapes) @ bands.weight / bands.weight.sum()
    best = int(np.argmin((level - shapes - s0[:, None]) ** 2 @ bands.weight))
    return float(s0[best]), float(CORNERS[best])


def _bands(spectra: Sequence[Spectrum], count: int) -> _Bands:
    """Return those of the topmost so many bands of which the spectra have enough bins."""
    medians, means, bins = np.zeros(count), np.zeros(count), np.zeros(count)
    for spectrum in spectra:
        edges = np.rint(len(spectrum.values) * 2.0 ** (-np.arange(count + 1) / THIRDS)).astype(int)
        cubics = spectrum.cubics((edges[::-1] - 1).tolist())[::-1]
        for k in range(count):
            size = edges[k] - edges[k + 1]
            if size >= FEWEST:
                power = spectrum.power(cubics[k + 1], slice(edges[k + 1], edges[k]))
                medians[k] += size * float(np.median(power)) / MEDIAN_CHI_SQUARED
                means[k] += float(power.sum())
                bins[k] += size
    there = (bins > 0.0) & (medians > 0.0)
    sine = np.sin(0.5 * np.pi * 2.0 ** (-(np.arange(count) + 0.5) / THIRDS)) ** 2
    return _Bands(medians[there] / bins[there], means[there] / bins[there], bins[there], sine[there])
