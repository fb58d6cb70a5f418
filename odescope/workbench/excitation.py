"""Inputs to try a model with: a step, a sine, a chirp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError

Shape = Literal["constant", "step", "sine", "chirp"]
PER_PERIOD = 40  # samples of the fastest period
LEAST_SAMPLES, MOST_SAMPLES = 500, 100_000


@dataclass(frozen=True)
class Excitation:
    """An input over time.

    Attributes:
        shape: a constant; a step from zero; a sine; a chirp, whose frequency grows evenly to the end.
        size: the constant, the height of the step, the amplitude.
        begin: of the step, in seconds.
        frequency: of the sine, and at the beginning of the chirp, in Hz.
        last_frequency: at the end of the chirp, in Hz.
    """

    shape: Shape = "step"
    size: float = 1.0
    begin: float = 0.0
    frequency: float = 1.0
    last_frequency: float = 5.0

    @property
    def highest(self) -> float:
        """The highest frequency, in Hz."""
        own = {"sine": self.frequency, "chirp": max(self.frequency, self.last_frequency)}
        return own.get(self.shape, 0.0)

    def values(self, t: FloatArray) -> FloatArray:
        """Return the input at times (N,) in seconds that begin at 0."""
        if self.shape == "constant":
            return np.full(len(t), self.size)
        if self.shape == "step":
            return np.where(t >= self.begin, self.size, 0.0)
        if self.shape == "sine":
            return self.size * np.sin(2.0 * np.pi * self.frequency * t)
        rate = (self.last_frequency - self.frequency) / max(float(t[-1]), 1e-300)
        found: FloatArray = self.size * np.sin(2.0 * np.pi * (self.frequency * t + 0.5 * rate * t**2))
        return found


def sample_times(duration: float, excitations: list[Excitation]) -> FloatArray:
    """Return times (N,) for a simulation in seconds, near enough to each other for every input.

    Raises:
        InputError: the duration is not positive, or the inputs are too fast for it.
    """
    if not 0.0 < duration < np.inf:
        raise InputError(f"the duration must be a positive number of seconds, got {duration!r}")
    wanted = PER_PERIOD * duration * max((e.highest for e in excitations), default=0.0)
    if not wanted <= MOST_SAMPLES:
        raise InputError(f"{wanted:.3g} samples would be needed: choose a lower frequency, or less time")
    return np.linspace(0.0, duration, max(LEAST_SAMPLES, int(wanted)) + 1)
