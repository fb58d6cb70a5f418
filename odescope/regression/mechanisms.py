"""Regression on mechanisms: all relations together, each residual that of a predicted target.

With A(theta) y = b(theta) the residual of the targets is r = y - yhat, yhat = A^-1 b. Its derivative with respect to a
coefficient is A^-1 (a_k yhat - b_k), which vanishes along theta: the scale is no matter. Gauss-Newton steps on r, in
rows weighted by the noise of the targets, and elimination of what the residual needs least.
docs/method.md, Mechanisms.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.library.mechanism import Mechanism, scale_groups
from odescope.library.tape import Tape, evaluate, write_tape
from odescope.parallel.workers import Threads
from odescope.regression.rows import Block, NoiseWeighted, RowMap, cut_blocks
from odescope.signals.estimate import Signals

STEPS = 8  # of Gauss and Newton between two eliminations, at most
SETTLED = 1e-3  # relative fall of the cost that ends them
ENOUGH = 6000  # samples: of longer records a part of the blocks
SIMPLE = 1  # size of a mechanism, at most, that a first fit of all may hold
MANY = 250  # mechanisms, at most, that it may hold whatever their size where the scale of all relations is given
RIDGE = 1e-9  # of the scaled information: what the rows cannot tell stays where it is
ROUNDING = 1e-12  # of the squares of a column
POINTS = 16  # at random, at which terms are compared that may be the same, and
SAME = 1e-9  # the share and the size by which they may differ


@dataclass(frozen=True, eq=False)
class Linearised:
    """Cost at some coefficients, and its derivatives with respect to those of k mechanisms: half gradient, information.

    Shapes: gradient (k,); information (k, k); rows is their number.
    """

    cost: float
    gradient: FloatArray
    information: FloatArray
    rows: int


@dataclass(frozen=True, eq=False)
class Squares:
    """Products of the rows of all relations as they stand, by mechanisms (m, m).

    `targets` are those of what holds a target in these rows, `noise` those that noise alone would make. Columns are of
    unit norm; `norm` (m,) are theirs before, `count` is the number of rows. Rows and noise are made regular.
    """

    rows: FloatArray
    targets: FloatArray
    noise: FloatArray
    norm: FloatArray
    count: int


@dataclass(frozen=True, eq=False)
class MechanismProblem:
    """Mechanisms on the signals. `scale` (T,) is the noise that the rows of each target are weighted by."""

    signals: Signals
    mechanisms: tuple[Mechanism, ...]
    blocks: tuple[Block, ...]
    maps: tuple[RowMap, ...]
    scale: FloatArray

    @staticmethod
    def of(signals: Signals, mechanisms: Sequence[Mechanism]) -> MechanismProblem:
        """Return the problem, its rows weighted by the noise of a derivative of white noise."""
        blocks = cut_blocks(signals)
        blocks = blocks[:: -(-signals.samples // ENOUGH)]
        maps = tuple(NoiseWeighted(passes=0).row_map(signals, c.order, blocks, (), 0) for c in signals.coordinates)
        noise = np.array([max(c.noise, 1e-300) for c in signals.channels])
        return MechanismProblem(signals, tuple(mechanisms), blocks, maps, noise)

    @cached_property
    def _parts(self) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
        """Mechanism, relation, target (-1 for none) and share of every part."""
        number = {target: k for k, target in enumerate(self.signals.targets)}
        parts = [(k, p) for k, m in enumerate(self.mechanisms) for p in m.parts]
        factor = [-1 if p.product.factor is None else number[p.product.factor] for _, p in parts]
        return (
            np.array([k for k, _ in parts], dtype=np.int64),
            np.array([p.relation for _, p in parts], dtype=np.int64),
            np.array(factor, dtype=np.int64),
            np.array([p.share for _, p in parts]),
        )

    @cached_property
    def _tape(self) -> Tape:
        """The terms of all parts, of the columns of signals."""
        return write_tape(self.signals.names, [p.product.term for m in self.mechanisms for p in m.parts])

    @cached_property
    def _values(self) -> list[FloatArray]:
        """The terms of all parts on every block of its own signals, (parts, n_b)."""
        return self._evaluated(self.signals)

    def _evaluated(self, signals: Signals) -> list[FloatArray]:
        """Return the terms of all parts on every block of some signals, (parts, n_b)."""
        return list(Threads().map(lambda b: evaluate(self._tape, _columns(signals, b)), self.blocks))

    def raw(self, signals: Signals, bare: float = 1.0) -> list[FloatArray]:
        """Return rows (n, mechanisms) of the relations as they stand, every target as measured in some signals.

        Args:
            signals: of the same records.
            bare: what multiplies the parts that hold no target.
        """
        owner, relation, factor, share = self._parts
        evaluated, found = self._values if signals is self.signals else self._evaluated(signals), []
        for block, values in zip(self.blocks, evaluated, strict=True):
            y = _measured(signals, block)
            added = np.zeros((len(y), len(self.mechanisms), values.shape[1]))
            by = np.where(factor[:, None] >= 0, y[factor], bare)
            np.add.at(added, (relation, owner), values * share[:, None] * by)
            found.append(np.concatenate([m.rows(a) / s for m, a, s in zip(self.maps, added, self.scale, strict=True)]))
        return found

    def squares(self, noisy: Signals) -> Squares:
        """Return the products of the rows, and those of what noise adds.

        Args:
            noisy: the signals of the same records with as much noise once more.
        """
        rows, targets = (np.concatenate(self.raw(self.signals, bare)) for bare in (1.0, 0.0))
        noise = np.concatenate(self.raw(noisy)) - rows
        norm = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        products, inert, added = ((v / norm).T @ (v / norm) for v in (rows, targets, noise))
        regular = np.eye(len(norm))
        return Squares(products + ROUNDING * regular, inert, added + RIDGE * regular, norm, len(rows))

    @cached_property
    def holds(self) -> BoolArray:
        """Which targets stand in each mechanism, (m, T)."""
        owner, _, factor, _ = self._parts
        found = np.zeros((len(self.mechanisms), len(self.signals.targets)), dtype=np.bool_)
        found[owner[factor >= 0], factor[factor >= 0]] = True
        return found

    def stays(self, moved: Sequence[str]) -> BoolArray:
        """Return which mechanisms are the same wherever some coordinates are, all of them moved by as much, (m,)."""
        names, rng = self.signals.names, np.random.default_rng(0)
        here = rng.standard_normal((len(names), POINTS))
        there = here + np.array([[name in moved] for name in names])
        same = np.isclose(evaluate(self._tape, here), evaluate(self._tape, there), rtol=SAME, atol=SAME, equal_nan=True)
        found = np.ones(len(self.mechanisms), dtype=np.bool_)
        np.logical_and.at(found, self._parts[0], same.all(axis=1))
        return found

    @property
    def known(self) -> FloatArray:
        """Coefficients that are given (m,), 0 for the others."""
        return np.array([m.known or 0.0 for m in self.mechanisms])

    @property
    def linear(self) -> bool:
        """Whether all that multiplies a target is known: the other coefficients follow by plain least squares."""
        return all(m.known is not None or all(p.product.factor is None for p in m.parts) for m in self.mechanisms)

    def in_known_scale(self, theta: FloatArray) -> FloatArray:
        """Return coefficients (m,) of homogeneous relations in the scale of those that are known, if any are."""
        known = self.known
        given = known != 0.0
        if not given.any():
            return theta
        size = max(float(theta[given] @ theta[given]), 1e-300)
        return np.where(given, known, theta * float(known @ theta) / size)

    def linearised(self, theta: FloatArray, free: IntArray) -> Linearised | None:
        """Return cost and derivatives at theta (mechanisms,), or None where the targets are not determined.

        Args:
            theta: coefficients of all mechanisms.
            free: numbers of those with respect to which the derivatives are wanted.
        """
        found = list(Threads().map(lambda b: self._on_block(b, theta, free), range(len(self.blocks))))
        rows = [f for f in found if f is not None]
        if len(rows) < len(found):
            return None
        gram = sum((r.T @ r for r in rows), np.zeros((len(free) + 1, len(free) + 1)))
        return Linearised(float(gram[-1, -1]), gram[:-1, -1], gram[:-1, :-1], sum(len(r) for r in rows))

    def _on_block(self, number: int, theta: FloatArray, free: IntArray) -> FloatArray | None:
        """Return the rows of the derivatives, and those of the residual as the last column."""
        owner, relation, factor, share = self._parts
        block, values = self.blocks[number], self._values[number]
        y = _measured(self.signals, block)
        targets, n = y.shape
        a, b = np.zeros((targets, targets, n)), np.zeros((targets, n))
        for k in np.flatnonzero(theta[owner]):
            weighted = theta[owner[k]] * share[k] * values[k]
            if factor[k] >= 0:
                a[relation[k], factor[k]] += weighted
            else:
                b[relation[k]] -= weighted
        try:
            inverse = np.moveaxis(np.linalg.inv(np.moveaxis(a, 2, 0)), 0, 2)
        except np.linalg.LinAlgError:
            return None
        predicted = np.einsum("ijn,jn->in", inverse, b)
        slopes = np.zeros((len(free) + 1, targets, n))
        place = np.full(len(self.mechanisms), -1, dtype=np.int64)
        place[free] = np.arange(len(free))
        for k in np.flatnonzero(place[owner] >= 0):
            by = predicted[factor[k]] if factor[k] >= 0 else 1.0
            slopes[place[owner[k]], relation[k]] += share[k] * values[k] * by
        slopes = np.einsum("ijn,kjn->ikn", inverse, slopes)
        slopes[:, -1] = y - predicted
        if not np.isfinite(slopes).all():
            return None
        return np.concatenate([m.rows(s) / w for m, s, w in zip(self.maps, slopes, self.scale, strict=True)])

    def scales(self, theta: FloatArray, free: IntArray) -> FloatArray:
        """Return the directions (g, k) in which nothing changes: one a group of relations whose scale is not given.

        Args:
            theta: coefficients of all mechanisms.
            free: numbers of those that may change.
        """
        groups = scale_groups(self.mechanisms, np.flatnonzero(theta))
        loose = [list(g) for g in groups if all(self.mechanisms[k].known is None for k in g)]
        found = np.zeros((len(loose), len(theta)))
        for row, group in zip(found, loose, strict=True):
            row[group] = theta[group]
        return found[:, free]

    def settle(self, theta: FloatArray, free: IntArray) -> tuple[FloatArray, Linearised] | None:
        """Return where Gauss-Newton steps from theta lead, and the derivatives there."""
        here = self.linearised(theta, free)
        if here is None:
            return None
        for _ in range(STEPS):
            step, before = _step(here, self.scales(theta, free)), here.cost
            for share in (1.0, 0.5, 0.25, 0.0625):
                trial = theta.copy()
                trial[free] += share * step
                there = self.linearised(trial, free)
                if there is not None and there.cost < here.cost:
                    theta, here = trial, there
                    break
            if not here.cost < (1.0 - SETTLED) * before:
                break
        return theta, here


def _columns(signals: Signals, block: Block) -> FloatArray:
    columns: FloatArray = signals.columns[block.record][:, block.start : block.stop]
    return columns


def _measured(signals: Signals, block: Block) -> FloatArray:
    """Return the targets on a block, (T, n_b)."""
    return _columns(signals, block)[[signals.row(t) for t in signals.targets]]


def _step(here: Linearised, scales: FloatArray) -> FloatArray:
    """Return the step that the derivatives ask for, across the scales (g, k): along them nothing changes."""
    information, scale = _across(here, scales)
    step: FloatArray = np.linalg.solve(information, -here.gradient / scale) / scale
    return step


def weights(here: Linearised, theta: FloatArray, scales: FloatArray) -> FloatArray:
    """Return by how much the cost would rise without each of some coefficients, the others refitted (k,).

    Args:
        here: derivatives with respect to these.
        theta: (k,) the coefficients.
        scales: (g, k) the directions in which nothing changes.
    """
    information, scale = _across(here, scales)
    rise: FloatArray = (theta * scale) ** 2 / np.maximum(np.diag(np.linalg.inv(information)), 1e-300)
    return rise


def _across(here: Linearised, scales: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the scaled information (k, k), made regular along the scales, and what it was divided by (k,)."""
    scale = np.sqrt(np.maximum(np.diag(here.information), 1e-300))
    along = scales * scale
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    information = here.information / scale / scale[:, None] + RIDGE * np.eye(len(scale))
    return information + along.T @ along, scale


