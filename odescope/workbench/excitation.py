"""Inputs to try a model with: a constant, a step, a sine, a chirp, of sizes that its data make plausible."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10
from typing import Literal

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError

Shape = Literal["constant", "step", "sine", "chirp"]
# What says how each goes, by the fields of an excitation.
SAID: dict[Shape, tuple[str, ...]] = {
    "constant": ("level",),
    "step": ("level", "goal", "begin"),
    "sine": ("level", "amplitude", "frequency"),
    "chirp": ("level", "amplitude", "frequency", "last_frequency"),
}
PER_PERIOD = 40  # samples of the fastest period
LEAST_SAMPLES, MOST_SAMPLES = 500, 100_000
LEVEL, GOAL, AMPLITUDE = 0.5, 0.75, 0.25  # of the range of the data
BEGIN, PERIODS, LAST_PERIODS = 0.1, 5.0, 25.0  # of the duration; in it


@dataclass(frozen=True)
class Excitation:
    """An input over time.

    Attributes:
        shape: a constant; a step from one level to another; a sine; a chirp, whose frequency grows evenly to the end.
        level: the constant, what the step begins from, what a sine and a chirp go around.
        goal: the level that the step goes to.
        begin: of the step, in seconds.
        amplitude: of the sine and the chirp.
        frequency: of the sine, and at the beginning of the chirp, in Hz.
        last_frequency: at the end of the chirp, in Hz.
    """

    shape: Shape = "step"
    level: float = 0.0
    goal: float = 1.0
    begin: float = 0.0
    amplitude: float = 1.0
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
            return np.full(len(t), self.level)
        if self.shape == "step":
            return np.where(t >= self.begin, self.goal, self.level)
        rate = 0.0
        if self.shape == "chirp":
            rate = (self.last_frequency - self.frequency) / max(float(t[-1]), 1e-300)
        found: FloatArray = self.level + self.amplitude * np.sin(2.0 * np.pi * (self.frequency * t + 0.5 * rate * t**2))
        return found


def suggested(low: float, high: float, duration: float) -> Excitation:
    """Return an excitation of short numbers that stays within a range, and shows within a duration.

    Args:
        low: end of the range.
        high: the other; the same where the input rests.
        duration: in seconds.
    """
    span = high - low
    size = AMPLITUDE * span
    if not 0.0 < span < np.inf or low + size == low:
        level = goal = low
    else:
        # To the place of a quarter of the range: neither leaves the range by that, nor meets the other.
        level, goal = (_to_place(low + part * span, size) for part in (LEVEL, GOAL))
    return Excitation(
        "step" if goal != level else "constant",
        level,
        goal,
        plain(BEGIN * duration),
        _to_place(size, size) if goal != level else 0.0,
        plain(PERIODS / duration),
        plain(LAST_PERIODS / duration),
    )


def plain(value: float) -> float:
    """Return a positive number to two digits."""
    return float(f"{value:.1e}")


def _to_place(value: float, size: float) -> float:
    """Return a number to the first place of another, halves up, so that of two none passes the other."""
    place = floor(log10(size))
    return round(floor(value / 10.0**place + 0.5) * 10.0**place, -place)


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
