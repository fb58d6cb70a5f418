"""What the tests of process_noise and process_search share."""

import numpy as np
from scipy.linalg import expm
from small_systems import SPRING, drive

from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments

STEP, LENGTH = 0.05, 5


NONE = np.zeros(0, dtype=np.int64)


# One mass: the spring without its cube. What it lacks are the candidates that are absent.
PRESENT = np.array([0, 1, 2, 4])
TERMS = PRESENT[1:]


LINEAR = np.where(np.arange(len(SPRING.theta)) == 3, 0.0, SPRING.theta)


SIGMA, Q = 0.02, np.array([0.02, 0.1])


def matrices(system, theta):
    """Return A, B and C of x' = A x + B u, y = C x of a linear system, from its slots."""
    n = len(system.following)
    a, b, c = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((len(system.measured), n))
    for i, f in enumerate(system.following):
        if f >= 0:
            a[i, f] = 1.0
        for (relation, factor, text, _), value in zip(system.terms, theta, strict=True):
            if factor < 0 and relation == -1 - f and value:
                k = system.variables.index(text)
                (a if k < n else b)[i, k if k < n else k - n] -= value
    c[np.arange(len(c)), system.measured] = 1.0
    return a, b, c


def discrete(a, b, step):
    """Return Phi, and Gamma of the three nodes of a parabola, of one step: exact."""
    n = len(a)
    whole = np.zeros((n + 3, n + 3))
    whole[:n, :n], whole[:n, n] = a, b[:, 0]
    whole[n, n + 1] = whole[n + 1, n + 2] = 1.0
    power = expm(step * whole)
    taylor = np.array([[1, 0, 0], [-3 / step, 4 / step, -1 / step], [4 / step**2, -8 / step**2, 4 / step**2]])
    return power[:n, :n], power[:n, n:] @ taylor


def kicked(system, theta, nodes, kicks, start, step=STEP):
    """Return the states (N, n) of a linear system whose state jumps by kicks (N, n) just before each sample."""
    a, b, _ = matrices(system, theta)
    phi, gamma = discrete(a, b, step)
    x, rows = np.array(start), []
    for u, kick in zip(nodes[:, :, 0], kicks, strict=True):
        x = x + kick
        rows.append(x)
        x = phi @ x + gamma @ u
    return np.array(rows)


def cut(states, measured, nodes, sigma, q, lengths, length=LENGTH, step=STEP):
    """Return segments of records of these lengths, end to end."""
    start, count, joined, runs, total = [], [], [], [], 0
    for samples in lengths:
        edges = np.append(np.arange(0, samples - length + 1, length), samples)
        start += (total + edges[:-1]).tolist()
        count += np.diff(edges).tolist()
        joined += [True] * (len(edges) - 2) + [False]
        runs.append((total, total + samples))
        total += samples
    return Segments(
        measured, nodes, states, np.array(start), np.array(count), np.array(joined),
        np.atleast_1d(np.array(sigma, dtype=float)), np.array(q, dtype=float), step, 1, tuple(runs),
    )  # fmt: skip


def white_kicks(rng, q, lengths):
    """Return kicks of the widths q at the joints, none elsewhere."""
    kicks = np.zeros((sum(lengths), len(q)))
    begin = np.cumsum([0, *lengths[:-1]])
    for low, samples in zip(begin, lengths, strict=True):
        at = low + np.arange(LENGTH, samples - LENGTH + 1, LENGTH)
        kicks[at] = q * rng.standard_normal((len(at), len(q)))
    return kicks


def space(system, segments, substeps=2, budget=None):
    return SearchSpace(
        Evaluator(segments, substeps, budget),
        system.mechanisms,
        system.frame,
    )


def spring(seed, count=600, sigma=SIGMA, q=Q, kicks=None, believed=None):
    """Return the space of a kicked linear spring with white noise."""
    rng = np.random.default_rng(seed)
    kicks = white_kicks(rng, np.array(q), (count,)) if kicks is None else kicks
    states = kicked(SPRING, LINEAR, drive(count), kicks, [0.5, 0.0])
    measured = states[:, :1] + sigma * rng.standard_normal((count, 1))
    believed = q if believed is None else believed
    return space(SPRING, cut(states, measured, drive(count), sigma, believed, (count,)))


def fitted(it, theta=LINEAR, present=PRESENT, gap=None):
    found = it.fit(theta, present, it.segments.initial, it.segments.spread if gap is None else gap)
    assert found is not None
    return found
