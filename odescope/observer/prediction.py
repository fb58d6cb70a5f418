"""Compiled prediction of an observer: the state and the spread of its error from one sample to the next.

The state follows x' = f(x, u), the transition of small errors Phi' = F Phi with F = df/dx, and what process noise of
spectral density q adds W' = F W + W F^T + diag(q), all three by Dormand-Prince 5(4) with the steps that the error asks
for. A sign(v), as of dry friction, is replaced by its mean over the spread of v: docs/method.md, Observer.
"""

from __future__ import annotations

from math import erf, exp, sqrt
from typing import NamedTuple

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.tape import run_tape
from odescope.model.dormand_prince import ERROR, PLACES, STAGES
from odescope.model.linear_solve import solve_in_place
from odescope.parallel.kernels import kernel

STEPS_AN_INTERVAL = 2000  # more than this between two nodes and the prediction has failed
SQRT_2 = sqrt(2.0)
PEAK = sqrt(2.0 / np.pi)  # of the slope of the mean sign of a normal deviate, times its standard deviation
SHARPEST = 0.01  # of what friction does to an edge between two samples: narrower signs are too stiff to follow
NARROWEST = 1e-12  # of the size of an edge: a width is not nothing
SPREAD_ERROR = 1e-4  # of the covariance at the sample before: what the added spread may be off by in a step


class Room(NamedTuple):
    """Scratch of a prediction.

    Shapes, for n states, T targets, K signs: work (slots, 1); a (T, T); y (T, 1); rho (T, n + K); by_sign (n, K);
    widths (K,) over which signs are averaged; spread (n,) standard deviations at the sample before; f (n, n); z, trial
    (n + 2 n n,) state, transition, added spread; k (7, n + 2 n n) the slopes of a step.
    """

    work: FloatArray
    a: FloatArray
    y: FloatArray
    rho: FloatArray
    by_sign: FloatArray
    widths: FloatArray
    spread: FloatArray
    f: FloatArray
    z: FloatArray
    trial: FloatArray
    k: FloatArray


@kernel()
def make_room(model, inputs):
    """Return the scratch that a prediction of a model, `LinearisedModel`, with so many inputs takes."""
    n, signs, targets = model.following.shape[0], model.edges.shape[0], 0
    for i in range(n):
        targets += 1 if model.following[i] < 0 else 0
    size = n + 2 * n * n
    return Room(
        np.empty((n + inputs + signs + model.instructions.code.shape[0], 1)),
        np.empty((targets, targets)),
        np.empty((targets, 1)),
        np.empty((targets, n + signs)),
        np.empty((n, signs)),
        np.empty(signs),
        np.empty(n),
        np.empty((n, n)),
        np.empty(size),
        np.empty(size),
        np.empty((7, size)),
    )


