"""The expansion of the cost about parameters, initial states eliminated, exact where parameters are nearly alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtrs

from odescope.arrays import BoolArray, FloatArray
from odescope.likelihood.block_cholesky import factorise
from odescope.likelihood.kernel import Sums

ROUNDING = 1e-14  # of a matrix of correlations, for each of its rows
DIFFERENT = 0.01  # share of a parameter's effect that others do not have, of which rounding takes nothing
LEAST = 1e-200  # information about a coefficient: what rounding leaves of none can be negative


@dataclass(frozen=True, eq=False)
class Expansion:
    """Cost and its quadratic expansion after the initial states are eliminated.

    Shapes: information (p, p) reduced Gauss-Newton matrix, gradient (p,) reduced; both of half the cost; factor
    (J, n, n), border (J, n, p + 1) and carry (J, n, n) are what the states follow from, log_det is that of their block.
    """

    data_cost: float
    defect_cost: float
    information: FloatArray
    gradient: FloatArray
    log_det: float
    factor: FloatArray
    border: FloatArray
    carry: FloatArray

    @property
    def cost(self) -> float:
        """Data and defects together."""
        return self.data_cost + self.defect_cost

    @property
    def finite(self) -> bool:
        """Whether no sensitivity overflowed."""
        return bool(np.isfinite(self.information).all() and np.isfinite(self.gradient).all())


def scaled(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the information as correlations, and the scale of each coefficient, its square root."""
    scale = np.sqrt(np.maximum(np.diag(information), LEAST))
    with np.errstate(over="ignore"):  # two coefficients of which the data say nothing: rounding over next to nothing
        correlations: FloatArray = np.clip(information / scale / scale[:, None], -1.0, 1.0)
    return correlations, scale


@np.errstate(over="ignore", invalid="ignore")  # of segments that ran away
def decorrelated(sums: Sums, x0: FloatArray, decorrelation: FloatArray | None) -> tuple[Sums, FloatArray]:
    """Return sums and initial states (J, n) of the states R x instead of x, whose defects are independent.

    Args:
        sums: of the kernel.
        x0: (J, n) initial states.
        decorrelation: R (n, n), None where the defects of the states are independent.
    """
    if decorrelation is None:
        return sums, x0
    back = np.asarray(np.linalg.inv(decorrelation.T), dtype=np.float64)
    moved = sums._replace(
        gradient=_mixed(back, sums.gradient),
        hessian=_mixed(back, _mixed(back, sums.hessian).swapaxes(1, 2)).swapaxes(1, 2),
        last=_mixed(decorrelation, sums.last),
        jacobian=_mixed(decorrelation, _mixed(back, sums.jacobian.swapaxes(1, 2)).swapaxes(1, 2)),
    )
    return moved, _mixed(decorrelation, x0)


def _mixed(parts: FloatArray, stack: FloatArray) -> FloatArray:
    """Return parts (n, n) times the first n rows of each array in a stack (J, n or more, ...), laid out alike.

    Parts have ones on the diagonal and little beside it: to add rows takes half the time of J products.
    """
    mixed, more = stack.copy(order="K"), parts - np.eye(len(parts))
    for row, other in np.argwhere(more).tolist():
        mixed[:, row] += more[row, other] * stack[:, other]
    return mixed


@np.errstate(over="ignore", invalid="ignore")  # of segments that ran away
def correlated(change: FloatArray, decorrelation: FloatArray | None) -> FloatArray:
    """Return the change (J, n) of the states x for one of R x."""
    if decorrelation is None:
        return change
    own: FloatArray = change @ np.linalg.inv(decorrelation).T
    return own


def _defects(sums: Sums, x0: FloatArray, joined: BoolArray, defect_std: FloatArray) -> FloatArray:
    """Return the defects between segments (J, n), in standard deviations, none behind one that is not joined."""
    found = np.zeros_like(x0)
    found[:-1] = np.where(joined[:-1, None], (sums.last[:-1] - x0[1:]) / defect_std, 0.0)
    return found


