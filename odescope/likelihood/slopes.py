"""The slopes of states and sensitivities in a step of RK4, lanes of segments side by side.

Targets y solve A(x, u) y = b(x, u), so by the implicit function theorem A dy = -(d rho/dx dx + d rho/d theta), with
rho = A y - b. The stages of the states depend on no sensitivity: they are computed first, with the derivatives of rho.
Then the sensitivities, S' = f_x S + f_theta, go through the four stages one column after the other, while a column
is in a first-level cache. Where no relation holds the target of another, A is diagonal, and each stands for itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.library.tape import run_tape
from odescope.model.linear_solve import solve_in_place
from odescope.parallel.kernels import kernel

STAGES = 4


class Effects(NamedTuple):
    """Where the parameters act, sorted by parameter.

    Shapes: part (E,) in whose relation, and with whose target, one acts; slot (E,) of the derivative on the tape, and
    share (E,) what it is multiplied by; first (p + 1,) where the effects of each parameter begin, and the last end.
    """

    part: IntArray
    slot: IntArray
    share: FloatArray
    first: IntArray


class Scratch(NamedTuple):
    """Room for a step of L lanes.

    Shapes: work (slots, L) the tape; a (T, T, L); y, v (T, L); g (T, n, L); acts (T, n) whether a target depends on a
    state. Of every stage: inv (4, T, T, L) the inverse of A; pull (4, T, n, L) minus the derivatives of the targets by
    the states; push (4, E, L) those of rho by the parameters, effect by effect. flow (2, n, L) is a column of the
    sensitivities at a stage and at the next, total (n, L) at the end of the step, rate (L,) one of its slopes.
    """

    work: FloatArray
    a: FloatArray
    y: FloatArray
    v: FloatArray
    g: FloatArray
    acts: BoolArray
    inv: FloatArray
    pull: FloatArray
    push: FloatArray
    flow: FloatArray
    total: FloatArray
    rate: FloatArray


@kernel(inline=True)
def scratch_for(slots, targets, n, effects, lanes):
    """Return room for a step.

    Args:
        slots: of the tape.
        targets: how many there are.
        n: number of states.
        effects: of the parameters.
        lanes: side by side.
    """
    return Scratch(
        np.zeros((slots, lanes)),
        np.empty((targets, targets, lanes)),
        np.empty((targets, lanes)),
        np.empty((targets, lanes)),
        np.empty((targets, n, lanes)),
        np.empty((targets, n), dtype=np.bool_),
        np.zeros((STAGES, targets, targets, lanes)),
        np.empty((STAGES, targets, n, lanes)),
        np.empty((STAGES, effects, lanes)),
        np.empty((2, n, lanes)),
        np.empty((n, lanes)),
        np.empty(lanes),
    )


@kernel("contract")
def slopes(code, places, apart, effects, weight, stage, lanes, x, u, scratch, dx):
    """Compute x' of all lanes at a stage, and what the sensitivities need of it.

    One function, because what it computes on the way stays in cache.

    Args:
        code: instructions of the tape.
        places: where parts stand, `Places`.
        apart: whether no relation holds the target of another.
        effects: of the parameters.
        weight: (parts,) coefficients, shares included.
        stage: its number.
        lanes: how many there are.
        x: (n, L) states.
        u: (inputs, L) inputs.
        scratch: room.
        dx: (n, L) rates of the states.
    """
    work, a, y, v, g, acts = scratch.work, scratch.a, scratch.y, scratch.v, scratch.g, scratch.acts
    inv, pull, push = scratch.inv, scratch.pull, scratch.push
    slot, owner, factor = places.slot, places.owner, places.factor
    grad, following = places.grad, places.following
    n, targets = x.shape[0], y.shape[0]
    for i in range(n):
        for lane in range(lanes):
            work[i, lane] = x[i, lane]
    for i in range(u.shape[0]):
        for lane in range(lanes):
            work[n + i, lane] = u[i, lane]
    run_tape(code, work, lanes)
    for r in range(targets):
        for lane in range(lanes):
            v[r, lane] = 0.0
        for t in range(targets):
            for lane in range(lanes):
                a[r, t, lane] = 0.0
    for k in range(owner.shape[0]):
        c, r, at = weight[k], owner[k], slot[k]
        if factor[k] >= 0:
            for lane in range(lanes):
                a[r, factor[k], lane] += c * work[at, lane]
        else:
            for lane in range(lanes):
                v[r, lane] -= c * work[at, lane]
    _invert(a, inv[stage], targets, lanes, apart)
    for t in range(targets):
        begin, end = (t, t + 1) if apart else (0, targets)
        for lane in range(lanes):
            y[t, lane] = inv[stage, t, begin, lane] * v[begin, lane]
        for r in range(begin + 1, end):
            for lane in range(lanes):
                y[t, lane] += inv[stage, t, r, lane] * v[r, lane]
    for i in range(n):
        source = following[i]
        for lane in range(lanes):
            dx[i, lane] = x[source, lane] if source >= 0 else y[-1 - source, lane]
    for r in range(targets):
        for i in range(n):
            acts[r, i] = False
            for lane in range(lanes):
                g[r, i, lane] = 0.0
    for q in range(grad.shape[0]):
        k, i, at = grad[q, 0], grad[q, 1], grad[q, 2]
        c, r, of = weight[k], owner[k], factor[k]
        if c != 0.0:
            for t in range(r if apart else 0, r + 1 if apart else targets):
                acts[t, i] = True
            if of >= 0:
                for lane in range(lanes):
                    g[r, i, lane] += c * y[of, lane] * work[at, lane]
            else:
                for lane in range(lanes):
                    g[r, i, lane] += c * work[at, lane]
    for t in range(targets):
        begin, end = (t, t + 1) if apart else (0, targets)
        for i in range(n):
            if acts[t, i]:
                for lane in range(lanes):
                    pull[stage, t, i, lane] = inv[stage, t, begin, lane] * g[begin, i, lane]
                for r in range(begin + 1, end):
                    for lane in range(lanes):
                        pull[stage, t, i, lane] += inv[stage, t, r, lane] * g[r, i, lane]
    for q in range(effects.part.shape[0]):
        c, at, of = effects.share[q], effects.slot[q], factor[effects.part[q]]
        if of >= 0:
            for lane in range(lanes):
                push[stage, q, lane] = c * work[at, lane] * y[of, lane]
        else:
            for lane in range(lanes):
                push[stage, q, lane] = c * work[at, lane]


@kernel("contract")
def step_sensitivities(s, following, owner, apart, effects, scratch, ahead, adds, lanes):
    """Take the step of the sensitivities whose stages `slopes` has been through.

    Args:
        s: (n, n + p, L) sensitivities; changed.
        following: (n,) as in `Frame`.
        owner: (parts,) relation of each.
        apart: whether no relation holds the target of another.
        effects: of the parameters.
        scratch: what `slopes` left.
        ahead: (4, L) seconds that a stage's slope is followed to where the next is taken.
        adds: (4, L) seconds that it is followed in the step.
        lanes: how many there are.
    """
    acts, inv, pull, push = scratch.acts, scratch.inv, scratch.pull, scratch.push
    flow, total, rate = scratch.flow, scratch.total, scratch.rate
    part, first = effects.part, effects.first
    n = s.shape[0]
    for j in range(s.shape[1]):
        begin, end = (first[j - n], first[j - n + 1]) if j >= n else (0, 0)
        for i in range(n):
            for lane in range(lanes):
                flow[0, i, lane] = s[i, j, lane]
        for stage in range(STAGES):
            here, there = stage % 2, 1 - stage % 2
            for i in range(n):
                if following[i] >= 0:
                    for lane in range(lanes):
                        rate[lane] = flow[here, following[i], lane]
                else:
                    t = -1 - following[i]
                    for lane in range(lanes):
                        rate[lane] = 0.0
                    for k in range(n):
                        if acts[t, k]:
                            for lane in range(lanes):
                                rate[lane] -= pull[stage, t, k, lane] * flow[here, k, lane]
                    for q in range(begin, end):
                        r = owner[part[q]]
                        if r == t or not apart:
                            for lane in range(lanes):
                                rate[lane] -= inv[stage, t, r, lane] * push[stage, q, lane]
                if stage == 0:
                    for lane in range(lanes):
                        flow[there, i, lane] = s[i, j, lane] + ahead[stage, lane] * rate[lane]
                        total[i, lane] = adds[stage, lane] * rate[lane] + s[i, j, lane]
                elif stage < STAGES - 1:
                    for lane in range(lanes):
                        flow[there, i, lane] = s[i, j, lane] + ahead[stage, lane] * rate[lane]
                        total[i, lane] = adds[stage, lane] * rate[lane] + total[i, lane]
                else:
                    for lane in range(lanes):
                        s[i, j, lane] = adds[stage, lane] * rate[lane] + total[i, lane]


@kernel("contract")
def _invert(a, inv, targets, lanes, apart):
    if apart:  # only what stands on the diagonal is asked for
        for t in range(targets):
            for lane in range(lanes):
                inv[t, t, lane] = 1.0 / a[t, t, lane]
        return
    if targets == 2:
        for lane in range(lanes):
            d = 1.0 / (a[0, 0, lane] * a[1, 1, lane] - a[0, 1, lane] * a[1, 0, lane])
            inv[0, 0, lane], inv[1, 1, lane] = a[1, 1, lane] * d, a[0, 0, lane] * d
            inv[0, 1, lane], inv[1, 0, lane] = -a[0, 1, lane] * d, -a[1, 0, lane] * d
        return
    left, right = np.empty((targets, targets)), np.empty((targets, targets))
    for lane in range(lanes):
        for i in range(targets):
            for j in range(targets):
                left[i, j] = a[i, j, lane]
                right[i, j] = 1.0 if i == j else 0.0
        solve_in_place(left, right)
        for i in range(targets):
            for j in range(targets):
                inv[i, j, lane] = right[i, j]
