"""What the record says about every term: scores, variances, and what it could not have shown (METHOD section 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.fit import SINGULAR, Fit
from odescope.likelihood.search import Searcher

TOLD_APART = 1e-6  # share of a candidate's information that the present terms leave to it, at least


@dataclass(frozen=True, eq=False)
class Evidence:
    """Shapes: scores (slots,) of the absent terms, wald and variances (p,) and correlation (p, p) of the present ones.

    limits (slots,) are the coefficients from which on an absent term is likely to be detected: infinite where the data
    cannot tell it from present terms, 0 where a term is present or fixed.
    """

    scores: FloatArray
    wald: FloatArray
    variances: FloatArray
    correlation: FloatArray
    limits: FloatArray


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of candidates that cannot be told apart
def weigh(searcher: Searcher, found: Fit, information: FloatArray, blocks: FloatArray) -> Evidence:
    """Return the evidence in a reduced information matrix, checked against the spread between blocks of the record.

    Args:
        searcher: candidates and their prices.
        found: a fit of some of them.
        information: (f, f) of all free slots, initial states eliminated.
        blocks: (b, f) gradients of the blocks of the record, which sum to the whole; a single row is no check.
    """
    free = searcher.free
    here = np.isin(free, found.present)
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled, slopes = information / np.outer(scale, scale), blocks / scale
    values, vectors = np.linalg.eigh(scaled[np.ix_(here, here)])
    # What two terms cannot be told apart by is rounding, of either sign: large variances, never negative or small ones.
    inverse = (vectors / np.maximum(values, SINGULAR * values.max(initial=0.0))) @ vectors.T
    cross = scaled[np.ix_(here, ~here)]
    influence = slopes[:, here] @ inverse
    left = np.diag(scaled)[~here] - np.einsum("ij,ij->j", cross, inverse @ cross)
    projected = slopes[:, ~here] - influence @ cross
    own, spread = np.diag(inverse), np.maximum(left, 1e-300)
    if len(blocks) > 1:
        own = np.maximum(own, between(influence))
        spread = np.maximum(spread, between(projected))
    variances = own / scale[here] ** 2
    told = left > TOLD_APART
    scores, limits = np.zeros(len(searcher.slots)), np.zeros(len(searcher.slots))
    scores[free[~here]] = np.where(told, projected.sum(axis=0) ** 2 / spread, 0.0)
    reach = np.sqrt(searcher.price[free[~here]] * spread) / np.maximum(left, 1e-300) / scale[~here]
    limits[free[~here]] = np.where(told, reach, np.inf)
    diagonal = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    return Evidence(
        scores,
        found.theta[free[here]] ** 2 / np.maximum(variances, 1e-300),
        variances,
        np.clip(inverse / np.outer(diagonal, diagonal), -1.0, 1.0),
        limits,
    )


def in_blocks(contributions: FloatArray) -> FloatArray:
    """Return the sums (b, k) of contributions (J, k) over square-root-many blocks of neighbours."""
    edges = np.linspace(0, len(contributions), int(np.sqrt(len(contributions))) + 1).astype(np.int64)
    sums: FloatArray = np.add.reduceat(contributions, edges[:-1], axis=0)
    return sums


def between(blocks: FloatArray) -> FloatArray:
    """Return the variance of the sum of blocks (b, k), from how they differ from their mean."""
    variance: FloatArray = len(blocks) * blocks.var(axis=0, ddof=1)
    return variance
