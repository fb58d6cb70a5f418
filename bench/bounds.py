"""Cramer-Rao bounds: what an unbiased estimate could tell of the coefficients of a truth, by a path of its own.

The bound is that of the whole continuous record, the noise level known, by a path that shares nothing with the
likelihood: finite differences of free runs of `odescope.model.simulation` at a relative tolerance of 1e-11 over short
stretches that start at the true states, chained by their transition matrices in a square-root information filter. A
stretch is short so that chaos does not spoil the differences. What a state once was is known ever better where the
system forgets it, without bound, so the ends of stretches meet to 1e-7 of the spread of each state, not exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from truths import Truth

from odescope.model.model import Model
from odescope.model.simulation import simulate

STRETCH = 0.25  # seconds
JOINT = 1e-7  # of the spread of a state
TOLERANCE = 1e-11, 1e-13
DIFFERENCE = 1e-4  # relative, of a coefficient; of the spread of a state


def inputs_of(model: Model, run: Mapping[str, np.ndarray]) -> np.ndarray:
    return np.column_stack([run[i.name] for i in model.inputs]) if model.inputs else np.empty((len(run["t"]), 0))


def differences(
    model: Model,
    nearby: list[tuple[Model, Model, float]],
    t: np.ndarray,
    u: np.ndarray,
    start: np.ndarray,
    small: np.ndarray,
) -> np.ndarray:
    """Return central differences of the states with respect to start and coefficients, (len(t), n, n + p)."""
    columns = []
    for h in np.diag(small):
        more, less = (simulate(model, t, u, start + by, *TOLERANCE).states for by in (h, -h))
        columns.append((more - less) / (2 * h.max()))
    for above, below, h in nearby:
        more, less = (simulate(m, t, u, start, *TOLERANCE).states for m in (above, below))
        columns.append((more - less) / (2 * h))
    return np.stack(columns, axis=-1)


def sensitivities(
    truth: Truth, data: Sequence[Mapping[str, np.ndarray]], states: Sequence[np.ndarray]
) -> list[list[np.ndarray]]:
    """Return for every recording the sensitivities of its stretches, which do not depend on the noise.

    Args:
        truth: whose free coefficients are varied.
        data: recordings with their times and inputs.
        states: (N, n) of each, without noise.
    """
    model, nearby, runs = truth.simulated(), [], []
    for k in truth.free:
        by = np.zeros(len(truth.theta))
        by[k] = DIFFERENCE * abs(truth.theta[k])
        nearby.append((truth.simulated(truth.theta + by), truth.simulated(truth.theta - by), by[k]))
    small = DIFFERENCE * np.concatenate(states).std(axis=0)
    for run, true in zip(data, states, strict=True):
        t, u = run["t"], inputs_of(model, run)
        stretch = max(2, round(STRETCH / (t[1] - t[0])))
        pieces = [slice(b, min(b + stretch, len(t) - 1) + 1) for b in range(0, len(t) - 1, stretch)]
        runs.append([differences(model, nearby, t[piece], u[piece], true[piece.start], small) for piece in pieces])
    return runs


def cramer_rao(
    truth: Truth, states: Sequence[np.ndarray], sigma: np.ndarray, runs: list[list[np.ndarray]]
) -> np.ndarray:
    """Return the least covariance (k, k) of an unbiased estimate of all coefficients, zero for those held.

    The filter carries the information of (state at the begin of the stretch, coefficients) as an upper triangular root.
    Over a stretch x(t) = x0 + S_x dx0 + S_c dc: measurements add rows [S_x, S_c] / sigma, the joint to the state at the
    end [S_x, S_c, -1] / gap; a QR factorisation with the columns of dx0 first then leaves the next root.
    """
    model, free = truth.model, truth.free
    n, p = len(model.states), len(free)
    rows = [model.states.index(c.name) for c in model.coordinates]
    gap = JOINT * np.concatenate(states).std(axis=0)[:, None]
    information = np.zeros((p, p))
    for stretches in runs:
        root = np.zeros((n + p, n + p))
        for k, sensitivity in enumerate(stretches):
            # The last sample belongs to the next stretch, if there is one.
            seen = sensitivity[:, rows] if k + 1 == len(stretches) else sensitivity[:-1, rows]
            seen = np.linalg.qr((seen / sigma[:, None]).reshape(-1, n + p), "r")
            data = np.insert(np.vstack([root, seen]), [n] * n, 0.0, axis=1)
            joint = np.column_stack([sensitivity[-1, :, :n], -np.eye(n), sensitivity[-1, :, n:]]) / gap
            root = np.linalg.qr(np.vstack([joint, data]), "r")[n:, n:]
        ends = np.linalg.qr(root, "r")[n:, n:]
        information += ends.T @ ends
    scale = np.sqrt(np.diag(information))
    covariance = np.zeros((len(truth.theta), len(truth.theta)))
    covariance[np.ix_(free, free)] = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    return covariance
