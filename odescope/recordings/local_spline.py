"""A smooth function through the samples of one column, wherever they lie: a cubic spline of least squares."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odescope.arrays import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

SPACINGS = (2, 3, 4, 6, 8, 12, 16, 24, 32)  # samples between knots that are tried
TRIED = 20_000  # samples on which the spacing is chosen: what suits them suits the rest
DEGREE = 3
APART = 0.5  # of their mean distance: knots that are nearer are left out
ROUNDING = 1e-9  # of that distance: whether even ones are as far apart is no matter of the unit of time
RIDGE = 1e-12  # of the diagonal: samples that almost coincide must not stop the factorisation
FEW = 2 * (DEGREE + 1)  # samples of which no spline can be fitted: a line goes through them


def fit_smooth(t: FloatArray, values: FloatArray, weights: FloatArray) -> BSpline:
    """Return the cubic spline of least squares with a knot every few samples.

    How many is decided by generalised cross-validation, N RSS / (N - p)^2: a smooth column takes few knots and lets
    hardly any noise into the spline, a rough one takes many. Knots are samples, so there is none in a gap.

    Args:
        t: (n,) strictly increasing; through one sample goes a constant, through a few a line.
        values: (n,) samples.
        weights: (n,) over the variance of each.
    """
    if len(t) < FEW:
        return _line(t, values, weights)
    tried = slice(0, TRIED)
    fits = [_fitted(t[tried], values[tried], weights[tried], s) for s in SPACINGS if len(t[tried]) >= 2 * s]
    spacing = SPACINGS[int(np.argmin([score for _, score in fits]))]
    return _fitted(t, values, weights, spacing)[0]


def fit_between(t: FloatArray, values: FloatArray, like: BSpline) -> BSpline:
    """Return the spline of least squares of other values, with the knots of one that is known.

    Args:
        t: (n,) strictly increasing, those of the other.
        values: (n,) what it is to be near.
        like: whose knots it has.
    """
    weights = np.ones(len(t))
    return _line(t, values, weights) if like.k < DEGREE else _through(t, values, weights, like.t)


def fit_beside(
    t: FloatArray, values: FloatArray, weights: FloatArray, beside: FloatArray
) -> tuple[BSpline, FloatArray]:
    """Return a cubic spline and the coefficients (r,) of what is not smooth, which add up to the samples.

    Args:
        t: (n,) strictly increasing.
        values: (n,) samples.
        weights: (n,) over the variance of each.
        beside: (n, r) what the samples may hold beside a smooth function.
    """
    if len(t) < FEW:
        return _line(t, values, weights), np.zeros(beside.shape[1])

    def fitted(kept: slice, spacing: int) -> tuple[BSpline, float, FloatArray]:
        x, y, w, u = t[kept], values[kept], weights[kept], beside[kept]
        rest = np.column_stack([c - _fitted(x, c, w, spacing)[0](x) for c in (y, *u.T)]) * np.sqrt(w)[:, None]
        size = np.maximum(np.sqrt(np.sum(rest[:, 1:] ** 2, axis=0)), 1e-300)
        share = np.linalg.lstsq(rest[:, 1:] / size, rest[:, 0], rcond=1e-6)[0] / size
        return *_fitted(x, y - u @ share, w, spacing), share

    tried = slice(0, TRIED)
    spacings = [s for s in SPACINGS if len(t[tried]) >= 2 * s]
    spline, _, share = fitted(slice(None), min(spacings, key=lambda s: fitted(tried, s)[1]))
    return spline, share


def _line(t: FloatArray, values: FloatArray, weights: FloatArray) -> BSpline:
    from scipy.interpolate import BSpline

    slope, height = np.polyfit(t - t[0], values, 1, w=np.sqrt(weights)) if len(t) > 1 else (0.0, values[0])
    span = t[-1] - t[0] if len(t) > 1 else 1.0
    ends = np.array([height, height + slope * span])
    return BSpline(np.array([t[0], t[0], t[0] + span, t[0] + span]), ends, 1)


def _apart(knots: FloatArray, ends: tuple[float, float], distance: float) -> FloatArray:
    """Return knots at least so far from each other and from the ends.

    Between two of a burst of samples the noise would set the slope, and beyond a burst at an end the curve would go
    anywhere: a solver begins with steps that are ten times as long as the ones before.
    """
    between, distance = np.concatenate([[ends[0]], knots, [ends[1]]]), distance * (1.0 - ROUNDING)
    if np.diff(between).min() >= distance:
        return knots
    kept = [ends[0]]
    for knot in knots.tolist():
        if knot - kept[-1] >= distance and ends[1] - knot >= distance:
            kept.append(knot)
    return np.array(kept[1:])


def _fitted(t: FloatArray, values: FloatArray, weights: FloatArray, spacing: int) -> tuple[BSpline, float]:
    """Return the spline with a knot every `spacing` samples, and its cross-validation score."""
    first, last = float(t[0]), float(t[-1])
    inner = _apart(
        t[spacing : len(t) - spacing + 1 : spacing], (first, last), APART * spacing * (last - first) / (len(t) - 1)
    )
    knots = np.concatenate([np.repeat(first, DEGREE + 1), inner, np.repeat(last, DEGREE + 1)])
    spline = _through(t, values, weights, knots)
    rest = float(np.sum(weights * (values - spline(t)) ** 2))
    return spline, rest / max(len(t) - len(spline.c), 1) ** 2


def _through(t: FloatArray, values: FloatArray, weights: FloatArray, knots: FloatArray) -> BSpline:
    """Return the cubic spline of least squares with these knots.

    Args:
        t: (n,) strictly increasing.
        values: (n,) samples.
        weights: (n,) over the variance of each.
        knots: those at the ends four times.
    """
    from scipy.interpolate import BSpline
    from scipy.linalg import solveh_banded

    count = len(knots) - DEGREE - 1
    basis = BSpline.design_matrix(t, knots, DEGREE)
    rows = basis.data.reshape(len(t), DEGREE + 1)
    place = basis.indices.reshape(len(t), DEGREE + 1)[:, 0]
    gram, right = np.zeros((DEGREE + 1, count)), np.zeros(count)
    for i in range(DEGREE + 1):
        right += np.bincount(place + i, weights * rows[:, i] * values, count)
        for k in range(DEGREE + 1 - i):
            gram[k] += np.bincount(place + i, weights * rows[:, i] * rows[:, i + k], count)
    gram[0] *= 1.0 + RIDGE
    return BSpline(knots, solveh_banded(gram, right, lower=True), DEGREE)
