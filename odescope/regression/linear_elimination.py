"""Elimination of mechanisms in the linear relations, where noise of the record explains what these leave.

The relations are sums of coefficients times what is known at every sample, targets included, and homogeneous. With M
for the squares of their rows and N for those that noise alone would make, coefficients v of the law make v'Mv / v'Nv
about 1: the least generalized eigenvalue. From all mechanisms to few, that goes first without which targets stand out
from what is left nearly as much. There is one minimum, however far a first guess; but where derivatives drown in noise
there are others beside it.
docs/method.md, Mechanisms.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter

import numpy as np
import scipy.linalg

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.regression.mechanisms import MechanismProblem, Squares, criterion
from odescope.signals.estimate import Signals

FEW = 0.5  # of the mechanisms that elimination begins with: what is left at most
EXPLAINED = 2.0  # least eigenvalue up to which noise explains what relations leave: derivatives are smoothed


def explained(problem: MechanismProblem, noisy: Signals) -> FloatArray | None:
    """Return coefficients (mechanisms,) of few mechanisms that leave of their relations no more than noise does.

    None where all leave more, those few do not determine the targets, or a mechanism has no value at some sample. Those
    with a simpler kinetic energy are gone through by themselves, too; the criterion of regression chooses.

    Args:
        problem: data and mechanisms.
        noisy: the signals of the same records with as much noise once more.
    """
    squares = problem.squares(noisy)
    if not (np.isfinite(squares.rows).all() and np.isfinite(squares.noise).all()):
        return None
    best, least, targets = None, np.inf, np.arange(len(problem.signals.targets))
    for simple in _simpler(problem):
        for theta in _laws(problem, squares, np.flatnonzero((problem.known != 0.0) | simple), targets):
            if np.count_nonzero(theta) > FEW * np.count_nonzero(simple):
                continue  # what takes most of all that there are explains nothing
            here = problem.linearised(theta, np.zeros(0, dtype=np.int64))
            if here is not None and (value := criterion(here, theta)) < least:
                best, least = theta, value
    return None if best is None else problem.in_known_scale(best)


def _simpler(problem: MechanismProblem) -> BoolArray:
    """Return sets of mechanisms (sets, m): all, and those of which the kinetic energy stays where something is moved.

    What is moved along or turned as a whole keeps its kinetic energy: this holds not one coordinate, nothing of angles
    but their differences, or no coordinate at all, and the mass matrix is constant. That of masses each of which one
    coordinate moves is diagonal, too: what is linear has others, in which every force acts on all.
    """
    coordinates = problem.signals.coordinates
    fixed = np.array([m.kind != "kinetic" for m in problem.mechanisms])
    alone = [fixed | problem.stays([c.name]) for c in coordinates]
    turned = fixed | problem.stays([c.name for c in coordinates if c.angle])
    constant = np.all(alone, axis=0)
    apart = fixed | (constant & (problem.holds.sum(axis=1) == 1))
    sets: BoolArray = np.unique([np.ones_like(fixed), *alone, constant, apart, turned], axis=0)
    return sets


def _laws(problem: MechanismProblem, squares: Squares, among: IntArray, wanted: IntArray) -> Iterator[FloatArray]:
    """Yield coefficients (m,) of the few that count among some mechanisms, nothing where noise does not explain these.

    The fewest may be the law of some coordinates that nothing couples to the others, whose own is then added.

    Args:
        problem: data and mechanisms.
        squares: of its rows, their targets and their noise.
        among: (k,) numbers of those to begin with.
        wanted: numbers of the targets that a law has to hold.
    """
    price = np.log(squares.count) + 2.0 * np.log(len(problem.mechanisms))
    path = list[tuple[float, FloatArray, IntArray]]()  # what it costs, coefficients, targets that are in none of these
    for present, value, vector in _eliminated(squares, problem.known != 0.0, among):
        theta = np.zeros(len(problem.mechanisms))
        theta[present] = vector / squares.norm[present]
        missing = np.setdiff1d(wanted, np.flatnonzero(problem.holds[present].any(axis=0)))
        path.append((squares.count * np.log(max(value, 1.0)) + len(present) * price, theta, missing))
    if not path:
        return
    together = [step for step in path if not len(step[2])]
    if together:
        yield min(together, key=itemgetter(0))[1]
    _, theta, missing = min(path, key=itemgetter(0))
    if 0 < len(missing) < len(wanted):
        apart = [k for k in among if set(problem.mechanisms[k].relations) <= set(missing.tolist())]
        yield from (theta + rest for rest in _laws(problem, squares, np.array(apart, dtype=np.int64), missing))


def _eliminated(squares: Squares, known: BoolArray, present: IntArray) -> Iterator[tuple[IntArray, float, FloatArray]]:
    """Yield numbers of mechanisms, the least eigenvalue and its vector, down to those that are known or two.

    That goes next without which the relations would leave more of what targets are in them: they say nothing of a law
    that holds no target, or in which these nearly cancel. It ends where noise does not explain what is left: with fewer
    mechanisms the least eigenvalue only rises.

    Args:
        squares: of rows, targets and noise.
        known: (m,) which mechanisms stay.
        present: (k,) numbers of those to begin with.
    """
    while len(present) > 2:
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
