"""The slopes of states and sensitivities, lanes of segments side by side.

Targets y solve A(x, u) y = b(x, u), so by the implicit function theorem A dy = -(d rho/dx dx + d rho/d theta), with
rho = A y - b.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.library.tape import run_tape
from odescope.model.linear_solve import solve_in_place
from odescope.parallel.kernels import kernel


class Scratch(NamedTuple):
    """Room for the slopes of a block of L lanes.

    Shapes: work (slots, L); a, inv (T, T, L); y, v (T, L); g (T, n, L); row (L,); acts (n,) whether a relation depends
    on the state.
    """

    work: FloatArray
    a: FloatArray
    inv: FloatArray
    y: FloatArray
    g: FloatArray
    v: FloatArray
    row: FloatArray
    acts: BoolArray


@kernel("contract")
def slopes(code, places, param, weight, within_param, p, lanes, x, s, u, scratch, dx, ds):
    """Compute x' and S' of all lanes: one function, because what it computes on the way stays in cache.

    Args:
        code: instructions of the tape.
        places: where parts stand, `Places`.
        param: (parts,) number of the parameter that a part's coefficient is a share of, -1 for none.
        weight: (parts,) coefficients, shares included.
        within_param: (Q,) the same as `param` for every entry of `Places.within`.
        p: number of parameters.
        lanes: how many there are.
        x: (n, L) states.
        s: (n, n + p, L) sensitivities.
        u: (inputs, L) inputs.
        scratch: room, whose tape and inverse of A stay as they are here.
        dx: (n, L) rates of the states.
        ds: (n, n + p, L) those of the sensitivities.
    """
    work, a, inv, y, g, v, row, acts = scratch
    slot, owner, factor, share = places.slot, places.owner, places.factor, places.share
    grad, following, within = places.grad, places.following, places.within
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
    _invert(a, inv, targets, lanes)
    for t in range(targets):
        for lane in range(lanes):
            y[t, lane] = inv[t, 0, lane] * v[0, lane]
        for r in range(1, targets):
            for lane in range(lanes):
                y[t, lane] += inv[t, r, lane] * v[r, lane]
    for i in range(n):
        acts[i] = False
        for r in range(targets):
            for lane in range(lanes):
                g[r, i, lane] = 0.0
    for q in range(grad.shape[0]):
        k, i, at = grad[q, 0], grad[q, 1], grad[q, 2]
        c, r, of = weight[k], owner[k], factor[k]
        if c != 0.0:
            acts[i] = True
            if of >= 0:
                for lane in range(lanes):
                    g[r, i, lane] += c * y[of, lane] * work[at, lane]
            else:
                for lane in range(lanes):
                    g[r, i, lane] += c * work[at, lane]
    for i in range(n):
        if following[i] >= 0:
            for lane in range(lanes):
                dx[i, lane] = x[following[i], lane]
            for j in range(n + p):
                for lane in range(lanes):
                    ds[i, j, lane] = s[following[i], j, lane]
        else:
            t = -1 - following[i]
            for lane in range(lanes):
                dx[i, lane] = y[t, lane]
            for j in range(n + p):
                for lane in range(lanes):
                    ds[i, j, lane] = 0.0
            # d target / dx, the inverse of A times d rho / dx, then times S.
            for k in range(n):
                if not acts[k]:
                    continue
                for lane in range(lanes):
                    row[lane] = inv[t, 0, lane] * g[0, k, lane]
                for r in range(1, targets):
                    for lane in range(lanes):
                        row[lane] += inv[t, r, lane] * g[r, k, lane]
                for j in range(n + p):
                    for lane in range(lanes):
                        ds[i, j, lane] -= row[lane] * s[k, j, lane]
    for k in range(owner.shape[0]):
        if param[k] >= 0:
            part = slot[k], owner[k], factor[k]
            _add_parameter(ds, n + param[k], share[k], part, following, scratch, lanes)
    for q in range(within.shape[0]):
        k = within[q, 0]
        if within_param[q] >= 0 and weight[k] != 0.0:
            part = within[q, 1], owner[k], factor[k]
            _add_parameter(ds, n + within_param[q], weight[k], part, following, scratch, lanes)


@kernel("contract")
def _add_parameter(ds, column, c, part, following, scratch, lanes):
    """Add to a column of S' what a part (slot, relation, target or -1) times c is of d rho by its parameter."""
    at, r, of = part
    work, inv, y, row = scratch.work, scratch.inv, scratch.y, scratch.row
    if of >= 0:
        for lane in range(lanes):
            row[lane] = c * work[at, lane] * y[of, lane]
    else:
        for lane in range(lanes):
            row[lane] = c * work[at, lane]
    for i in range(following.shape[0]):
        if following[i] < 0:
            t = -1 - following[i]
            for lane in range(lanes):
                ds[i, column, lane] -= inv[t, r, lane] * row[lane]


@kernel("contract")
def _invert(a, inv, targets, lanes):
    if targets == 1:
        for lane in range(lanes):
            inv[0, 0, lane] = 1.0 / a[0, 0, lane]
        return
    if targets == 2:
        for lane in range(lanes):
            d = 1.0 / (a[0, 0, lane] * a[1, 1, lane] - a[0, 1, lane] * a[1, 0, lane])
            inv[0, 0, lane], inv[1, 1, lane] = a[1, 1, lane] * d, a[0, 0, lane] * d
            inv[0, 1, lane], inv[1, 0, lane] = -a[0, 1, lane] * d, -a[1, 0, lane] * d
        return
    off = 0.0
    for i in range(targets):
        for j in range(targets):
            for lane in range(lanes):
                inv[i, j, lane] = 1.0 if i == j else 0.0
                off += abs(a[i, j, lane] - inv[i, j, lane])
    if off == 0.0:  # bare targets: the inverse is the identity
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
