"""Elimination of mechanisms in the linear relations, where noise of the record explains what these leave.

The relations are sums of coefficients times what is known at every sample, targets included, and homogeneous. With M
for the squares of their rows and N for those that noise alone would make, coefficients v of the law make v'Mv / v'Nv
about 1: the least generalized eigenvalue. From all mechanisms to few, what raises that least goes first. There is one
minimum, however far a first guess; but where derivatives drown in noise there are others beside it.
docs/method.md, Mechanisms.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import scipy.linalg

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.library.mechanism import Mechanism
from odescope.regression.mechanisms import MechanismProblem, Squares, criterion
from odescope.signals.estimate import Signals

EXPLAINED = 2.0  # least eigenvalue up to which noise explains what relations leave: derivatives are smoothed


def explained(problem: MechanismProblem, noisy: Signals) -> FloatArray | None:
    """Return coefficients (mechanisms,) of few mechanisms that leave of their relations no more than noise does.

    None where all leave more, those few do not determine the targets, or a mechanism has no value at some sample. The
    simple ones are gone through by themselves, too; the criterion of regression chooses.

    Args:
        problem: data and mechanisms.
        noisy: the signals of the same records with as much noise once more.
    """
    squares = problem.squares(noisy)
    if not (np.isfinite(squares.rows).all() and np.isfinite(squares.noise).all()):
        return None
    holds, known, best, least = problem.holds, problem.known != 0.0, None, np.inf
    for simple in _nested(problem.mechanisms):
        theta = _few(squares, holds, known, np.flatnonzero(known | simple))
        here = None if theta is None else problem.linearised(theta, np.zeros(0, dtype=np.int64))
        if theta is not None and here is not None and (value := criterion(here, theta)) < least:
            best, least = theta, value
    return None if best is None else problem.in_known_scale(best)


def _nested(mechanisms: Sequence[Mechanism]) -> BoolArray:
    """Return sets of mechanisms (sets, m): those up to each size, and all with which the mass matrix is constant."""
    size, kinetic = np.array([m.size for m in mechanisms]), np.array([m.kind == "kinetic" for m in mechanisms])
    sets: BoolArray = np.unique([size <= largest for largest in size] + [~kinetic | (size == 0)], axis=0)
    return sets


def _few(squares: Squares, holds: BoolArray, known: BoolArray, among: IntArray) -> FloatArray | None:
    """Return coefficients (m,) of the few that count among some mechanisms, None where noise does not explain them all.

    Args:
        squares: of rows, targets and noise.
        holds: (m, T) which targets stand in each mechanism.
        known: (m,) which mechanisms stay.
        among: (k,) numbers of those to begin with.
    """
    price = np.log(squares.count) + 2.0 * np.log(len(known))
    theta, least = None, np.inf
    for present, value, vector in _eliminated(squares, holds, known, among):
        cost = squares.count * np.log(max(value, 1.0)) + len(present) * price
        if cost < least:
            theta, least = np.zeros(len(known)), cost
            theta[present] = vector / squares.norm[present]
    return theta


def _eliminated(
    squares: Squares, holds: BoolArray, known: BoolArray, present: IntArray
) -> Iterator[tuple[IntArray, float, FloatArray]]:
    """Yield numbers of mechanisms, the least eigenvalue and its vector, down to those that are known or two.

    That goes next without which the relations would leave more of what targets are in them: they say nothing of a law
    that holds no target, or in which these nearly cancel. It ends where a target is in none of them any more, or noise
    does not explain what is left: with fewer mechanisms the least eigenvalue only rises.

    Args:
        squares: of rows, targets and noise.
        holds: (m, T) which targets stand in each mechanism.
        known: (m,) which mechanisms stay.
        present: (k,) numbers of those to begin with.
    """
    while len(present) > 2 and holds[present].any(axis=0).all():
        own = np.ix_(present, present)
        value, vector = scipy.linalg.eigh(squares.rows[own], squares.noise[own], subset_by_index=[0, 0])
        if value[0] > EXPLAINED:
            return
        yield present, float(value[0]), vector[:, 0]
        ratios, vectors = scipy.linalg.eigh(squares.targets[own], squares.rows[own])
        # To second order: what it costs the largest ratio to have nothing of a mechanism, by a little of all others.
        apart = np.sum(vectors[:, :-1] ** 2 / np.maximum(ratios[-1] - ratios[:-1], 1e-300), axis=1)
        fall = np.where(known[present], np.inf, vectors[:, -1] ** 2 / np.maximum(apart, 1e-300))
        if np.isinf(fall).all():
            return
        present = np.delete(present, np.argmin(fall))
