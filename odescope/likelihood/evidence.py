"""What the record says about every term: scores, variances, and what it could not have shown.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.likelihood.expansion import scaled
from odescope.likelihood.fit import Fit
from odescope.likelihood.gauge import SINGULAR
from odescope.likelihood.search_space import SearchSpace

TOLD_APART = 1e-6  # share of a candidate's information that the present terms leave to it, at least


@dataclass(frozen=True, eq=False)
class Projection:
    """What is left of absent candidates once the present ones have explained what they can.

    Shapes, for p present and a absent candidates, all in units of `scale` (f,), the root of their information: inverse
    (p, p) of the information of the present; influence (b, p) what the gradient of each block adds to their estimates;
    stand_in (p, a) the combination of the present that comes nearest to each absent candidate; left (a,) the share of
    an absent candidate's information; slopes (b, a) gradients with respect to the absent.
    """

    scale: FloatArray
    inverse: FloatArray
    influence: FloatArray
    stand_in: FloatArray
    left: FloatArray
    slopes: FloatArray

    @property
    def told(self) -> BoolArray:
        """Whether the data can tell an absent candidate from the present ones, (a,)."""
        told: BoolArray = self.left > TOLD_APART
        return told

    @property
    def variances(self) -> FloatArray:
        """Variances of the estimates (p,): those of the information, or those that the blocks show if these are larger.

        A single block shows none.
        """
        own: FloatArray = np.diag(self.inverse)
        return own if len(self.influence) < 2 else np.maximum(own, between(self.influence))

    @np.errstate(over="ignore")  # of candidates that cannot be told apart, which have none
    def scores(self, spread: FloatArray) -> FloatArray:
        """Return the score statistics (a,), each chi-squared with one degree of freedom.

        Args:
            spread: variances of the slopes (a,).
        """
        return np.where(self.told, self.slopes.sum(axis=0) ** 2 / np.maximum(spread, 1e-300), 0.0)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of candidates that cannot be told apart
def project(information: FloatArray, gradients: FloatArray, here: BoolArray) -> Projection:
    """Return what the present candidates leave of the absent ones.

    Args:
        information: (f, f) of all candidates, initial states eliminated.
        gradients: (b, f) of blocks of the record, which sum to the whole.
        here: (f,) which candidates are present.
    """
    correlations, scale = scaled(information)
    slopes = gradients / scale
    values, vectors = np.linalg.eigh(correlations[np.ix_(here, here)])
    # What two terms cannot be told apart by is rounding, of either sign: large variances, never negative or small ones.
    inverse = (vectors / np.maximum(values, SINGULAR * values.max(initial=0.0))) @ vectors.T
    cross = correlations[np.ix_(here, ~here)]
    influence = slopes[:, here] @ inverse
    stand_in = inverse @ cross
    left = np.diag(correlations)[~here] - np.einsum("ij,ij->j", cross, stand_in)
    return Projection(scale, inverse, influence, stand_in, left, slopes[:, ~here] - influence @ cross)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Shapes: scores (mechanisms,) of the absent ones, wald and variances (p,), correlation (p, p) of the parameters.

    limits (mechanisms,) are the coefficients from which on an absent one is likely to be detected: infinite where the
    data cannot tell it from the present ones, 0 where it is present or held.
    """

    scores: FloatArray
    wald: FloatArray
    variances: FloatArray
    correlation: FloatArray
    limits: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters, (p, p)."""
        errors = np.sqrt(self.variances)
        covariance: FloatArray = self.correlation * errors * errors[:, None]
        return covariance


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def weigh(space: SearchSpace, found: Fit, information: FloatArray, blocks: FloatArray) -> Evidence:
    """Return the evidence in a reduced information matrix, checked against the spread between blocks of the record.

    Args:
        space: candidates and their penalties.
        found: a fit of some of them.
        information: (f, f) of all that may be parameters, initial states eliminated.
        blocks: (b, f) gradients of the blocks of the record, which sum to the whole; a single row is no check.
    """
    free = space.free(found)
    here = np.isin(free, found.free)
    rest = project(information, blocks, here)
    spread = np.maximum(rest.left, 1e-300)
    if len(blocks) > 1:
        spread = np.maximum(spread, between(rest.slopes))
    variances = rest.variances / rest.scale[here] ** 2
    scores, limits = np.zeros(len(space.mechanisms)), np.zeros(len(space.mechanisms))
    scores[free[~here]] = rest.scores(spread)
    reach = np.sqrt(space.penalty[free[~here]] * spread) / np.maximum(rest.left, 1e-300) / rest.scale[~here]
    limits[free[~here]] = np.where(rest.told, reach, np.inf)
    diagonal = np.sqrt(np.maximum(np.diag(rest.inverse), 1e-300))
    return Evidence(
        scores,
        found.theta[free[here]] ** 2 / np.maximum(variances, 1e-300),
        variances,
        np.clip(rest.inverse / np.outer(diagonal, diagonal), -1.0, 1.0),
        limits,
    )


def in_blocks(contributions: FloatArray) -> FloatArray:
    """Return the sums (b, k) of contributions (J, k) over square-root-many blocks of neighbours."""
    edges = np.linspace(0, len(contributions), int(np.sqrt(len(contributions))) + 1).astype(np.int64)
    sums: FloatArray = np.add.reduceat(contributions, edges[:-1], axis=0)
    return sums


def between(blocks: FloatArray) -> FloatArray:
    """Return the variance of the sum of blocks (b, k), from how they differ from their mean.

    It is infinite where a model runs away in one of them.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        variance: FloatArray = len(blocks) * blocks.var(axis=0, ddof=1)
    return np.where(np.isnan(variance), np.inf, variance)