@kernel()
def _linear(model, x, room, dx):
    """Write f(x, u) to `dx` (n,), its derivatives to room.f and those with respect to signs to room.by_sign.

    The inputs are in room.work. With rho = A y - b and A y = b the implicit function theorem has A dy = -d rho.
    """
    work, a, y, rho = room.work, room.a, room.y, room.rho
    n, targets, signs = x.shape[0], y.shape[0], model.edges.shape[0]
    following, outputs = model.following, model.outputs
    first = work.shape[0] - model.instructions.code.shape[0] - signs
    for i in range(n):
        work[i, 0] = x[i]
    for s in range(signs):
        v = model.edges[s, n]
        for i in range(n):
            v += model.edges[s, i] * x[i]
        work[first + s, 0] = erf(v / (SQRT_2 * room.widths[s]))
    run_tape(model.instructions, work, 1)
    for r in range(targets):
        for t in range(targets):
            a[r, t] = work[outputs[r * targets + t], 0]
        y[r, 0] = work[outputs[targets * targets + r], 0]
    solve_in_place(a, y)
    rho[:] = 0.0
    for g in range(model.gradient.shape[0]):
        entry, variable, value = model.gradient[g, 0], model.gradient[g, 1], work[model.gradient[g, 2], 0]
        if entry < targets * targets:
            rho[entry // targets, variable] -= y[entry % targets, 0] * value
        else:
            rho[entry - targets * targets, variable] += value
    for r in range(targets):
        for t in range(targets):
            a[r, t] = work[outputs[r * targets + t], 0]
    solve_in_place(a, rho)
    room.f[:] = 0.0
    room.by_sign[:] = 0.0
    for i in range(n):
        if following[i] >= 0:
            dx[i] = x[following[i]]
            room.f[i, following[i]] = 1.0
        else:
            t = -1 - following[i]
            dx[i] = y[t, 0]
            for j in range(n):
                room.f[i, j] = rho[t, j]
            for s in range(signs):
                room.by_sign[i, s] = rho[t, n + s]
    for s in range(signs):
        v = model.edges[s, n]
        for i in range(n):
            v += model.edges[s, i] * x[i]
        gain = PEAK / room.widths[s] * exp(-0.5 * (v / room.widths[s]) ** 2)
        for i in range(n):
            for j in range(n):
                room.f[i, j] += room.by_sign[i, s] * gain * model.edges[s, j]


@kernel()
def _slope(model, z, q, room, out):
    """Write the derivative of state, transition and added spread at z (n + 2 n n,) to `out`."""
    n, f = q.shape[0], room.f
    _linear(model, z[:n], room, out[:n])
    for i in range(n):
        for j in range(n):
            moved, spread = 0.0, q[i] if i == j else 0.0
            for m in range(n):
                moved += f[i, m] * z[n + m * n + j]
                spread += f[i, m] * z[n + n * n + m * n + j] + z[n + n * n + i * n + m] * f[j, m]
            out[n + i * n + j] = moved
            out[n + n * n + i * n + j] = spread


@kernel()
def set_widths(model, x, p, span, room):
    """Set over which widths the signs are averaged until the next sample, and the spread that its steps begin with.

    A width is the standard deviation of what the sign is of, but no less than a hundredth of what friction can do to it
    until then. With a finite width what sticks creeps, by up to about that width; a narrower one takes more steps.

    Args:
        model: `LinearisedModel`.
        x: (n,) the state.
        p: (n, n) the covariance of its error.
        span: seconds to the next sample.
        room: its widths and spread are written to; the inputs are in its work.
    """
    n, signs = x.shape[0], model.edges.shape[0]
    for i in range(n):
        room.spread[i] = sqrt(max(p[i, i], 0.0))
    for s in range(signs):
        variance, size = 0.0, abs(model.edges[s, n])
        for i in range(n):
            size += abs(model.edges[s, i] * x[i])
            for j in range(n):
                variance += model.edges[s, i] * p[i, j] * model.edges[s, j]
        room.widths[s] = max(sqrt(max(variance, 0.0)), NARROWEST * size, 1e-100)
    if signs > 0:
        _linear(model, x, room, room.trial[:n])
        for s in range(signs):
            pull = 0.0
            for i in range(n):
                pull -= model.edges[s, i] * room.by_sign[i, s]
            room.widths[s] = max(room.widths[s], SHARPEST * pull * span)


@kernel()
def set_inputs(drive, node, fraction, first, room):
    """Write the inputs at a fraction of the interval after a node to room.work, from row `first` on.

    Args:
        drive: the inputs.
        node: at which the interval begins.
        fraction: of the interval, 0 to 1.
        first: row of the first input.
        room: is written to.
    """
    begin, end = drive.begin[node], drive.end[node]
    for j in range(begin.shape[0]):
        room.work[first + j, 0] = begin[j] + fraction * (end[j] - begin[j])


@kernel()
def _error(k, step, scale, rtol, spread):
    """Return the root mean square error of a step in its units.

    The error of a state counts by its size, that of the transition by what it does to states of such sizes, that of the
    added spread beside the one before. Where friction sticks the added spread falls twice as fast as the transition
    does, and a step that is stable for the one is not for the other.

    Args:
        k: (7, n + 2 n n) the slopes of the step.
        step: its length.
        scale: (n,) sizes of the states.
        rtol: tolerance of state and transition.
        spread: (n,) standard deviations at the sample before.
    """
    n, size, error = scale.shape[0], k.shape[1], 0.0
    for i in range(size):
        estimate = 0.0
        for r in range(7):
            estimate += ERROR[r] * k[r, i]
        row, column = (i - n) // n % n, (i - n) % n
        if i < n:
            unit = rtol * scale[i]
        elif i < n + n * n:
            unit = rtol * scale[row] / scale[column]
        else:
            unit = SPREAD_ERROR * (spread[row] * spread[column] + rtol * scale[row] * scale[column])
        error += (step * estimate / unit) ** 2
    return sqrt(error / size)


@kernel()
def across(model, drive, node, q, scale, rtol, h, room):
    """Carry room.z over the interval after a node; return the length of the next step, 0 where it cannot be followed.

    The step is that at which state, transition and added spread are right (`_error`).

    Args:
        model: `LinearisedModel`.
        drive: the inputs.
        node: at which the interval begins.
        q: (n,) spectral density of the noise in the derivative of every state.
        scale: (n,) sizes of the states.
        rtol: tolerance of a step.
        h: length of the first step, in seconds; 0 where none is known.
        room: z is written to.
    """
    n, z, trial, k, spread = q.shape[0], room.z, room.trial, room.k, room.spread
    span, done, fresh, steps = drive.t[node + 1] - drive.t[node], 0.0, True, 0
    if h <= 0.0 or h > drive.period[node]:
        h = drive.period[node]
    while done < span:
        step = span - done if span - done < h * (1.0 + 1e-9) else h
        for s in range(7):
            if s == 0 and not fresh:
                for i in range(z.shape[0]):
                    k[0, i] = k[6, i]
                continue
            set_inputs(drive, node, (done + PLACES[s] * step) / span, n, room)
            for i in range(z.shape[0]):
                total = 0.0
                for r in range(s):
                    total += STAGES[s, r] * k[r, i]
                trial[i] = z[i] + step * total
            _slope(model, trial, q, room, k[s])
        error = _error(k, step, scale, rtol, spread)
        steps += 1
        if error <= 1.0:
            done = span if step == span - done else done + step
            fresh = False
            for i in range(z.shape[0]):
                z[i] = trial[i]
            grown = 5.0 if error < 1e-4 else min(5.0, 0.9 * error**-0.2)
            h = max(h, step * grown) if step < h else step * grown
        else:
            fresh = True
            h = step * (max(0.1, 0.9 * error**-0.2) if error < 1e300 else 0.1)
        if steps > STEPS_AN_INTERVAL or not h > 1e-12 * span:
            return 0.0
    return h