def eliminated(problem: MechanismProblem, theta: FloatArray) -> Iterator[tuple[FloatArray, Linearised]]:
    """Yield coefficients and what they leave, from those of theta to few, always without what matters least.

    Args:
        problem: data and mechanisms.
        theta: (mechanisms,) to begin with.
    """
    held = problem.known != 0.0
    while True:
        free = np.flatnonzero((theta != 0.0) & ~held)
        settled = problem.settle(theta, free) if len(free) else None
        if settled is None:
            return
        theta, here = settled
        yield theta, here
        theta = theta.copy()
        theta[free[np.argmin(weights(here, theta[free], problem.scales(theta, free)))]] = 0.0


def proposed(problem: MechanismProblem, noisy: Signals) -> FloatArray | None:
    """Return the coefficients (mechanisms,) that the rows support, None where no equations determine the targets.

    The linear relations come first, with errors in all their variables: the least of M over N, where M are the squares
    of the rows and N those that noise alone would make. From there elimination, by Gauss-Newton steps on predicted
    targets; the criterion of regression chooses on the way.

    Args:
        problem: data and mechanisms.
        noisy: the signals of the same records with as much noise once more.
    """
    theta, best, least = _least(problem, noisy, _first(problem)), None, np.inf
    for found, here in eliminated(problem, theta):
        if (value := criterion(here, found)) < least:
            best, least = found, value
    return best


