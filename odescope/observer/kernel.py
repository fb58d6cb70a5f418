"""The compiled extended Kalman filter and its smoother.

Between samples `prediction` carries state and covariance; at a sample every coordinate that was measured is one update,
and one that was not is none. The smoother runs back over what the filter stored in the form of Bryson and Frazier,
which is that of Rauch, Tung and Striebel without the inverse of a covariance that may be singular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.observer.prediction import across, make_room, set_inputs, set_widths
from odescope.parallel.kernels import kernel


class Readings(NamedTuple):
    """What sensors say.

    Shapes: y (N, c) readings less their offsets; variance (N, c) of their noise, infinite where nothing was measured;
    state (c,) the number of the state that each measures; angle (c,) whether readings that differ by turns are alike.
    """

    y: FloatArray
    variance: FloatArray
    state: IntArray
    angle: BoolArray


class Begin(NamedTuple):
    """What is known before the readings.

    Shapes: state (n,) and covariance (n, n) of its error at the sample `known`, and at all before it: what acted there
    was not recorded, so nothing can be followed.
    """

    state: FloatArray
    covariance: FloatArray
    known: int


class Course(NamedTuple):
    """What a filter writes, one row a sample.

    Shapes: state, deviation (N, n) after the sample; innovation, expected (N, c) readings less their predictions and
    the standard deviation of that, NaN where there is none; squared (N,) innovations in units of their covariance,
    summed; cost (1,) -2 log of the likelihood. For the smoother, or with one row for nobody: before (N, n) and spread
    (N, n, n) the prediction, transition (N, n, n) to it from the sample before.
    """

    state: FloatArray
    deviation: FloatArray
    innovation: FloatArray
    expected: FloatArray
    squared: FloatArray
    cost: FloatArray
    before: FloatArray
    spread: FloatArray
    transition: FloatArray


@kernel()
def _off(measured, j, c, x):
    """Return a reading less the state."""
    off = measured.y[j, c] - x[measured.state[c]]
    return off - 2.0 * np.pi * np.rint(off / (2.0 * np.pi)) if measured.angle[c] else off


@kernel()
def _update(x, p, m, off, variance, gain, scratch):
    """Take one reading of state m into x (n,) and p (n, n), in Joseph's form; return the variance of its innovation.

    Args:
        x: (n,) is written to.
        p: (n, n) is written to.
        m: the state that was read.
        off: the innovation.
        variance: of the noise.
        gain: (n,) is written to.
        scratch: (n, n).
    """
    n, total = x.shape[0], p[m, m] + variance
    for i in range(n):
        gain[i] = p[i, m] / total
    for i in range(n):
        x[i] += gain[i] * off
        for j in range(n):
            scratch[i, j] = p[i, j] - gain[i] * p[m, j]
    for i in range(n):
        for j in range(i + 1):
            p[i, j] = scratch[i, j] - scratch[i, m] * gain[j] + variance * gain[i] * gain[j]
            p[j, i] = p[i, j]
    return total


@kernel()
def _take(measured, j, x, p, gain, scratch, course):
    """Take the readings of a sample into the state; return what they add to -2 log of the likelihood.

    Args:
        measured: the readings.
        j: number of the sample.
        x: (n,) is written to.
        p: (n, n) is written to.
        gain: (n,) scratch.
        scratch: (n, n).
        course: its innovations are written to.
    """
    channels, cost = measured.y.shape[1], 0.0
    for c in range(channels):
        m = measured.state[c]
        seen = np.isfinite(measured.variance[j, c])
        course.innovation[j, c] = _off(measured, j, c, x) if seen else np.nan
        course.expected[j, c] = np.sqrt(p[m, m] + measured.variance[j, c]) if seen else np.nan
    course.squared[j] = 0.0
    for c in range(channels):
        if np.isfinite(measured.variance[j, c]):
            off = _off(measured, j, c, x)
            total = _update(x, p, measured.state[c], off, measured.variance[j, c], gain, scratch)
            course.squared[j] += off * off / total
            cost += off * off / total + np.log(2.0 * np.pi * total)
    return cost


@kernel()
def forward(model, drive, measured, q, begin, scale, rtol, course):
    """Filter a record; return how many samples were reached.

    Args:
        model: `LinearisedModel`.
        drive: its inputs.
        measured: the readings.
        q: (n,) spectral density of the noise in the derivative of every state.
        begin: what is known before the readings.
        scale: (n,) sizes of the states, by which errors of the integration are judged.
        rtol: tolerance of a step of the integration.
        course: is written to.
    """
    n, samples = begin.state.shape[0], measured.y.shape[0]
    room = make_room(model, drive.begin.shape[1])
    x, p, gain, scratch = begin.state.copy(), begin.covariance.copy(), np.empty(n), np.empty((n, n))
    keep = course.before.shape[0] == samples
    node, h, cost = 0, 0.0, 0.0
    for j in range(samples):
        while drive.sample[node] < min(j, begin.known):
            node += 1
        if j <= begin.known:
            course.transition[j if keep else 0] = 0.0
        else:
            set_inputs(drive, node, 0.0, n, room)
            last = node
            while drive.sample[last + 1] < 0:
                last += 1
            set_widths(model, x, p, drive.t[last + 1] - drive.t[node], room)
            room.z[:] = 0.0
            for i in range(n):
                room.z[i], room.z[n + i * n + i] = x[i], 1.0
            while node <= last:
                h = across(model, drive, node, q, scale, rtol, h, room)
                if h == 0.0:
                    return j
                node += 1
            phi = room.z[n : n + n * n].reshape(n, n)
            added = room.z[n + n * n :].reshape(n, n)
            _carry(phi, added, p, scratch)
            for i in range(n):
                x[i] = room.z[i]
                for k in range(n if keep else 0):
                    course.transition[j, i, k] = phi[i, k]
        for i in range(n if keep else 0):
            course.before[j, i] = x[i]
            for k in range(n):
                course.spread[j, i, k] = p[i, k]
        cost += _take(measured, j, x, p, gain, scratch, course)
        for i in range(n):
            if not (np.isfinite(x[i]) and p[i, i] >= 0.0):
                return j
            course.state[j, i], course.deviation[j, i] = x[i], np.sqrt(p[i, i])
    course.cost[0] = cost
    return samples


@kernel()
def _carry(phi, added, p, scratch):
    """Write phi p phi^T + added to p, all (n, n)."""
    n = p.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for m in range(n):
                total += phi[i, m] * p[m, j]
            scratch[i, j] = total
    for i in range(n):
        for j in range(i + 1):
            total = 0.5 * (added[i, j] + added[j, i])
            for m in range(n):
                total += scratch[i, m] * phi[j, m]
            p[i, j] = total
            p[j, i] = total


@kernel()
def backward(measured, course):
    """Write the smoothed states and their standard deviations over those of a filter that kept its predictions.

    Args:
        measured: the readings, as far as the filter came.
        course: of the filter; state and deviation are written to.
    """
    samples, n = course.before.shape
    channels = measured.y.shape[1]
    gradient, information, gains = np.zeros(n), np.zeros((n, n)), np.empty((channels, n))
    offs, totals, scratch, earlier = np.empty(channels), np.empty(channels), np.empty((n, n)), np.empty(n)
    for j in range(samples - 1, -1, -1):
        x, p = course.before[j].copy(), course.spread[j].copy()
        for c in range(channels):
            if np.isfinite(measured.variance[j, c]):
                offs[c] = _off(measured, j, c, x)
                totals[c] = _update(x, p, measured.state[c], offs[c], measured.variance[j, c], gains[c], scratch)
        for c in range(channels - 1, -1, -1):
            if np.isfinite(measured.variance[j, c]):
                _add(gradient, information, measured.state[c], offs[c], totals[c], gains[c])
        x, p = course.before[j], course.spread[j]
        for i in range(n):
            value, variance = x[i], p[i, i]
            for a in range(n):
                value -= p[i, a] * gradient[a]
                for b in range(n):
                    variance -= p[i, a] * information[a, b] * p[i, b]
            course.state[j, i], course.deviation[j, i] = value, np.sqrt(max(variance, 0.0))
        phi = course.transition[j]
        for i in range(n):
            earlier[i] = 0.0
            for a in range(n):
                earlier[i] += phi[a, i] * gradient[a]
                scratch[i, a] = 0.0
                for b in range(n):
                    scratch[i, a] += phi[b, i] * information[b, a]
        for i in range(n):
            gradient[i] = earlier[i]
            for a in range(n):
                information[i, a] = 0.0
                for b in range(n):
                    information[i, a] += scratch[i, b] * phi[b, a]


@kernel()
def _add(gradient, information, m, off, total, gain):
    """Take a reading of state m into what later readings say of the state: their misfit's gradient, and information.

    Args:
        gradient: (n,) is written to.
        information: (n, n) is written to.
        m: the state that was read.
        off: its innovation.
        total: the variance of that.
        gain: (n,) of the filter.
    """
    n, along = gradient.shape[0], 0.0
    for i in range(n):
        along += gain[i] * gradient[i]
    gradient[m] -= along + off / total
    for i in range(n):
        along = 0.0
        for k in range(n):
            along += information[i, k] * gain[k]
        information[i, m] -= along
    for i in range(n):
        along = 0.0
        for k in range(n):
            along += gain[k] * information[k, i]
        information[m, i] -= along
    information[m, m] += 1.0 / total
