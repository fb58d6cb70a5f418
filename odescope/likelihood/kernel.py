"""The compiled kernel of the likelihood: segments integrated side by side with exact sensitivities.

Every segment of a record has its own initial state x0. Its states x and their derivatives S with respect to x0 and the
parameters follow from RK4 on x' = f and S' = f_x S + f_theta. Targets y solve A(x, u) y = b(x, u), so by the implicit
function theorem A dy = -(d rho/dx dx + d rho/d theta), with rho = A y - b. Gradient and Gauss-Newton matrix of each
segment are accumulated on the fly. Lanes are segments, innermost, so that the tape and the linear algebra vectorise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.layers import step_lengths
from odescope.likelihood.slopes import Scratch, slopes
from odescope.parallel.kernels import kernel

SLIVER = 1.0 + 1e-12  # what is left after steps whose sum rounding keeps from that of the whole
LANES = 64  # segments side by side: states, sensitivities and tape of so many stay in a first- or second-level cache


class Averages(NamedTuple):
    """What the kernel compares with.

    Shapes: inverse_noise (c,) 1 / sigma; step of a sample in seconds, taken in `substeps` or more; start, size (J,)
    first sample and number of samples of each segment; y (N, c); weight (N, c) what 1 / sigma of a sample is multiplied
    by, 0 where there is none; u (N, 3, inputs) the inputs at begin, middle and end of the step that begins at each
    sample, parabolas between.
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


@kernel(inline=True)
def _swap(x, s, left, nodes, who, one, other):
    """Let two lanes change places."""
    for i in range(x.shape[0]):
        x[i, one], x[i, other] = x[i, other], x[i, one]
        for j in range(s.shape[1]):
            s[i, j, one], s[i, j, other] = s[i, j, other], s[i, j, one]
    for node in range(3):
        for j in range(nodes.shape[1]):
            nodes[node, j, one], nodes[node, j, other] = nodes[node, j, other], nodes[node, j, one]
    left[one], left[other] = left[other], left[one]
    who[one], who[other] = who[other], who[one]


@kernel("contract")
def integrate(code, places, layers, param, weight, settings, p, data, x0, begin, end, out):
    """Integrate segments begin to end - 1 and return how many steps of RK4 all of them took.

    Cost, gradient and Gauss-Newton matrix of each are accumulated. Every segment takes steps of its own length, side by
    side with those that are not yet at the next average either: the others stand behind them. One loop nest, because
    state, sensitivities and their sums stay in cache only while a block of lanes is worked on.

    Args:
        code: instructions of the tape.
        places: where parts stand, `Places`.
        layers: what dry friction depends on, `Layers`.
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
    following, measured, owner = places.following, places.measured, places.owner
    slot, slope_of, friction = layers
    inverse_noise, start, count = data.inverse_noise, data.start, data.size
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
    work = np.zeros((n + inputs + settings.constants.shape[0] + code.code.shape[0], LANES))
    inv = np.empty((targets, targets, LANES))
    scratch = Scratch(
        work,
        np.empty((targets, targets, LANES)),
        inv,
        np.empty((targets, LANES)),
        np.empty((targets, n, LANES)),
        np.empty((targets, LANES)),
        np.empty(LANES),
        np.empty(n, dtype=np.bool_),
    )
    for i in range(settings.constants.shape[0]):
        work[n + inputs + i] = settings.constants[i]
    offset, offset_param, within_param = settings.offset, settings.offset_param, settings.within_param
    u, du, nodes = np.zeros((inputs, LANES)), np.zeros((inputs, LANES)), np.empty((3, inputs, LANES))
    # Of the average: what share is left of it, of the next step, the latter in seconds; who stands in each place.
    left, h, f, who = np.empty(LANES), np.empty(LANES), np.empty(LANES), np.empty(LANES, dtype=np.int64)
    e, scales, step, usual, taken = np.empty(LANES), np.empty(LANES), data.step, 1.0 / data.substeps, 0
    slope = np.empty((width, LANES))
    # Sums of the lanes, which go out when their block is done.
    costs, gradients, hessians = np.empty(LANES), np.empty((width, LANES)), np.empty((width, width, LANES))
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
            for lane in range(lanes):
                left[lane] = 1.0 if k < count[low + lane] else 0.0
                who[lane] = lane
            for node in range(3):
                for j in range(inputs):
                    for lane in range(lanes):
                        nodes[node, j, lane] = u_data[min(start[low + lane] + k, u_data.shape[0] - 1), node, j]
            going = lanes
            while True:
                lane = 0
                while lane < going:
                    if left[going - 1] <= 0.0:
                        going -= 1
                    elif left[lane] > 0.0:
                        lane += 1
                    else:
                        going -= 1
                        _swap(x, s, left, nodes, who, lane, going)
                if going == 0:
                    break
                taken += going
                for stage in range(4):
                    # Inputs follow the parabola through the three nodes of the average.
                    share = 0.0 if stage == 0 else 2.0 if stage == 3 else 1.0
                    for j in range(inputs):
                        for lane in range(going):
                            t = 1.0 - 2.0 * left[lane] + (share * h[lane] if stage else 0.0)
                            outer = (t - 1.0) * nodes[0, j, lane] + (t + 1.0) * nodes[2, j, lane]
                            u[j, lane] = 0.5 * t * outer + (1.0 - t * t) * nodes[1, j, lane]
                    if stage == 0:
                        slopes(code, places, param, weight, within_param, p, going, x, s, u, scratch, dx, ds)
                        for lane in range(going):
                            h[lane] = usual
                        if slot.shape[0]:
                            for j in range(inputs):
                                for lane in range(going):
                                    t = 1.0 - 2.0 * left[lane]
                                    outer = (t - 0.5) * nodes[0, j, lane] + (t + 0.5) * nodes[2, j, lane]
                                    du[j, lane] = 2.0 / step * (outer - 2.0 * t * nodes[1, j, lane])
                            step_lengths(
                                slot, slope_of, friction, weight, owner, following, work, inv, dx, du, going, step, h
                            )
                        for lane in range(going):
                            if left[lane] <= h[lane] * SLIVER:
                                h[lane] = left[lane]
                            elif left[lane] < 2.0 * h[lane]:
                                h[lane] = 0.5 * left[lane]
                    else:
                        for lane in range(going):
                            f[lane] = 0.5 * share * step * h[lane]
                        for i in range(n):
                            for lane in range(going):
                                xs[i, lane] = x[i, lane] + f[lane] * dx[i, lane]
                            for j in range(width):
                                for lane in range(going):
                                    ss[i, j, lane] = s[i, j, lane] + f[lane] * ds[i, j, lane]
                        slopes(code, places, param, weight, within_param, p, going, xs, ss, u, scratch, dx, ds)
                    for lane in range(going):
                        f[lane] = step * h[lane] / (6.0 if stage == 0 or stage == 3 else 3.0)
                    for i in range(n):
                        for lane in range(going):
                            xa[i, lane] = f[lane] * dx[i, lane] + (xa[i, lane] if stage else x[i, lane])
                        for j in range(width):
                            for lane in range(going):
                                sa[i, j, lane] = f[lane] * ds[i, j, lane] + (sa[i, j, lane] if stage else s[i, j, lane])
                for i in range(n):
                    for lane in range(going):
                        x[i, lane] = xa[i, lane]
                    for j in range(width):
                        for lane in range(going):
                            s[i, j, lane] = sa[i, j, lane]
                for lane in range(going):
                    left[lane] -= h[lane]
            for lane in range(lanes):
                while who[lane] != lane:
                    _swap(x, s, left, nodes, who, lane, who[lane])
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
    return taken
