"""Elimination of mechanisms in the linear relations, where noise of the record explains what these leave.

The relations are sums of coefficients times what is known at every sample, targets included, and homogeneous. With M
for the squares of their rows and N for those that noise alone would make, coefficients v of the law make v'Mv / v'Nv
about 1: the least generalized eigenvalue. From all mechanisms to few, what raises that least goes first. There is one
minimum, however far a first guess; but where derivatives drown in noise there are others beside it, and of very many
candidates some nearly add up to nothing over the data. The simple ones are therefore gone through by themselves, too.
docs/method.md, Mechanisms.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.linalg

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.regression.mechanisms import MechanismProblem, Squares
from odescope.signals.estimate import Signals

EXPLAINED = 2.0  # least eigenvalue up to which noise explains what relations leave: derivatives are smoothed


def explained(problem: MechanismProblem, noisy: Signals) -> FloatArray | None:
    """Return coefficients (mechanisms,) of few mechanisms that leave of their relations no more than noise does.

    None where all leave more, those few do not determine the targets, or a mechanism has no value at some sample.

    Args:
        problem: data and mechanisms.
        noisy: the signals of the same records with as much noise once more.
    """
    squares = problem.squares(noisy)
    if not (np.isfinite(squares.rows).all() and np.isfinite(squares.noise).all()):
        return None
    price = np.log(squares.count) + 2.0 * np.log(len(problem.mechanisms))
    known, size = problem.known != 0.0, np.array([m.size for m in problem.mechanisms])
    theta, least = None, np.inf
    for largest in np.unique(size):
        for present, value, vector in _eliminated(squares, known, np.flatnonzero(known | (size <= largest))):
            criterion = squares.count * np.log(max(value, 1.0)) + len(present) * price
            if criterion < least:
                theta, least = np.zeros(len(problem.mechanisms)), criterion
                theta[present] = vector / squares.norm[present]
    if theta is None or problem.linearised(theta, np.flatnonzero(theta)) is None:
        return None
    return problem.in_known_scale(theta)


def _eliminated(squares: Squares, known: BoolArray, present: IntArray) -> Iterator[tuple[IntArray, float, FloatArray]]:
    """Yield numbers of mechanisms, the least eigenvalue and its vector, down to those that are known or two.

    It ends where noise does not explain what is left: with fewer mechanisms the least eigenvalue only rises.

    Args:
        squares: of rows and noise.
        known: (m,) which mechanisms stay.
        present: (k,) numbers of those to begin with.
    """
    while len(present) > 2:
        own = np.ix_(present, present)
        values, vectors = scipy.linalg.eigh(squares.rows[own], squares.noise[own])
        if values[0] > EXPLAINED:
            return
        yield present, float(values[0]), vectors[:, 0]
        # To second order: what it costs the least vector to have nothing of a mechanism, by a little of all others.
        apart = np.sum(vectors[:, 1:] ** 2 / np.maximum(values[1:] - values[0], 1e-300), axis=1)
        rise = np.where(known[present], np.inf, vectors[:, 0] ** 2 / np.maximum(apart, 1e-300))
        if np.isinf(rise).all():
            return
        present = np.delete(present, np.argmin(rise))
