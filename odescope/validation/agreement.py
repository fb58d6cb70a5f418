"""How well a prediction agrees with what was measured: fit in per cent, error in units, valid time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray

VALID_ERROR = 0.3  # of the standard deviation of what was measured: a larger error ends the valid time
NOISY = 3.0  # standard deviations of the noise: no less ends it, as where what was measured hardly moves
WINDOW = 11  # samples over which that error is a root mean square, so that noise alone does not end it

Pair = tuple[FloatArray, FloatArray]  # measured (N,), predicted (N,)


@dataclass(frozen=True)
class Agreement:
    """`fit` is 100 (1 - |e| / |y - mean|) in per cent, `rmse` the root mean square of e, in the unit of y.

    100 is perfect, 0 no better than the mean, below that worse. None where what was measured does not vary.
    """

    fit: float | None
    rmse: float

    def told(self, unit: str | None) -> str:
        """Return both as text, the error in a unit."""
        fit = "no fit, the measurement is constant" if self.fit is None else f"fit {self.fit:.4g} %"
        return f"{fit}, RMSE {self.rmse:.4g}{f' {unit}' if unit else ''}"


def agreement(pairs: Sequence[Pair]) -> Agreement:
    """Return the agreement over the measured samples of some recordings together, each beside its own mean."""
    error = np.concatenate([measured - predicted for measured, predicted in pairs])
    spread = np.concatenate([_about_mean(measured) for measured, _ in pairs])
    size = float(np.linalg.norm(spread))
    fit = 100.0 * (1.0 - float(np.linalg.norm(error)) / size) if size > 0.0 else None
    return Agreement(fit, float(np.sqrt(np.mean(error**2))))


def _about_mean(measured: FloatArray) -> FloatArray:
    """Return samples (N,) less their mean: zero where all are equal, of which a mean may be rounded."""
    return np.zeros_like(measured) if np.ptp(measured) == 0.0 else measured - measured.mean()


def valid_time(t: FloatArray, measured: FloatArray, predicted: FloatArray, noise: float = 0.0) -> float:
    """Return how long the error stays below 0.3 of the standard deviation of what was measured, in seconds.

    Where three standard deviations of the noise are more, it is these that the error has to pass.

    Args:
        t: (N,) seconds.
        measured: (N,).
        predicted: (K,) of the first K <= N samples.
        noise: standard deviation of a sample.
    """
    reached = len(predicted)
    off = (measured[:reached] - predicted) ** 2
    sums = np.concatenate([[0.0], np.cumsum(off)])
    last = np.arange(1, reached + 1)
    first = np.maximum(last - WINDOW, 0)
    allowed = max(VALID_ERROR * float(measured.std()), NOISY * noise)
    late = np.flatnonzero(np.sqrt((sums[last] - sums[first]) / (last - first)) > allowed)
    return float(t[late[0] if late.size else reached - 1] - t[0])


def turned(predicted: FloatArray, measured: FloatArray) -> FloatArray:
    """Return the prediction (K,) of an angle less the whole turns that its first sample is off; measured (N,)."""
    turns = float(np.rint((predicted[0] - measured[0]) / (2.0 * np.pi)))
    return predicted - 2.0 * np.pi * turns
