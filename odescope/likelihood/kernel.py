"""The compiled kernel of the likelihood: segments integrated side by side with exact sensitivities.

Every segment of a record has its own initial state x0. Its states x and their derivatives S with respect to x0 and the
parameters follow from RK4 on x' = f and S' = f_x S + f_theta. Targets y solve A(x, u) y = b(x, u), so by the implicit
function theorem A dy = -(d rho/dx dx + d rho/d theta), with rho = A y - b. Gradient and Gauss-Newton matrix of each
segment are accumulated on the fly. Lanes are segments, innermost, so that the tape and the linear algebra vectorise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.library.tape import run_tape
from odescope.model.linear_solve import solve_in_place
from odescope.parallel.kernels import kernel

LANES = 48  # segments side by side: states, sensitivities and tape of so many stay in a first- or second-level cache


class Averages(NamedTuple):
    """What the kernel compares with.

    Shapes: inverse_noise (c,) 1 / sigma; step of a sample in seconds, taken in `substeps`; start, size (J,) first
    sample and number of samples of each segment; y (N, c); weight (N, c) what 1 / sigma of a sample is multiplied by, 0
    where there is none; u (N, 2 substeps + 1, inputs) the inputs on the half steps of the step that begins at each
    sample.
    """

    inverse_noise: FloatArray
    step: float
    substeps: int
    start: IntArray
    size: IntArray
    y: FloatArray
    weight: FloatArray
    u: FloatArray


class Settings(NamedTuple):
    """What else than coefficients the kernel is told, and which of it are parameters.

    Shapes: constants (K,) values; offset (c,) what a sensor reads more than its state, offset_param (c,) the number of
    its parameter, -1 for none; within_param (Q,) the same for every entry of `Places.within`.
    """

    constants: FloatArray
    offset: FloatArray
    offset_param: IntArray
    within_param: IntArray


class Sums(NamedTuple):
    """What the kernel fills in, one entry a segment.

    Shapes: cost (J,); gradient (J, n + p); hessian (J, n + p, n + p); last (J, n) the state at the first sample of the
    next segment; jacobian (J, n, n + p) its derivatives.
    """

    cost: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    last: FloatArray
    jacobian: FloatArray


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
def _slopes(code, places, param, weight, within_param, p, lanes, x, s, u, scratch, dx, ds):
    """Compute x' and S' of all lanes: one function, because what it computes on the way stays in cache.

    Shapes: x, dx (n, L); s, ds (n, n + p, L); u (inputs, L); param, weight one entry a part.
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


