"""Where to cut: the paper's noise ceiling, and the cutoff of least risk, which needs no hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Protocol

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.signals.noise import noise_levels
from odescope.signals.spectral import Spectrum, bin_frequencies

PERIODOGRAM_WINDOW = 4096  # samples
WINDOWS_AT_ONCE = 256  # windows transformed together: it bounds the memory that a long record takes
BANDS = 80  # bands in which the risk is walked: measured best among 40, 80 and 160 on transients and on the demo


def periodogram(channel: Sequence[FloatArray], period: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies in hertz and the power per hertz, averaged over windows of the records (Welch's method).

    Hann windows of the shortest record, but of at most 4096 samples, that overlap by half, each less its line. White
    noise of standard deviation s stands at 2 s^2 period.
    """
    length = min(min(len(samples) for samples in channel), PERIODOGRAM_WINDOW)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    line = np.linspace(-1.0, 1.0, length)
    means = []
    for samples in channel:
        windows = np.lib.stride_tricks.sliding_window_view(samples, length)[:: length - length // 2]
        total = np.zeros(length // 2 + 1)
        for start in range(0, len(windows), WINDOWS_AT_ONCE):
            windowed = windows[start : start + WINDOWS_AT_ONCE]
            windowed = windowed - windowed.mean(axis=1, keepdims=True)
            windowed -= np.outer(windowed @ line / (line @ line), line)
            total += np.sum(np.abs(np.fft.rfft(windowed * window)) ** 2, axis=0)
        means.append(total / len(windows))
    power: FloatArray = np.mean(means, axis=0) * period / np.sum(window**2)
    power[1 : len(power) - (length % 2 == 0)] *= 2.0  # the negative frequencies, which all but these ends have
    return np.arange(len(power)) / (length * period), power


class Cutoff(Protocol):
    """Chooses a cutoff frequency from the records of one channel."""

    def hertz(self, channel: Sequence[FloatArray], period: float, order: int) -> float:
        """Return the cutoff in hertz.

        Args:
            channel: (N,) a record.
            period: of the samples, in seconds.
            order: of the derivative that is wanted.
        """
        ...


class LeastRisk(msgspec.Struct, frozen=True, tag="least_risk", tag_field="kind", forbid_unknown_fields=True):
    """The cutoff at which an unbiased estimate of the risk of the wanted derivative is least.

    risk(K) = sum over w > K of w^2k (P - s2) + sum over w <= K of w^2k s2, with P the power of the record less the
    cubic that suits K and s2 the noise floor, of each record its own where they differ; walked in bands, because the
    cubic changes with K.
    """

    def hertz(self, channel: Sequence[FloatArray], period: float, order: int) -> float:
        """Return the cutoff in hertz; several records are pooled by frequency."""
        spectra = [Spectrum.of(samples) for samples in channel]
        floors = noise_levels(spectra) ** 2
        frequencies = [bin_frequencies(len(samples), period) for samples in channel]
        edges = np.geomspace(2.0 * min(f[1] for f in frequencies), 0.475 / period, BANDS)
        bins = [np.searchsorted(f, edges, side="right") for f in frequencies]
        cubics = [spectrum.cubics([int(b) - 1 for b in bin_]) for spectrum, bin_ in zip(spectra, bins, strict=True)]

        def gain(band: int, last: int) -> tuple[FloatArray, FloatArray]:
            """Change of risk, bin by bin, of moving the cutoff from edge `band` to edge `last`."""
            where, change = [], []
            for spectrum, f, b, cubic, floor in zip(spectra, frequencies, bins, cubics, floors, strict=True):
                kept = slice(b[band], b[last])
                where.append(f[kept])
                change.append((f[kept] * period) ** (2 * order) * (2.0 * floor - spectrum.power(cubic[band], kept)))
            merged = np.concatenate(where)
            sequence = np.argsort(merged, kind="stable")
            return merged[sequence], np.concatenate(change)[sequence]

        steps = [gain(k, k + 1)[1].sum() for k in range(BANDS - 1)]
        best = int(np.argmin(np.concatenate([[0.0], np.cumsum(steps)])))
        low = max(best - 1, 0)
        where, change = gain(low, min(best + 1, BANDS - 1))
        fine = np.concatenate([[0.0], np.cumsum(change)])
        return float(np.concatenate([[edges[low]], where])[int(np.argmin(fine))])


class NoiseCeiling(msgspec.Struct, frozen=True, tag="noise_ceiling", tag_field="kind", forbid_unknown_fields=True):
    """The paper's cutoff (3.2): where the smoothed periodogram first falls below mean + z std of its upper half.

    Attributes:
        z (standard deviations): how far the ceiling is above the mean.
        offset (Hz): subtracted by hand, to "over-filter" ahead of a differentiation.
        average (bins): over which the periodogram is smoothed.
    """

    z: float = 2.0
    offset: float = 0.0
    average: Annotated[int, msgspec.Meta(ge=1)] = 5

    def hertz(self, channel: Sequence[FloatArray], period: float, order: int) -> float:
        """Return the cutoff in hertz; the periodograms of several records are averaged."""
        frequency, power = periodogram(channel, period)
        smooth = np.convolve(power, np.ones(self.average) / self.average, mode="same")
        below = np.flatnonzero(smooth < self.level(power))
        crossing = frequency[below[0]] if below.size else frequency[-1]
        return float(max(crossing - self.offset, frequency[1]))

    def level(self, power: FloatArray) -> float:
        """Return the noise ceiling of a periodogram: mean + z std of its upper half."""
        upper = power[len(power) // 2 :]
        return float(upper.mean() + self.z * upper.std())


class FixedCutoff(msgspec.Struct, frozen=True, tag="fixed", tag_field="kind", forbid_unknown_fields=True):
    """A cutoff set by hand.

    Attributes:
        frequency (Hz): the cutoff.
    """

    frequency: Annotated[float, msgspec.Meta(gt=0.0)]

    def hertz(self, channel: Sequence[FloatArray], period: float, order: int) -> float:
        """Return the frequency, at most just below half the sampling rate."""
        return min(self.frequency, 0.475 / period)


AnyCutoff = LeastRisk | NoiseCeiling | FixedCutoff
