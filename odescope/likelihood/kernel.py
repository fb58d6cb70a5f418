"""The compiled kernel of the likelihood: segments integrated side by side with exact sensitivities.

Every segment of a record has its own initial state x0. Its states x and their derivatives S with respect to x0 and the
parameters follow from RK4 on x' = f and S' = f_x S + f_theta (slopes.py). Gradient and Gauss-Newton matrix of each
segment are accumulated on the fly. Lanes are segments, innermost, so that the tape and the linear algebra vectorise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.layers import step_lengths
from odescope.likelihood.slopes import STAGES, scratch_for, slopes, step_sensitivities
from odescope.parallel.kernels import kernel

SLIVER = 1.0 + 1e-12  # what is left after steps whose sum rounding keeps from that of the whole
LANES = 64  # segments side by side: states, sensitivities and tape of so many stay in a first- or second-level cache


class Averages(NamedTuple):
    """What the kernel compares with.

    Shapes: inverse_noise (c,) 1 / sigma; step of a sample in seconds, taken in `substeps` or more; start, size (J,)
    first sample and number of samples of each segment; y (N, c); weight (N, c) what 1 / sigma of a sample is multiplied
    by, 0 where there is none; u (N, 3, inputs) the inputs at begin, middle and end of the step that begins at each
    sample, parabolas between; where the middle is NaN an input goes from the one to the other at `cut` (N,), a share of
    that step.
    """

    inverse_noise: FloatArray
    step: float
    substeps: int
    start: IntArray
    size: IntArray
    y: FloatArray
    weight: FloatArray
    u: FloatArray
    cut: FloatArray


class Settings(NamedTuple):
    """What else than coefficients the kernel is told, and which of it are parameters.

    Shapes: constants (K,) values; offset (c,) what a sensor reads more than its state, offset_param (c,) the number of
    its parameter, -1 for none.
    """

    constants: FloatArray
    offset: FloatArray
    offset_param: IntArray


class Sums(NamedTuple):
    """What the kernel fills in, one entry a segment, but for `inner`, one a thread or their sum.

    Shapes: cost (J,); gradient (J, n + p); hessian (J, n, n + p) the second derivatives by the initial states and
    another, inner (p, p) those by two parameters, over all segments; last (J, n) the state at the first sample of the
    next segment; jacobian (J, n, n + p) its derivatives.
    """

    cost: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    inner: FloatArray
    last: FloatArray
    jacobian: FloatArray


@kernel(inline=True)
def _take_in(segment, lane, x0, x, s, left, which, sample, costs, gradients, hessians):
    """Begin a segment in a lane."""
    which[lane], sample[lane], left[lane], costs[lane] = segment, 0, 0.0, 0.0
    for i in range(x.shape[0]):
        x[i, lane] = x0[segment, i]
        for j in range(s.shape[1]):
            s[i, j, lane] = 1.0 if i == j else 0.0
    for i in range(s.shape[1]):
        gradients[i, lane] = 0.0
        for j in range(min(i + 1, x.shape[0])):
            hessians[i, j, lane] = 0.0


@kernel(inline=True)
def _give_out(segment, lane, x, s, costs, gradients, hessians, out):
    """Write what was accumulated of a segment, and where it ended."""
    cost, gradient, hessian, _, last, jacobian = out
    n = x.shape[0]
    cost[segment] = costs[lane]
    for i in range(s.shape[1]):
        gradient[segment, i] = gradients[i, lane]
        for j in range(min(i + 1, n)):
            hessian[segment, j, i] = hessians[i, j, lane]
            if i < n:
                hessian[segment, i, j] = hessians[i, j, lane]
    for i in range(n):
        last[segment, i] = x[i, lane]
        for j in range(s.shape[1]):
            jacobian[segment, i, j] = s[i, j, lane]


@kernel(inline=True)
def _move(one, other, x, s, left, which, sample, nodes, rest, costs, gradients, hessians):
    """Let a lane go on in the place of another."""
    which[other], sample[other], left[other], costs[other] = which[one], sample[one], left[one], costs[one]
    rest[other] = rest[one]
    for i in range(x.shape[0]):
        x[i, other] = x[i, one]
        for j in range(s.shape[1]):
            s[i, j, other] = s[i, j, one]
    for node in range(3):
        for j in range(nodes.shape[1]):
            nodes[node, j, other] = nodes[node, j, one]
    for i in range(s.shape[1]):
        gradients[i, other] = gradients[i, one]
        for j in range(min(i + 1, x.shape[0])):
            hessians[i, j, other] = hessians[i, j, one]


@kernel("contract")
def integrate(code, places, layers, effects, weight, settings, data, x0, thread, begin, end, out):
    """Integrate segments begin to end - 1 and return how many steps of RK4 all of them took.

    Cost, gradient and Gauss-Newton matrix are accumulated. Lanes do not wait for each other: every segment
    takes steps of its own length, and the next one begins where one has ended. One loop nest, because state,
    sensitivities and their sums stay in cache only while so many lanes are worked on.

    Args:
        code: instructions of the tape.
        places: where parts stand, `Places`.
        layers: what dry friction depends on, `Layers`.
        effects: where the parameters act, `Effects`.
        weight: (parts,) coefficients, shares included.
        settings: of sensors and constants, `Settings`.
        data: the measurements and how to step, `Averages`.
        x0: (J, n) initial states.
        thread: its number, and that of its entry of `Sums.inner`.
        begin: first segment.
        end: one after the last.
        out: what is accumulated, `Sums`.
    """
    following, measured, owner = places.following, places.measured, places.owner
    slot, slope_of, friction = layers
    inverse_noise, start, count = data.inverse_noise, data.start, data.size
    y_data, w_data, u_data = data.y, data.weight, data.u
    n, targets = x0.shape[1], 0
    for i in range(n):
        if following[i] < 0:
            targets += 1
    apart = True
    for k in range(owner.shape[0]):
        apart &= places.factor[k] < 0 or places.factor[k] == owner[k]
    channels, inputs, constants = y_data.shape[1], u_data.shape[2], settings.constants
    width = n + effects.first.shape[0] - 1
    x, xs, dx, xa = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n, LANES))
    s = np.empty((n, width, LANES))
    slots = n + inputs + constants.shape[0] + code.code.shape[0]
    scratch = scratch_for(slots, targets, n, effects.part.shape[0], LANES)
    for i in range(constants.shape[0]):
        scratch.work[n + inputs + i] = constants[i]
    offset, offset_param = settings.offset, settings.offset_param
    u, du, nodes = np.zeros((inputs, LANES)), np.zeros((inputs, LANES)), np.empty((3, inputs, LANES))
    # Of a lane: its segment, the average that it is at or has come from, what share is left of the way to the next, and
    # of the next step, the latter in seconds; and what is left of the way after the inputs have gone on.
    which, sample, left = np.empty(LANES, dtype=np.int64), np.empty(LANES, dtype=np.int64), np.empty(LANES)
    rest, before, way = np.empty(LANES), np.empty(LANES, dtype=np.bool_), np.empty(LANES)
    h, ahead, adds = np.empty(LANES), np.empty((STAGES, LANES)), np.empty((STAGES, LANES))
    e, scales, step, usual, taken = np.empty(LANES), np.empty(LANES), data.step, 1.0 / data.substeps, 0
    slope = np.empty((width, LANES))
    # Sums of the segments in the lanes; second derivatives by two parameters go on from one segment to the next.
    costs, gradients, hessians = np.empty(LANES), np.empty((width, LANES)), np.zeros((width, width, LANES))
    going, waiting = 0, begin
    while True:
        lane = 0
        while lane < going or (waiting < end and lane < LANES):
            if lane < going:
                if left[lane] > 0.0 or sample[lane] < count[which[lane]]:
                    lane += 1
                    continue
                _give_out(which[lane], lane, x, s, costs, gradients, hessians, out)
            if waiting < end:
                _take_in(waiting, lane, x0, x, s, left, which, sample, costs, gradients, hessians)
                waiting += 1
                lane += 1
                going = max(going, lane)
            else:
                going -= 1
                _move(going, lane, x, s, left, which, sample, nodes, rest, costs, gradients, hessians)
        if going == 0:
            break
        taken += going
        arrived = False
        for lane in range(going):
            arrived |= left[lane] <= 0.0
        for c in range(channels if arrived else 0):
            m = measured[c]
            for lane in range(going):
                row = start[which[lane]] + sample[lane]
                scales[lane] = inverse_noise[c] * w_data[row, c] if left[lane] <= 0.0 else 0.0
                e[lane] = (x[m, lane] + offset[c] - y_data[row, c]) * scales[lane] if scales[lane] > 0.0 else 0.0
            for lane in range(going):
                costs[lane] += e[lane] * e[lane]
            for i in range(width):
                for lane in range(going):
                    slope[i, lane] = scales[lane] * s[m, i, lane] if scales[lane] > 0.0 else 0.0
            if offset_param[c] >= 0:
                for lane in range(going):
                    slope[n + offset_param[c], lane] += scales[lane]
            for i in range(width):
                for lane in range(going):
                    gradients[i, lane] += slope[i, lane] * e[lane]
                for j in range(i + 1):
                    for lane in range(going):
                        hessians[i, j, lane] += slope[i, lane] * slope[j, lane]
        for lane in range(going):
            if left[lane] <= 0.0:
                for node in range(3):
                    for j in range(inputs):
                        nodes[node, j, lane] = u_data[start[which[lane]] + sample[lane], node, j]
                left[lane], rest[lane] = 1.0, 1.0 - data.cut[start[which[lane]] + sample[lane]]
                sample[lane] += 1
            before[lane] = left[lane] > rest[lane]
            way[lane] = left[lane] - rest[lane] if before[lane] else left[lane]
        for stage in range(STAGES):
            # Inputs follow the parabola through the three nodes of the average.
            share = 0.0 if stage == 0 else 2.0 if stage == STAGES - 1 else 1.0
            for j in range(inputs):
                for lane in range(going):
                    t = 1.0 - 2.0 * left[lane] + (share * h[lane] if stage else 0.0)
                    outer = (t - 1.0) * nodes[0, j, lane] + (t + 1.0) * nodes[2, j, lane]
                    value = 0.5 * t * outer + (1.0 - t * t) * nodes[1, j, lane]
                    held = nodes[0, j, lane] if before[lane] else nodes[2, j, lane]
                    u[j, lane] = held if np.isnan(nodes[1, j, lane]) else value
            for i in range(n):
                for lane in range(going):
                    xs[i, lane] = x[i, lane] + (ahead[stage - 1, lane] * dx[i, lane] if stage else 0.0)
            slopes(code, places, apart, effects, weight, stage, going, xs, u, scratch, dx)
            if stage == 0:
                for lane in range(going):
                    h[lane] = usual
                if slot.shape[0]:
                    for j in range(inputs):
                        for lane in range(going):
                            t = 1.0 - 2.0 * left[lane]
                            outer = (t - 0.5) * nodes[0, j, lane] + (t + 0.5) * nodes[2, j, lane]
                            rate = 2.0 / step * (outer - 2.0 * t * nodes[1, j, lane])
                            du[j, lane] = 0.0 if np.isnan(nodes[1, j, lane]) else rate
                    work, inv = scratch.work, scratch.inv[0]
                    step_lengths(slot, slope_of, friction, weight, owner, following, work, inv, dx, du, going, step, h)
                for lane in range(going):
                    if way[lane] <= h[lane] * SLIVER:
                        h[lane] = way[lane]
                    elif way[lane] < 2.0 * h[lane]:
                        h[lane] = 0.5 * way[lane]
                    ahead[0, lane] = ahead[1, lane] = 0.5 * step * h[lane]
                    ahead[2, lane] = step * h[lane]
                    adds[0, lane] = adds[3, lane] = step * h[lane] / 6.0
                    adds[1, lane] = adds[2, lane] = step * h[lane] / 3.0
            for i in range(n):
                for lane in range(going):
                    xa[i, lane] = adds[stage, lane] * dx[i, lane] + (xa[i, lane] if stage else x[i, lane])
        step_sensitivities(s, following, owner, apart, effects, scratch, ahead, adds, going)
        for i in range(n):
            for lane in range(going):
                x[i, lane] = xa[i, lane]
        for lane in range(going):
            left[lane] = rest[lane] if before[lane] and h[lane] == way[lane] else left[lane] - h[lane]
    for i in range(n, width):
        for j in range(n, i + 1):
            out.inner[thread, i - n, j - n] = out.inner[thread, j - n, i - n] = hessians[i, j].sum()
    return taken
