"""The noise level of a channel: what is left of its records above all that moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.signals.coloured_noise import SENSOR, coloured_noise
from odescope.signals.relative_noise import BY_MEDIAN, differ
from odescope.signals.spectral import MEDIAN_CHI_SQUARED, Spectrum

TURNS_ON = 0.1  # of its standard deviation: what is never further off a line turns on and on
DIGITS = 9  # decimal digits of its standard deviation: no logger writes more, and solvers do
SOLVER = 1e-4  # standard deviations of a channel by which the solution of a solver may be off
WHOLE = 0.01  # of a step of the sensor, by which a value may differ from a whole number of them
VALUES_A_STEP = 4.0  # samples a different value, at least, of a sensor whose steps matter


def sensor_step(columns: Sequence[FloatArray]) -> float:
    """Return the step in which a sensor counts, 0 where its values are no whole multiples of one."""
    values = np.unique(np.concatenate(columns))
    if len(values) < 3 or VALUES_A_STEP * len(values) > sum(map(len, columns)):
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * (values[-1] - values[0])]
    step = float(np.median(gaps[gaps <= 1.5 * gaps.min()]))
    steps = (values - values[0]) / step
    return step if np.abs(steps - np.rint(steps)).max() < WHOLE * max(1.0, 1e-3 * float(steps[-1])) else 0.0


def rounding_error(columns: Sequence[FloatArray]) -> float:
    """Return the standard deviation of what the steps of a sensor round away: a step over root twelve."""
    return sensor_step(columns) / float(np.sqrt(12.0))


def least_noise(columns: Sequence[FloatArray], white: float) -> float:
    """Return the standard deviation that the noise of a channel has at least.

    That is what the steps of the sensor round away. Where there is next to no white noise, and more digits than a
    logger writes, the channel was not measured but solved for: what a solver errs by is smooth, no white noise. What
    turns on and on goes as far as the record is long, which says nothing of its sensor: it is judged beside a line.

    Args:
        columns: (N,) a record; N may be 0 where a sensor said nothing.
        white: standard deviation of the white noise.
    """
    moves = float(np.concatenate([c - c.mean() for c in columns if len(c)]).std())
    shakes = float(np.concatenate([_beside_line(c) for c in columns if len(c)]).std())
    size = shakes if shakes < TURNS_ON * moves else moves
    solved = white < SENSOR * size and not _written(columns, moves)
    return max(rounding_error(columns), SOLVER * moves if solved else 0.0)


def _beside_line(column: FloatArray) -> FloatArray:
    """Return what a record (N,) is off the line that is nearest to it."""
    mean, since = column - column.mean(), np.arange(len(column)) - 0.5 * (len(column) - 1)
    off: FloatArray = mean - since * (since @ mean) / max(float(since @ since), 1.0)
    return off


def _written(columns: Sequence[FloatArray], moves: float) -> bool:
    """Say whether values (N,) that move by so much have no more digits than a logger writes."""
    places = DIGITS - int(np.floor(np.log10(max(moves, 1e-300))))
    values = np.concatenate(columns)
    return bool(np.abs(np.round(values, places) - values).max() < 10.0 ** -(places + 2))


def noise_level(spectra: Sequence[Spectrum]) -> float:
    """Return the standard deviation of the white noise of all records together."""
    levels, counts = noise_levels(spectra), [len(s.values) for s in spectra]
    return float(np.sqrt(np.average(levels**2, weights=counts))) if np.ptp(levels) else float(levels[0])


def noise_levels(spectra: Sequence[Spectrum]) -> FloatArray:
    """Return the standard deviation of the white noise of every record (runs,), from the median power of upper halves.

    It is the same in all where nothing clearly says otherwise. Where a sensor filtered it, it is that of white noise as
    dense as theirs is where signals are (`coloured_noise`).
    """
    upper = []
    for spectrum in spectra:
        count = len(spectrum.values)
        upper.append(spectrum.power(spectrum.cubic(count // 2), slice(count // 2, count)))
    each = np.array([np.median(u) if len(u) else 0.0 for u in upper])
    if not differ(each, np.array([len(u) for u in upper]), BY_MEDIAN):
        each = np.full(len(upper), np.median(np.concatenate(upper)))
    levels: FloatArray = np.sqrt(each / MEDIAN_CHI_SQUARED)
    seen = float(np.sqrt(np.mean(levels**2)))
    return levels * max(1.0, coloured_noise(spectra).deviation / seen) if seen > 0.0 else levels