@np.errstate(over="ignore", invalid="ignore")  # of segments that ran away
def costs(sums: Sums, x0: FloatArray, joined: BoolArray, defect_std: FloatArray) -> tuple[float, float] | None:
    """Return the cost of the data and that of the defects.

    None where a segment or a sensitivity ran away, or the states' block is not positive definite: there is no expansion
    there, and this costs less than to try one.

    Args:
        sums: of the kernel.
        x0: (J, n) initial states.
        joined: (J,) whether the end of a segment is tied to the start of the next.
        defect_std: (n,) the defect between them is weighted by 1 / defect_std^2 a state.
    """
    if not all(np.isfinite(part.sum()) for part in sums):
        return None
    defect, none = _defects(sums, x0, joined, defect_std), np.empty((*x0.shape, 0))
    positive = factorise(sums, joined, defect_std, 0.0, none, none, defect)[-1]
    return (float(sums.cost.sum()), float(np.sum(defect**2))) if positive else None


@np.errstate(over="ignore", invalid="ignore")  # of segments that ran away
def eliminate(
    sums: Sums, x0: FloatArray, joined: BoolArray, defect_std: FloatArray, damping: float
) -> Expansion | None:
    """Eliminate the initial states, by block-tridiagonal Cholesky with the parameters as border.

    None where the states' block is not positive definite. Segments that are tied closely bring large numbers that
    cancel: the rounding of what 1, T and T^2 have in common at 300 K would be more than what tells them apart. So
    parameters are replaced meanwhile by combinations that segments tell apart: their matrix L L^T, before anything is
    eliminated, becomes the unit matrix.

    Args:
        sums: of the kernel.
        x0: (J, n) initial states.
        joined: (J,) whether the end of a segment is tied to the start of the next.
        defect_std: (n,) the defect between them is weighted by 1 / defect_std^2 a state.
        damping: added to 1 it multiplies the diagonal (Levenberg-Marquardt).
    """
    segments, n = x0.shape
    defect, tied = _defects(sums, x0, joined, defect_std), np.where(joined[:, None], 1.0 / defect_std, 0.0)
    inner, cross, along = sums.inner, sums.hessian[:, :, n:], tied[:, :, None] * sums.jacobian[:, :, n:]
    slope, apart = sums.gradient[:, n:].sum(axis=0), along.reshape(segments * n, -1)
    whole = inner + apart.T @ apart
    finite = np.isfinite(np.diag(whole))
    if not finite.all():  # what runs away spoils no other
        inner, whole = (np.where(finite & finite[:, None], part, 0.0) for part in (inner, whole))
        cross, along, slope = (np.where(finite, part, 0.0) for part in (cross, along, slope))
    basis = _basis(whole)
    cross, along, slope = _combined(basis, cross), _combined(basis, along), _combined(basis, slope)
    log_det, factor, border, carry, positive = factorise(sums, joined, defect_std, damping, cross, along, defect)
    if not positive:
        return None
    damped = _combined(basis, _combined(basis, inner + damping * np.diag(np.diag(whole))).T)
    apart, known = along.reshape(segments * n, -1), border.reshape(segments * n, -1)
    taken = known.T @ known
    information = damped + apart.T @ apart - taken[:-1, :-1]
    gradient = slope + apart.T @ defect.ravel() - taken[:-1, -1]
    if basis is not None:
        known[:, :-1] = known[:, :-1] @ basis.T
        information, gradient = basis @ information @ basis.T, basis @ gradient
    gradient[~finite] = information[~finite] = information[:, ~finite] = np.nan
    cost = float(np.sum(defect**2))
    return Expansion(float(sums.cost.sum()), cost, information, gradient, log_det, factor, border, carry)


def _basis(information: FloatArray) -> FloatArray | None:
    """Return L (p, p), lower triangular, such that L L^T is the information (p, p) but for rounding.

    None where parameters are so different that rounding is nothing to them, or where there is more of it than expected.
    """
    correlations, scale = scaled(information)
    p = len(scale)
    try:
        factor = np.linalg.cholesky(correlations + (p * ROUNDING + (scale**2 <= LEAST)) * np.eye(p))
    except np.linalg.LinAlgError:
        return None
    return None if np.diag(factor).min(initial=1.0) > DIFFERENT else scale[:, None] * factor


def _combined(basis: FloatArray | None, slopes: FloatArray) -> FloatArray:
    """Return derivatives (..., p) with respect to the combinations L^T theta of parameters, from those to theta."""
    if basis is None:
        return np.ascontiguousarray(slopes)
    flat = slopes.reshape(-1, slopes.shape[-1])
    solved: FloatArray = dtrtrs(basis.T, flat.T, lower=0, trans=1)[0]
    return np.ascontiguousarray(solved.T).reshape(slopes.shape)
