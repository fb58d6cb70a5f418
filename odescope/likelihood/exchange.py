"""What becomes of cost and coefficients where mechanisms come, go or take each other's place, to second order.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.likelihood.evidence import TOLD_APART, Projection
from odescope.likelihood.expansion import Expansion, scaled
from odescope.likelihood.gauge import SINGULAR, inverse

FAR = 8  # moves that the expansion of a cost foresees, at most
RUNAWAY = 1e12  # times as large as any: what rounding makes of coefficients


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of coefficients of which the data say nothing
def rise(rest: Projection, theta: FloatArray) -> FloatArray:
    """Return the change of the cost (a, p, p) where absent k comes and present i and j go; i = j: one goes.

    With k present the coefficients are theta - v_k d_k, and their covariance is C + v_k v_k' / l_k: v_k is the
    combination of the present that comes nearest to k, l_k what it leaves of the information of k, d_k the estimate of
    k. There two coefficients t of covariance S cost t' S^-1 t, and k is worth its score.

    Args:
        rest: what the p present mechanisms leave of the a absent ones.
        theta: (p,) coefficients of the present ones, in units of `rest.scale`.
    """
    left = np.maximum(rest.left, SINGULAR)
    # What two add up to has little left of its own, less than a score test asks for; still less would be rounding.
    slope = np.where(rest.left > SINGULAR, rest.slopes.sum(axis=0), 0.0)
    moved = theta + (rest.stand_in * slope / left).T
    covariance = rest.inverse + np.einsum("ik,jk->kij", rest.stand_in, rest.stand_in / left)
    error = np.sqrt(np.maximum(np.einsum("kii->ki", covariance), 1e-300))
    correlation = covariance / (error[:, :, None] * error[:, None, :])
    one, other = (moved / error)[:, :, None], (moved / error)[:, None, :]
    lost = (one**2 + other**2 - 2.0 * correlation * one * other) / np.maximum(1.0 - correlation**2, SINGULAR)
    np.einsum("kii->ki", lost)[...] = one[:, :, 0] ** 2
    change: FloatArray = lost - (slope**2 / left)[:, None, None]
    return change


def refitted(expansion: Expansion, theta: FloatArray, kept: IntArray) -> FloatArray | None:
    """Return the coefficients (f,) of least cost where only some are not zero, None where these are but rounding.

    Args:
        expansion: of the cost about theta, initial states eliminated.
        theta: (f,) coefficients.
        kept: numbers of those that stay.
    """
    found = np.zeros_like(theta)
    found[kept] = theta[kept]
    gradient = expansion.gradient + expansion.information @ (found - theta)
    with np.errstate(over="ignore", invalid="ignore"):  # of coefficients of which the data say nothing
        found[kept] -= inverse(expansion.information[np.ix_(kept, kept)]) @ gradient[kept]
    return found if np.all(np.abs(found) < RUNAWAY * np.abs(theta).max(initial=1.0)) else None


@np.errstate(over="ignore", invalid="ignore")  # runs that grow beyond all bounds foresee nothing
def foreseen(
    expansion: Expansion, theta: FloatArray, present: BoolArray, able: BoolArray, prices: FloatArray, scale: float
) -> BoolArray:
    """Return which coefficients (f,) the expansion of the cost keeps, when they come and go one at a time.

    To second order that asks for no fit: what comes early in the place of others, and goes again, costs nothing. After
    FAR moves the cost is another.

    Args:
        expansion: of the cost about theta, initial states eliminated.
        theta: (f,) coefficients.
        present: (f,) which are in the model.
        able: (f,) which may come or go.
        prices: (f,) what each has to earn.
        scale: of the cost, residual variance.
    """
    information, size = scaled(expansion.information)
    pull, kept = (expansion.information @ theta - expansion.gradient) / size, present.copy()
    for _ in range(FAR):
        covariance = inverse(information[np.ix_(kept, kept)])
        cross = information[np.ix_(~kept, kept)]
        left = 1.0 - np.einsum("ai,ij,aj->a", cross, covariance, cross)
        worth = np.empty(len(theta))
        estimate = covariance @ pull[kept]
        missed = pull[~kept] - cross @ estimate
        earned = np.where(left > TOLD_APART, missed**2 / np.maximum(left, SINGULAR), 0.0)
        worth[kept] = prices[kept] - estimate**2 / np.diag(covariance) / scale
        worth[~kept] = earned / scale - prices[~kept]
        if not np.isfinite(worth).all():
            return present.copy()
        best = int(np.argmax(np.where(able, worth, -np.inf)))
        if not (able[best] and worth[best] > 0.0):
            break
        kept[best] = not kept[best]
    return kept
