"""Proposers of sparse supports for one left-hand side; they propose, the factor computes the coefficients."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import compress
from typing import Annotated, Protocol

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.regression.factor import Factor
from odescope.regression.solve import threshold_supports

Support = tuple[int, ...]

DEPENDENT = 1e-10  # of a unit column left unexplained by the others: they say the same


class Proposer(Protocol):
    """Finds supports: columns that may explain the column `left`; one of one's own needs this method alone."""

    def supports(self, factor: Factor, left: int, columns: Support) -> Iterator[Support]:
        """Yield sorted supports chosen from `columns`, without `left`.

        Args:
            factor: of the library.
            left: the left-hand side.
            columns: where to choose from, ascending.
        """
        ...


def _thresholded(
    factor: Factor,
    left: int,
    columns: Support,
    weight: FloatArray,
    relative: bool,
    options: EnergyThreshold | CoefficientThreshold,
) -> Iterator[Support]:
    if len(columns) < 2:
        return
    high = options.high
    low = options.low if options.low < high else float(np.nextafter(high, 0.0))
    index, first = np.array(columns, dtype=np.int64), factor.first_fit(tuple(columns), left)
    found = threshold_supports(factor.r, factor.gram, index, left, weight, relative, low, high, options.terms, first)
    every = range(factor.width)
    yield from dict.fromkeys(tuple(compress(every, row)) for row in found.tolist())


class EnergyThreshold(
    msgspec.Struct, frozen=True, tag="energy_threshold", tag_field="kind", forbid_unknown_fields=True
):
    """SETLS (paper, 2.2.3) for every ratio lambda_R from `low` to `high` at once; (8), (9).

    Attributes:
        low: the least ratio of a term's energy to the largest. A fixed ratio is `low = high`.
        high: the largest ratio.
        terms: above 0, ratios are walked down from `high` no further than the first support of more terms than that:
            what lies below costs most of the time and is too large to be a law.
    """

    low: Annotated[float, msgspec.Meta(gt=0.0)] = 1e-9
    high: Annotated[float, msgspec.Meta(gt=0.0)] = 0.3
    terms: Annotated[int, msgspec.Meta(ge=0)] = 0

    def supports(self, factor: Factor, left: int, columns: Support) -> Iterator[Support]:
        """Yield the supports of all thresholds; columns of the factor have unit norm, so an energy is a square."""
        return _thresholded(factor, left, columns, np.ones(factor.width), True, self)


class CoefficientThreshold(
    msgspec.Struct, frozen=True, tag="coefficient_threshold", tag_field="kind", forbid_unknown_fields=True
):
    """STLS (paper, 2.2.2) for every threshold of the coefficient itself from `low` to `high` at once.

    Attributes:
        low: the least threshold.
        high: the largest threshold.
        terms: as in `EnergyThreshold`.
    """

    low: Annotated[float, msgspec.Meta(gt=0.0)] = 1e-4
    high: Annotated[float, msgspec.Meta(gt=0.0)] = 10.0
    terms: Annotated[int, msgspec.Meta(ge=0)] = 0

    def supports(self, factor: Factor, left: int, columns: Support) -> Iterator[Support]:
        """Yield the supports of all thresholds."""
        weight = factor.scale[left] / factor.scale
        return _thresholded(factor, left, columns, weight, False, self)


class MatchingPursuit(
    msgspec.Struct, frozen=True, tag="matching_pursuit", tag_field="kind", forbid_unknown_fields=True
):
    """Orthogonal matching pursuit: the path of supports of 1, 2, ... columns.

    Each step takes the column whose part orthogonal to those present explains most (orthogonal least squares): on
    correlated columns the correlation with the residual alone misleads.

    Attributes:
        terms: where the path ends.
    """

    terms: Annotated[int, msgspec.Meta(ge=1)] = 12

    def supports(self, factor: Factor, left: int, columns: Support) -> Iterator[Support]:
        """Yield the path; each step adds the column that, made orthogonal to those present, explains most."""
        rest = [j for j in columns if j != left]
        r = factor.r.copy()
        chosen: list[int] = []
        for _ in range(min(self.terms, len(rest))):
            norms = np.linalg.norm(r[:, rest], axis=0)
            # A column that is nearly a combination of those chosen has no direction of its own left to score.
            scores = np.where(norms > 1e-9, np.abs(r[:, left] @ r[:, rest]) / np.maximum(norms, 1e-300), 0.0)
            best = rest[int(np.argmax(scores))]
            if scores.max() <= 1e-14:
                return
            direction = r[:, best] / np.linalg.norm(r[:, best])
            r -= np.outer(direction, direction @ r)
            chosen.append(best)
            rest.remove(best)
            yield tuple(sorted(chosen))


def exchanged(factor: Factor, left: int, columns: Support, support: Support) -> Support:
    """Return where exchanges of one column for another lead to, each the one that leaves the least residual.

    What a forward selection takes first may stand for what it takes later (sequential replacement, Miller 1984).

    Args:
        factor: of all columns.
        left: the column that is explained.
        columns: those that may be in it.
        support: to begin with.
    """
    here, least = tuple(sorted(support)), np.inf
    while here:
        rest, found = _best_exchange(factor.r, left, columns, here)
        if not rest < least * (1.0 - 1e-9):
            break
        least, here = rest, found
    return here


