"""Noise that grows with what is measured, or differs between recordings.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray, robust_deviation

SHARES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)  # of the mean variance that does not grow with the reading
FAR = 5.0  # standard deviations beyond which a sample says nothing of the signal
SURE = 10.0  # fall of -2 ln(likelihood) that is asked for: odds of 150 to 1
WORTH = 1.2  # times the information that constant noise leaves, at least
BY_MEDIAN = 5.44  # times the inverse of so many samples: the variance of the logarithm of what their median says
BY_MEAN = 2.0  # the same of what their mean says


@dataclass(frozen=True, eq=False)
class RelativeNoise:
    """How noise grows with what is read: standard deviations (n,), in root mean squares of all, and what they fit.

    `level` is the root of the mean variance that the readings then have over the one that they seemed to have.
    """

    deviations: FloatArray
    level: float


def relative_noise(rest: FloatArray, signal: FloatArray, there: BoolArray, error: float) -> RelativeNoise | None:
    """Return how the noise of readings grows with them, None where it seems to be the same for all.

    The variance has a part that does not grow and one that goes with the square of the signal, of which the shares are
    the likeliest of a few. That a signal which seems to be zero may differ from that by its own error counts with it.

    Args:
        rest: (n,) readings less the signal, each in units of what its number of samples lets expect.
        signal: (n,).
        there: (n,) which of them were measured.
        error: standard deviation of the signal's own error.
    """
    r, square = rest[there], signal**2 + error**2
    if not np.any(r):
        return None
    best, least = None, len(r) * np.log(np.mean(r**2)) - SURE
    for share in SHARES:
        shape = share + (1.0 - share) * square / square[there].mean()
        found = len(r) * np.log(np.mean(r**2 / shape[there])) + np.sum(np.log(shape[there]))
        if found < least:
            best, least = shape, found
    if best is None or np.mean(1.0 / best[there]) < WORTH:
        return None
    return RelativeNoise(np.sqrt(best), float(np.sqrt(np.mean(r**2 / best[there]) / np.mean(r**2))))


def noise_of_recordings(
    rest: FloatArray, there: BoolArray, runs: Sequence[tuple[int, int]], told: float, least: float
) -> FloatArray | None:
    """Return the noise of every reading (n,) as its recording has it; None where it seems to be the same in all.

    Another sensor, another range, another day: the samples of a recording that is noisier weigh less.

    Args:
        rest: (n,) readings less the signal, in units of the noise that they seemed to have.
        there: (n,) which of them were measured.
        runs: the first reading of every recording and the one after its last.
        told: share of the noise that such a residual holds, as so many independent samples.
        least: noise that a reading has at least, as what was rounded has, in the same units.
    """
    squares = [rest[low:high][there[low:high]] ** 2 for low, high in runs]
    counts, sums = np.array([len(s) for s in squares]), np.array([float(s.sum()) for s in squares])
    if not np.all(counts > 0):
        return None
    variances = np.maximum(sums / counts, told * least**2)
    if not differ(variances, counts, BY_MEAN / told):
        return None
    return np.repeat(np.sqrt(variances / told), [high - low for low, high in runs])


def differ(variances: FloatArray, counts: IntArray, scatter: float) -> bool:
    """Say whether the noise of recordings differs clearly, and so much that it is worth telling them apart.

    Args:
        variances: (runs,) of the noise of each.
        counts: (runs,) of the samples that tell it.
        scatter: `BY_MEDIAN` or `BY_MEAN`.
    """
    if len(variances) < 2 or not np.all(variances > 0.0):
        return False
    logs, total = np.log(variances), float(counts.sum())
    apart = float(counts @ (logs - counts @ logs / total) ** 2) / scatter
    return apart > SURE * len(logs) and float(counts @ (1.0 / variances)) * float(counts @ variances) > WORTH * total**2


def recording_levels(rest: Sequence[FloatArray]) -> list[float]:
    """Return how noisy each recording is, over the root mean square of all; 1 for all where they are alike.

    Args:
        rest: (n,) what a filter leaves of each, whatever outliers are among.
    """
    counts = np.array([len(r) for r in rest])
    variances = np.array([robust_deviation(r) ** 2 if len(r) else 0.0 for r in rest])
    if not differ(variances, counts, BY_MEDIAN):
        return [1.0] * len(rest)
    levels: list[float] = np.sqrt(variances / (counts @ variances / counts.sum())).tolist()
    return levels


def usual_deviations(
    rest: Sequence[FloatArray], smooth: Sequence[FloatArray]
) -> Callable[[Sequence[FloatArray]], list[FloatArray]]:
    """Return what gives the usual deviation of readings, which may grow with the signal, whatever outliers are among.

    Recordings may have levels of their own beside: those of what is left when growth is divided out, as one in which
    the signal is small is quieter for that alone. The deviation is no less than without growth: a signal that is
    filtered badly where it is near zero shows no outliers there.

    Args:
        rest: (n,) readings of each recording less the filtered signal.
        smooth: (n,) that signal.
    """
    mean = max(float(np.mean(np.concatenate(smooth) ** 2)), 1e-300)

    def scale(share: float, signal: FloatArray) -> FloatArray:
        found: FloatArray = np.sqrt(share + (1.0 - share) * signal**2 / mean)
        return found

    def told(share: float) -> tuple[float, list[float]]:
        by = [scale(share, s) for s in smooth]
        levels = recording_levels([r / b for r, b in zip(rest, by, strict=True)])
        wide = np.concatenate([level * b for level, b in zip(levels, by, strict=True)])
        each = np.concatenate(rest) / wide
        deviation = robust_deviation(each)
        # Laplace's density, which few outliers move little, and these cut off.
        off = float(np.mean(np.minimum(np.abs(each), FAR * max(deviation, 1e-300))))
        unlikely = 2.0 * (len(each) * np.log(max(off, 1e-300)) + float(np.sum(np.log(wide))))
        return unlikely, [deviation * level for level in levels]

    least, same = told(1.0)
    best, grown = 1.0, same
    for share in SHARES if min(same) > 0.0 else ():
        unlikely, deviations = told(share)
        if unlikely < least - (SURE if best == 1.0 else 0.0):
            least, best, grown = unlikely, share, deviations

    def usual(signals: Sequence[FloatArray]) -> list[FloatArray]:
        each = zip(same, grown, signals, strict=True)
        return [np.maximum(constant, own * scale(best, signal)) for constant, own, signal in each]

    return usual
