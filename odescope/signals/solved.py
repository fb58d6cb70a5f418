"""Logs that a solver wrote: between its steps they are polynomials, and what it errs by is no noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray, true_ranges
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Records

DEGREE = 4  # of what RK45 writes between its steps (Dormand and Prince 1980; Shampine 1986)
ROUNDING = 64.0 * np.finfo(np.float64).eps  # of the largest value: what is left of differences that vanish
CLEAR = 1e3  # times that: differences that do not
TOLD = 20_000  # samples of a recording: a solver writes all of it, or none
PIECES = 3  # polynomials, at least
SHARE = 0.1  # of the differences that vanish, at least
LOOSE = 1e-6  # standard deviations a step: with a tolerance of 1e-9 a solver errs by far less
COARSE = 0.1  # the same: what jumps further is a counter, or a motion in strokes
ERROR = 1.0 / 16.0  # of a step, over the jump of its second derivative times its time squared: within six times


def solver_hints(records: Records, coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return what to say of coordinates that a solver with a loose tolerance wrote; nothing of what was measured.

    Args:
        records: uniformly sampled.
        coordinates: in them.
    """
    looked_at = {c.name: [run.column(c.name)[:TOLD] for run in records] for c in coordinates}
    found = {name: of for name, columns in looked_at.items() if (of := _pieces(columns)) is not None}
    if not found:
        return ()
    samples, error = (max(of[k] for of in found.values()) for k in range(2))
    step = samples * records.runs[0].sample_period
    return (
        f"{', '.join(found)} {'runs' if len(found) == 1 else 'run'} along polynomials of degree {DEGREE}, each"
        f" {step:.2g} s long, as a solver writes between its steps: what it errs by, some {error:.1g} standard"
        " deviations a step, is no noise and may look like terms; solve again with a relative tolerance of 1e-9"
        " (solve_ivp: rtol=1e-9, atol=1e-12)",
    )


def _pieces(columns: Sequence[FloatArray]) -> tuple[float, float] | None:
    """Return how many samples (N,) a polynomial has, and what a solver errs by; None where these are none, or exact.

    The error is told from the jumps between polynomials: of the second derivative, which is the lowest that jumps.
    """
    whole = np.concatenate(columns)
    rounding, spread = ROUNDING * float(np.abs(whole).max()), float(whole.std())
    fourth = np.concatenate([np.abs(np.diff(y, DEGREE))[:-1] for y in columns])
    fifth = np.concatenate([np.abs(np.diff(y, DEGREE + 1)) for y in columns])
    along = (fifth <= rounding) & (fourth > CLEAR * rounding)
    across = fifth > CLEAR * rounding
    pieces = len(true_ranges(across))
    if pieces < PIECES or np.mean(along) < SHARE:
        return None
    samples = len(whole) / pieces
    error = float(np.sqrt(np.mean(fifth**2))) * samples**2 * ERROR / spread
    return (samples, error) if LOOSE < error < COARSE else None