def criterion(here: Linearised, theta: FloatArray) -> float:
    """Return n ln(S / n) + p (ln n + 2 ln m): what the p present of m mechanisms leave of targets, and their price.

    Args:
        here: cost at theta.
        theta: (m,) coefficients.
    """
    price = np.log(here.rows) + 2.0 * np.log(len(theta))
    return float(here.rows * np.log(max(here.cost / here.rows, 1e-300)) + np.count_nonzero(theta) * price)


def _first(problem: MechanismProblem) -> IntArray:
    """Return what a first fit holds: the simple mechanisms, or all where it is plain least squares and they are few."""
    everything = problem.linear and len(problem.mechanisms) <= MANY
    kept = [k for k, m in enumerate(problem.mechanisms) if everything or m.known is not None or _simple(m)]
    return np.array(kept, dtype=np.int64)


def _simple(mechanism: Mechanism) -> bool:
    """Say whether a mechanism is among those that a first fit of all may hold."""
    return mechanism.size <= SIMPLE and not any(
        "abs(" in p.product.text or "sign(" in p.product.text for p in mechanism.parts
    )


def _least(problem: MechanismProblem, noisy: Signals, among: IntArray) -> FloatArray:
    """Return the coefficients of some mechanisms in the linear relations, all variables with errors."""
    theta = problem.known
    if problem.linear:
        free = np.setdiff1d(among, np.flatnonzero(theta))
        here = problem.linearised(theta, free)
        if here is not None:
            theta[free] = _step(here, np.zeros((0, len(free))))
        return theta
    squares = problem.squares(noisy)
    own = np.ix_(among, among)
    vectors = scipy.linalg.eigh(squares.rows[own], squares.noise[own], subset_by_index=[0, 0])[1]
    theta[among] = vectors[:, 0] / squares.norm[among]
    return problem.in_known_scale(theta)
