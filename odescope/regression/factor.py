"""The factor R of one QR pass: the only thing regression sees of the samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.regression.solve import full_fits, least_squares

BLOCK_ROWS = 4096  # rows a pass: a block of 50 columns stays in cache


@dataclass(frozen=True, eq=False)
class Factor:
    """R of the QR factorisation of a library whose columns are scaled to unit norm.

    Shapes: r (m, m) upper triangular, in Fortran's order since fits go by columns, scale (m,) the norms of these; rows
    is the number of rows factored. Least squares on any support, energies and residuals all follow from r:
    `|theta xi| = |r (scale xi)|`.
    """

    r: FloatArray
    scale: FloatArray
    rows: int
    _first: dict[tuple[int, ...], FloatArray | None] = field(default_factory=dict, init=False, repr=False)

    @property
    def width(self) -> int:
        """Number of candidate terms."""
        return len(self.scale)

    def restrict(self, columns: Sequence[int]) -> Factor:
        """Return the factor of some of the columns."""
        index = list(columns)
        return _scaled(_triangle(self.r[:, index] * self.scale[index]), self.rows)

    def solve(self, support: Sequence[int], left: int) -> FloatArray:
        """Return xi (m,) of the relation sum xi theta = 0 with xi[left] = 1, the rest least squares on `support`.

        Args:
            support: columns of the relation, `left` among them.
            left: the column on the left-hand side, the guess of (15).
        """
        others = np.array([j for j in support if j != left], dtype=np.int64)
        xi = np.zeros(self.width)
        xi[left] = 1.0
        xi[others] = -least_squares(self.r, others, left)[0] * (self.scale[left] / self.scale[others])
        return xi

    def unexplained(self, support: Sequence[int], left: int) -> float:
        """Return the root mean square over the rows of the relation that `solve` returns.

        Args:
            support: columns of the relation, `left` among them.
            left: the column on the left-hand side.
        """
        others = np.array([j for j in support if j != left], dtype=np.int64)
        return float(self.scale[left] * np.sqrt(least_squares(self.r, others, left)[1] / self.rows))

    def first_fit(self, columns: tuple[int, ...], left: int) -> FloatArray | None:
        """Return the coefficients (m,) of scaled column `left` on the other columns, None where they are dependent.

        All guesses' fits come from one inverse, kept for the next guess.
        """
        if left not in columns:
            return None
        if columns not in self._first:
            self._first[columns] = full_fits(self.r[:, list(columns)])
        fits = self._first[columns]
        if fits is None:
            return None
        first = np.zeros(self.width)
        first[list(columns)] = fits[:, columns.index(left)]
        return first

    def residual(self, xi: FloatArray) -> float:
        """Return the root mean square of the relation xi (m,) over the rows."""
        return float(np.linalg.norm(self.r @ (xi * self.scale)) / np.sqrt(self.rows))

    def condition(self, columns: Sequence[int]) -> float:
        """Return the condition number (7) of the scaled columns."""
        values = np.linalg.svd(self.r[:, list(columns)], compute_uv=False)
        return float(values[0] / values[-1]) if values[-1] > 0 else float("inf")

    @cached_property
    def gram(self) -> FloatArray:
        """The cosines between columns, (m, m): the paper's Fig. 4, about zero instead of the mean."""
        gram: FloatArray = self.r.T @ self.r
        return gram

    def dependent(self, tolerance: float = 1e-7) -> tuple[tuple[int, tuple[int, ...]], ...]:
        """Return columns that are combinations of columns before them, with those that enter the combination.

        A column's diagonal entry in r is the part of it that the earlier columns leave unexplained.
        """
        found, independent = [], list[int]()
        basis = np.empty_like(self.r)  # orthonormal, of the independent columns
        for j in range(self.width):
            spanned = basis[:, : len(independent)]
            rest = self.r[:, j].copy()
            for _ in range(2):  # once more: of a column that is nearly dependent the first pass leaves rounding
                rest -= spanned @ (spanned.T @ rest)
            size = np.linalg.norm(rest)
            if size < tolerance:
                weights = solve_triangular(spanned.T @ self.r[:, independent], spanned.T @ self.r[:, j])
                found.append((j, tuple(k for k, w in zip(independent, weights, strict=True) if abs(w) > 1e-3)))
            else:
                basis[:, len(independent)] = rest / size
                independent.append(j)
        return tuple(found)


def factorise(blocks: Iterable[FloatArray]) -> Factor:
    """Return the factor of a library given in blocks of rows (n_b, m), by TSQR: blocks merge by factoring stacked R's.

    Raises:
        InputError: no rows, or values that are not finite.
    """
    r, rows = None, 0
    for block in blocks:
        for start in range(0, len(block), BLOCK_ROWS):
            piece = block[start : start + BLOCK_ROWS]
            rows += len(piece)
            r = _triangle(piece if r is None else np.concatenate([r, piece]))
    if r is None:
        raise InputError("there is no row to factor")
    return _scaled(r, rows)


def merge(factors: Sequence[Factor]) -> Factor:
    """Return the factor of all rows of several factors together."""
    stacked = np.concatenate([f.r * f.scale for f in factors])
    return _scaled(_triangle(stacked), sum(f.rows for f in factors))


def _triangle(rows: FloatArray) -> FloatArray:
    # An array already: asarray is for the type checker, to whom every mode of qr returns a pair.
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _scaled(r: FloatArray, rows: int) -> Factor:
    scale = np.linalg.norm(r, axis=0)
    if not np.all(np.isfinite(scale)):
        raise InputError("a candidate term has values that are not finite")
    safe = np.where(scale > 0.0, scale, 1.0)
    square = np.zeros((r.shape[1], r.shape[1]), order="F")
    square[: len(r)] = r / safe
    return Factor(square, safe, rows)