@kernel("contract")
def integrate(code, places, param, weight, settings, p, data, x0, begin, end, out):
    """Integrate segments begin to end - 1 and accumulate cost, gradient and Gauss-Newton matrix of each.

    One loop nest, because state, sensitivities and their sums stay in cache only while a block of lanes is worked on.

    Args:
        code: instructions of the tape.
        places: where parts stand, `Places`.
        param: (parts,) number of the parameter that a part's coefficient is a share of, -1 for none.
        weight: (parts,) coefficients, shares included.
        settings: of sensors and constants, `Settings`.
        p: number of parameters.
        data: the measurements and how to step, `Averages`.
        x0: (J, n) initial states.
        begin: first segment.
        end: one after the last.
        out: what is accumulated, `Sums`.
    """
    following, measured = places.following, places.measured
    inverse_noise, substeps, start, count = data.inverse_noise, data.substeps, data.start, data.size
    y_data, w_data, u_data = data.y, data.weight, data.u
    cost, gradient, hessian, last, jacobian = out
    n, targets = x0.shape[1], 0
    for i in range(n):
        if following[i] < 0:
            targets += 1
    channels, inputs = y_data.shape[1], u_data.shape[2]
    width = n + p
    x, xs, dx, xa = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n, LANES))
    s, ss = np.empty((n, width, LANES)), np.empty((n, width, LANES))
    ds, sa = np.empty((n, width, LANES)), np.empty((n, width, LANES))
    scratch = Scratch(
        np.zeros((n + inputs + settings.constants.shape[0] + code.code.shape[0], LANES)),
        np.empty((targets, targets, LANES)),
        np.empty((targets, targets, LANES)),
        np.empty((targets, LANES)),
        np.empty((targets, n, LANES)),
        np.empty((targets, LANES)),
        np.empty(LANES),
        np.empty(n, dtype=np.bool_),
    )
    for i in range(settings.constants.shape[0]):
        scratch.work[n + inputs + i] = settings.constants[i]
    offset, offset_param, within_param = settings.offset, settings.offset_param, settings.within_param
    u, e, scales = np.zeros((inputs, LANES)), np.empty(LANES), np.empty(LANES)
    slope = np.empty((width, LANES))
    # Sums of the lanes, which go out when their block is done.
    costs, gradients, hessians = np.empty(LANES), np.empty((width, LANES)), np.empty((width, width, LANES))
    step = data.step / substeps
    for low in range(begin, end, LANES):
        lanes = min(LANES, end - low)
        longest = 0
        for lane in range(lanes):
            longest = max(longest, count[low + lane])
            for i in range(n):
                x[i, lane] = x0[low + lane, i]
        s[:], costs[:], gradients[:], hessians[:] = 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            for lane in range(lanes):
                s[i, i, lane] = 1.0
        for k in range(longest):
            for c in range(channels):
                m = measured[c]
                for lane in range(lanes):
                    row, inside = start[low + lane] + k, k < count[low + lane]
                    scales[lane] = inverse_noise[c] * w_data[row, c] if inside else 0.0
                    e[lane] = (x[m, lane] + offset[c] - y_data[row, c]) * scales[lane] if scales[lane] > 0.0 else 0.0
                for lane in range(lanes):
                    costs[lane] += e[lane] * e[lane]
                for i in range(width):
                    for lane in range(lanes):
                        slope[i, lane] = scales[lane] * s[m, i, lane] if scales[lane] > 0.0 else 0.0
                if offset_param[c] >= 0:
                    for lane in range(lanes):
                        slope[n + offset_param[c], lane] += scales[lane]
                for i in range(width):
                    for lane in range(lanes):
                        gradients[i, lane] += slope[i, lane] * e[lane]
                    for j in range(i + 1):
                        for lane in range(lanes):
                            hessians[i, j, lane] += slope[i, lane] * slope[j, lane]
            for part in range(substeps):
                for stage in range(4):
                    node = 2 * part + (0 if stage == 0 else 1 if stage < 3 else 2)
                    for j in range(inputs):
                        for lane in range(lanes):
                            row = min(start[low + lane] + k, u_data.shape[0] - 1)
                            u[j, lane] = u_data[row, node, j]
                    f = 0.0 if stage == 0 else step if stage == 3 else 0.5 * step
                    for i in range(n):
                        for lane in range(lanes):
                            xs[i, lane] = x[i, lane] + (f * dx[i, lane] if stage else 0.0)
                        for j in range(width):
                            for lane in range(lanes):
                                ss[i, j, lane] = s[i, j, lane] + (f * ds[i, j, lane] if stage else 0.0)
                    _slopes(code, places, param, weight, within_param, p, lanes, xs, ss, u, scratch, dx, ds)
                    share = step / 6.0 if stage == 0 or stage == 3 else step / 3.0
                    for i in range(n):
                        for lane in range(lanes):
                            xa[i, lane] = share * dx[i, lane] + (xa[i, lane] if stage else x[i, lane])
                        for j in range(width):
                            for lane in range(lanes):
                                sa[i, j, lane] = share * ds[i, j, lane] + (sa[i, j, lane] if stage else s[i, j, lane])
                for i in range(n):
                    for lane in range(lanes):
                        x[i, lane] = xa[i, lane]
                    for j in range(width):
                        for lane in range(lanes):
                            s[i, j, lane] = sa[i, j, lane]
            for lane in range(lanes):
                if k == count[low + lane] - 1:
                    for i in range(n):
                        last[low + lane, i] = x[i, lane]
                        for j in range(width):
                            jacobian[low + lane, i, j] = s[i, j, lane]
        for lane in range(lanes):
            cost[low + lane] = costs[lane]
            for i in range(width):
                gradient[low + lane, i] = gradients[i, lane]
                for j in range(i + 1):
                    hessian[low + lane, i, j] = hessian[low + lane, j, i] = hessians[i, j, lane]
