"""Whether innovations are what an observer says of them: as large as it expects, and white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, ndtri

from odescope.arrays import FloatArray

LEVEL = 0.95  # of the intervals
SMALL = 0.5  # of the lower end of its band, from which on the mean is far below it
TELLING = 32  # innovations, fewer of which say more of the start than of the noise
LAGS = 20  # samples, up to which innovations are looked at,
PART = 4  # of a log at most, of which there are too few pairs further apart


@dataclass(frozen=True)
class Whiteness:
    """Innovations of one coordinate, each over the standard deviation that the observer expects.

    `rms` is their root mean square in the coordinate's unit; `variance` should be 1; `first` is the correlation of one
    with the next, `largest` the largest up to 20 samples or a quarter of all apart, at `lag`; of white ones 95 % of the
    correlations are within `band`. `portmanteau` is Ljung and Box's sum of their squares, `limit` what 95 % of white
    ones stay below.
    """

    coordinate: str
    samples: int
    rms: float
    variance: float
    first: float
    largest: float
    lag: int
    band: float
    portmanteau: float
    limit: float

    @property
    def white(self) -> bool:
        """Whether the correlations are no more than chance."""
        return self.portmanteau <= self.limit


@dataclass(frozen=True)
class Consistency:
    """Normalised innovations squared, and whiteness.

    `squared` is their mean over all samples, a degree of freedom; that of a consistent observer is within `band` in
    95 % of cases, of as many as `freedom`. `inside` is the share of samples that are no further off than 95 % of those
    of a consistent observer, below that quantile of chi-squared; the first samples, in which nothing is known of the
    state, do not count.
    """

    samples: int
    squared: float
    band: tuple[float, float]
    inside: float
    coordinates: tuple[Whiteness, ...]
    freedom: int

    @property
    def consistent(self) -> bool:
        """Whether the innovations are as large as expected, and white."""
        return self.band[0] <= self.squared <= self.band[1] and all(w.white for w in self.coordinates)

    @property
    def lines(self) -> list[str]:
        """What there is to say, line by line."""
        low, high = self.band
        told = [
            f"normalised innovations squared: {self.squared:.3g} a degree of freedom, {low:.3g} to {high:.3g} if all is"
            f" as assumed; {100 * self.inside:.3g} % of {self.samples} samples within their 95 % intervals"
        ]
        if self.freedom >= TELLING and self.squared < SMALL * low:
            told.append(
                f"innovations are {self.squared**0.5:.2g} times as large as expected: the noise of samples or of the"
                " process is less than assumed, and so are the errors of states"
            )
        for w in self.coordinates:
            said = "white" if w.white else f"not white (Ljung-Box {w.portmanteau:.3g}, limit {w.limit:.3g})"
            told.append(
                f"innovations of {w.coordinate}: {w.rms:.3g} rms, {said}; correlation {w.first:.2g} with the next,"
                f" {w.largest:.2g} at {w.lag} samples, of white ones within {w.band:.2g}"
            )
        return told


def consistency(
    names: Sequence[str],
    innovations: Sequence[FloatArray],
    expected: Sequence[FloatArray],
    squared: Sequence[FloatArray],
) -> Consistency:
    """Return how consistent the innovations of some runs are.

    Args:
        names: of the c coordinates.
        innovations: (N, c) of every run, NaN where there is none.
        expected: (N, c) their standard deviations.
        squared: (N,) innovations in units of their covariance, summed over the coordinates of a sample.
    """
    freedom = np.concatenate([np.isfinite(e).sum(axis=1) for e in innovations])
    every = np.concatenate(list(squared))[freedom > 0]
    freedom = freedom[freedom > 0]
    total = max(int(freedom.sum()), 1)
    tails = np.array([0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    low, high = (chdtri(total, 1.0 - tails) / total).tolist()
    bounds = chdtri(np.arange(1, len(names) + 1), 1.0 - LEVEL)
    inside = float(np.mean(every <= bounds[freedom - 1])) if len(every) else float("nan")
    channels = [
        _whiteness(name, [e[:, k] for e in innovations], [s[:, k] for s in expected]) for k, name in enumerate(names)
    ]
    return Consistency(len(every), float(every.sum()) / total, (low, high), inside, tuple(channels), total)


def _whiteness(name: str, innovations: Sequence[FloatArray], expected: Sequence[FloatArray]) -> Whiteness:
    """Return the whiteness of one coordinate; pairs of samples of which one was not measured do not count."""
    scaled = [e / s for e, s in zip(innovations, expected, strict=True)]
    there = np.concatenate([e[np.isfinite(e)] for e in scaled])
    count = len(there)
    variance = float(np.mean(there**2)) if count else float("nan")
    lags = max(min(LAGS, count // PART), 1)
    correlations, portmanteau = np.zeros(lags), 0.0
    for lag in range(1, lags + 1):
        one, other = (np.concatenate([*parts, np.empty(0)]) for parts in _apart(scaled, lag))
        both = np.isfinite(one) & np.isfinite(other)
        size = float(np.linalg.norm(one[both]) * np.linalg.norm(other[both]))
        if size > 0.0:
            correlations[lag - 1] = one[both] @ other[both] / size
            portmanteau += (count + 2) / count * np.count_nonzero(both) * correlations[lag - 1] ** 2
    largest = int(np.argmax(np.abs(correlations)))
    raw = np.concatenate([e[np.isfinite(e)] for e in innovations])
    return Whiteness(
        coordinate=name,
        samples=count,
        rms=float(np.sqrt(np.mean(raw**2))) if count else float("nan"),
        variance=variance,
        first=float(correlations[0]),
        largest=float(correlations[largest]),
        lag=largest + 1,
        band=float(ndtri(0.5 + 0.5 * LEVEL)) / max(count, 1) ** 0.5,
        portmanteau=portmanteau,
        limit=float(chdtri(lags, 1.0 - LEVEL)),
    )


def _apart(scaled: Sequence[FloatArray], lag: int) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the innovations (N,) of every run less the last few, and those as many samples later."""
    long = [e for e in scaled if len(e) > lag]
    return [e[:-lag] for e in long], [e[lag:] for e in long]
