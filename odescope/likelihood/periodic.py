"""A residual that is periodic in time: a forcing that was not recorded.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.suspicion import rates

SHARE = 0.4  # least share of what the terms of a relation leave of its target
LEAST = 3.0  # periods in a recording
FINE = 4  # times as fine as one more period in the longest recording are the rates that are compared
DENSE = 8  # averages in a period, at least
ROUNDING = 1e-9
INDEPENDENT = 1e-6  # of all that a sine and a cosine could take away
MANY = 5  # times as many averages as terms a recording must have


@dataclass(frozen=True)
class Line:
    """A rate in rad/s at which a relation's residual goes, known to within `width`, and the share of it that does."""

    relation: int
    rate: float
    width: float
    share: float


def periodic(space: SearchSpace, found: Fit) -> Line | None:
    """Return the rate at which residuals go most, None where no relation's does.

    Each recording has a phase of its own, and coefficients of its own for the terms that the model has.
    """
    segments = space.segments
    longest = max(high - low for low, high in segments.runs)
    # One grid of rates for all recordings.
    length = 2 ** int(np.ceil(np.log2(FINE * longest)))
    rate = 2.0 * np.pi * np.arange(length // 2 + 1) / (length * segments.step)
    duration = longest * segments.step
    seen = (rate > 2.0 * np.pi * LEAST / duration) & (rate < 2.0 * np.pi / (DENSE * segments.step))
    if not seen.any():
        return None
    lines = [line for r in range(space.relations) if (line := _strongest(space, found, r, length, rate, seen))]
    best = max(lines, key=lambda line: line.share, default=None)
    return best if best is not None and best.share > SHARE else None


def _strongest(
    space: SearchSpace, found: Fit, relation: int, length: int, rate: FloatArray, seen: np.ndarray
) -> Line | None:
    """Return the strongest line of a relation's residual.

    Args:
        space: data and candidates.
        found: the model.
        relation: its number.
        length: of the transform.
        rate: (length / 2 + 1,) in rad/s.
        seen: (length / 2 + 1,) which of these are compared.
    """
    total, explained, longest = 0.0, np.zeros(int(seen.sum())), 0
    for left, known in _recordings(space, found, relation):
        total += float(left @ left)
        explained += _explained(left, known, length)[seen]
        longest = max(longest, len(left))
    if not total > 0.0:
        return None
    place = int(np.argmax(explained))
    width = 2.0 * np.pi / (longest * space.segments.step)
    return Line(relation, float(rate[seen][place]), width, float(explained[place]) / total)


def _recordings(space: SearchSpace, found: Fit, relation: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield of every recording what a relation's terms leave of its target (N,), and an orthonormal basis of them."""
    target = rates(space)[relation]
    parts = [p.product for k in found.present for p in space.mechanisms[k].parts if p.relation == relation]
    terms = [p.term for p in parts if p.factor is None]
    columns = np.vstack([np.ones_like(target), *space.evaluated(terms, found.theta)])
    for low, high in space.segments.runs:
        if high - low > MANY * len(columns):
            own = columns[:, low:high]
            known, sizes, _ = np.linalg.svd((own / np.maximum(np.linalg.norm(own, axis=1), 1e-300)[:, None]).T, False)
            known = known[:, sizes > ROUNDING * sizes[0]]
            left = target[low:high]
            yield left - known @ (known.T @ left), known


def _explained(left: FloatArray, known: FloatArray, length: int) -> FloatArray:
    """Return the squares that a sine and a cosine of each rate take away beside what is known.

    Args:
        left: (N,) orthogonal to what is known.
        known: (N, k) an orthonormal basis.
        length: of the transform.
    """
    count, spectrum = len(left), np.fft.rfft(left, length)
    # Sums of cos^2, sin^2 and their product over the samples, from those of exp(-2 i w t).
    phase = np.exp(-4j * np.pi * np.arange(length // 2 + 1) / length)
    with np.errstate(invalid="ignore", divide="ignore"):
        doubled = np.where(np.abs(1.0 - phase) > ROUNDING, (1.0 - phase**count) / (1.0 - phase), count)
    cc, ss, cs = 0.5 * (count + doubled.real), 0.5 * (count - doubled.real), -0.5 * doubled.imag
    for column in known.T:
        other = np.fft.rfft(column, length)
        cc -= other.real**2
        ss -= other.imag**2
        cs += other.real * other.imag
    c, s = spectrum.real, -spectrum.imag
    determinant = cc * ss - cs**2
    sound = determinant > INDEPENDENT * count**2
    result = np.zeros(length // 2 + 1)
    result[sound] = ((ss * c**2 - 2.0 * cs * c * s + cc * s**2) / np.where(sound, determinant, 1.0))[sound]
    return result