def _best_exchange(r: FloatArray, left: int, columns: Support, support: Support) -> tuple[float, Support]:
    """Return the least squared residual that one column in the place of another leaves, and the support with it.

    What a support explains without one of its columns is what it explains less what lies along the part of that column
    that is orthogonal to the others: one factorisation serves all that may go.

    Args:
        r: (k, m) triangle of all columns.
        left: the column that is explained.
        columns: those that may come, those of the support among them.
        support: now, not empty.
    """
    able, gone = np.array([j for j in columns if j != left]), np.array(support)
    q, triangle = np.linalg.qr(r[:, gone])
    alone = q @ np.linalg.pinv(triangle).T  # its k-th column is orthogonal to all of the support but its k-th
    alone /= np.maximum(np.linalg.norm(alone, axis=0), 1e-300)
    others, y = r[:, able] - q @ (q.T @ r[:, able]), r[:, left] - q @ (q.T @ r[:, left])
    along, y_along = alone.T @ r[:, able], alone.T @ r[:, left]
    squares, products = np.sum(others**2, axis=0) + along**2, y @ others + y_along[:, None] * along
    explained = np.where(squares > 1e-18, products**2 / np.maximum(squares, 1e-300), 0.0)
    explained[np.isin(able, gone) & (able != gone[:, None])] = -np.inf
    rests = y @ y + y_along**2 - explained.max(axis=1)
    k = int(np.argmin(rests))
    kept, comes = np.delete(gone, k).tolist(), int(able[np.argmax(explained[k])])
    # Of an exact fit rounding leaves either sign, and what is below zero is less than a share of itself.
    return max(float(rests[k]), 0.0), tuple(sorted((*kept, comes)))


def _independent(factor: Factor, columns: list[int]) -> list[int]:
    """Return the columns less those that combine columns before them, which would split a coefficient among them."""
    r = factor.r[:, columns]
    if np.linalg.matrix_rank(r, tol=DEPENDENT) == len(columns):
        return columns
    dropped = {k for k, _ in Factor(r, factor.scale[columns], factor.rows).dependent(DEPENDENT)}
    return [j for k, j in enumerate(columns) if k not in dropped]


class BackwardElimination(
    msgspec.Struct, frozen=True, tag="backward_elimination", tag_field="kind", forbid_unknown_fields=True
):
    """Backward elimination: the path from all columns down to one, dropping what costs least.

    Attributes:
        terms: how many a support that is proposed has at most.
    """

    terms: Annotated[int, msgspec.Meta(ge=1)] = 15

    def supports(self, factor: Factor, left: int, columns: Support) -> Iterator[Support]:
        """Yield the path; the cost of dropping column j is x_j^2 / [(R'R)^-1]_jj."""
        support = _independent(factor, [j for j in columns if j != left])
        inverse = np.linalg.pinv(factor.r[:, support])
        x, variance = inverse @ factor.r[:, left], inverse @ inverse.T
        while support:
            if len(support) <= self.terms:
                yield tuple(support)
            j = int(np.argmin(x**2 / np.maximum(np.diag(variance), 1e-300)))
            column = variance[:, j] / variance[j, j]
            x, variance = x - column * x[j], variance - np.outer(column, variance[j])
            x, variance = np.delete(x, j), np.delete(np.delete(variance, j, 0), j, 1)
            del support[j]


class NullSpace(msgspec.Struct, frozen=True, tag="null_space", tag_field="kind", forbid_unknown_fields=True):
    """Implicit SINDy (paper, 2.3; Mangan et al. 2016): the sparsest vectors of the near-null space of (14).

    Alternating directions: soft-threshold a unit vector in the null space, project back, from every row of it.

    Attributes:
        ratios: the thresholds relative to the largest entry.
        gap: ends the null space at that multiple of the least singular value.
        iterations: of the alternation, at most.
    """

    ratios: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2)
    gap: Annotated[float, msgspec.Meta(ge=1.0)] = 10.0
    iterations: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 200

    def supports(self, factor: Factor, left: int, columns: Support) -> Iterator[Support]:
        """Yield the supports that hold `left`, without it."""
        index = list(columns)
        _, values, vectors = np.linalg.svd(factor.r[:, index])
        # Singular values of exact relations are rounding, and their ratios mean nothing.
        rounding = len(index) * np.finfo(float).eps * values[0]
        null = vectors[values <= self.gap * max(values[-1], rounding)].T
        start = null @ null[index.index(left)]
        if not np.any(start):
            return
        seen = set[Support]()
        for ratio in self.ratios:
            q = start / np.linalg.norm(start)
            for _ in range(self.iterations):
                limit = ratio * np.abs(q).max()
                shrunk = np.sign(q) * np.maximum(np.abs(q) - limit, 0.0)
                new = null @ (null.T @ shrunk)
                new /= max(float(np.linalg.norm(new)), 1e-300)
                if np.linalg.norm(new - q) < 1e-10:
                    break
                q = new
            kept = np.abs(q) > ratio * np.abs(q).max()
            support = tuple(j for j, k in zip(index, kept, strict=True) if k and j != left)
            if kept[index.index(left)] and support and support not in seen:
                seen.add(support)
                yield support


AnyProposer = EnergyThreshold | CoefficientThreshold | MatchingPursuit | BackwardElimination | NullSpace
