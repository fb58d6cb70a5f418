"""Differentiators: from the records of one channel to filtered values and derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Protocol, runtime_checkable

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.signals.cutoff import AnyCutoff, LeastRisk
from odescope.signals.noise import noise_level
from odescope.signals.spectral import Spectrum, differentiate, differentiate_smoothly, last_bin


@dataclass(frozen=True, eq=False)
class Derivatives:
    """What a differentiator returns for one channel.

    Shapes: values, one array (order + 1, N) a record; noise is a standard deviation in the channel's unit, cutoff is in
    hertz, the frequency above which the values hold nothing.
    """

    values: tuple[FloatArray, ...]
    noise: float
    cutoff: float


class Differentiator(Protocol):
    """Filters and differentiates the records of one channel; one of one's own needs this method alone."""

    def derivatives(self, channel: Sequence[FloatArray], period: float, order: int) -> Derivatives:
        """Return values and derivatives of uniformly sampled records.

        Args:
            channel: (N,) a record.
            period: of the samples, in seconds.
            order: of the highest derivative.
        """
        ...


@runtime_checkable
class Adaptive(Protocol):
    """A differentiator that learns something from the records, such as a cutoff.

    Of a log that is read in chunks it learns from a sample; then all the chunks are filtered alike, by what `settled`
    returns. One that lacks this method is asked for every chunk as it is.
    """

    def settled(self, cutoff: float, smooth: bool) -> Differentiator:
        """Return the differentiator for more records of a channel.

        Args:
            cutoff: what was found in the channel, in hertz.
            smooth: the records are cut out of longer ones: what lies further away than `spectral.reach(cutoff)`
                must not matter.
        """
        ...


class Spectral(msgspec.Struct, frozen=True, tag="spectral", tag_field="kind", forbid_unknown_fields=True):
    """The paper's spectral filter and differentiation.

    Attributes:
        cutoff: who chooses the frequency above which a coordinate holds nothing but noise.
    """

    cutoff: AnyCutoff = LeastRisk()

    def derivatives(self, channel: Sequence[FloatArray], period: float, order: int) -> Derivatives:
        """Return values and derivatives up to `order` from one transform a record."""
        hertz = self.cutoff.hertz(channel, period, order)
        noise = noise_level([Spectrum.of(s) for s in channel])
        return replace(Settled(hertz).derivatives(channel, period, order), noise=noise)

    def settled(self, cutoff: float, smooth: bool) -> Differentiator:
        """Return the filter with that cutoff."""
        return Settled(cutoff, smooth)


@dataclass(frozen=True)
class Settled:
    """A spectral filter whose cutoff, in hertz, was found before; with a smooth edge where a record is cut."""

    cutoff: float
    smooth: bool = False

    def derivatives(self, channel: Sequence[FloatArray], period: float, order: int) -> Derivatives:
        """Return values and derivatives up to `order`; the noise is left to whoever found the cutoff."""
        values = (
            differentiate_smoothly(samples, period, self.cutoff, order)
            if self.smooth
            else differentiate(samples, period, last_bin(len(samples), period, self.cutoff), order)
            for samples in channel
        )
        return Derivatives(tuple(values), np.nan, self.cutoff)


def derivatives_like(
    differentiator: Differentiator,
    cutoff: float,
    channel: Sequence[FloatArray],
    cut: Sequence[bool],
    period: float,
    order: int,
) -> list[FloatArray]:
    """Return values and derivatives, (order + 1, N) a record, of more records of a channel whose cutoff was found.

    Args:
        differentiator: that found it.
        cutoff: in hertz.
        channel: (N,) a record.
        cut: whether each record is cut out of a longer one.
        period: of the samples, in seconds.
        order: of the highest derivative.
    """
    found: dict[int, FloatArray] = {}
    for smooth in (False, True):
        alike = [k for k, is_cut in enumerate(cut) if is_cut == smooth]
        if alike:
            own = differentiator.settled(cutoff, smooth) if isinstance(differentiator, Adaptive) else differentiator
            values = own.derivatives([channel[k] for k in alike], period, order).values
            found |= dict(zip(alike, values, strict=True))
    return [found[k] for k in range(len(channel))]


class SmoothingSpline(
    msgspec.Struct, frozen=True, tag="smoothing_spline", tag_field="kind", forbid_unknown_fields=True
):
    """SciPy's cubic smoothing spline.

    Meant for order 1: the second derivative of a cubic spline is piecewise linear.

    Attributes:
        smoothing: SciPy's `lam`; left out, generalised cross-validation chooses it.
    """

    smoothing: Annotated[float, msgspec.Meta(gt=0.0)] | None = None

    def derivatives(self, channel: Sequence[FloatArray], period: float, order: int) -> Derivatives:
        """Return values and derivatives of one spline a record."""
        from scipy.interpolate import make_smoothing_spline

        values = []
        for samples in channel:
            time = period * np.arange(len(samples))
            spline = make_smoothing_spline(time, samples, lam=self.smoothing)
            values.append(np.array([spline(time, nu=k) for k in range(order + 1)]))
        return _measured(channel, values, period)


class SavitzkyGolay(msgspec.Struct, frozen=True, tag="savitzky_golay", tag_field="kind", forbid_unknown_fields=True):
    """SciPy's Savitzky-Golay filter: local polynomials.

    Attributes:
        window (samples): that a polynomial is fitted to.
        degree: of the polynomials.
    """

    window: Annotated[int, msgspec.Meta(ge=3)]
    degree: Annotated[int, msgspec.Meta(ge=1)] = 4

    def derivatives(self, channel: Sequence[FloatArray], period: float, order: int) -> Derivatives:
        """Return values and derivatives of the local polynomials."""
        from scipy.signal import savgol_filter

        shortest = min(len(s) for s in channel)
        if not order <= self.degree < self.window <= shortest:
            raise InputError(
                f"savitzky_golay needs order <= degree < window <= samples; these are {order}, {self.degree},"
                f" {self.window} and {shortest}"
            )
        values = [
            np.array([savgol_filter(s, self.window, self.degree, deriv=k, delta=period) for k in range(order + 1)])
            for s in channel
        ]
        return _measured(channel, values, period)


def _measured(channel: Sequence[FloatArray], values: list[FloatArray], period: float) -> Derivatives:
    # These filters have no sharp cutoff: state the frequency below which 99.9 % of the highest derivative's power lies.
    noise = float(np.sqrt(np.mean(np.concatenate([(s - v[0]) ** 2 for s, v in zip(channel, values, strict=True)]))))
    longest = max(values, key=lambda v: v.shape[1])[-1]
    power = np.cumsum(np.abs(np.fft.rfft((longest - longest.mean()) * np.hanning(len(longest)))) ** 2)
    edge = np.searchsorted(power, 0.999 * power[-1])
    return Derivatives(tuple(values), noise, float(np.fft.rfftfreq(len(longest), period)[min(edge, len(power) - 1)]))


AnyDifferentiator = Spectral | SmoothingSpline | SavitzkyGolay
