"""One compiled kernel that integrates any model: Dormand-Prince 5(4), with steps that end wherever an input has a kink.

They also end wherever dry friction begins or ceases to hold; samples in between are read off the steps. A blow-up, a
pole or a stiff stretch that would take for ever ends the run and is reported: an outcome, not an exception and never a
hang.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.library.tape import Instructions, run_tape
from odescope.model.dormand_prince import BETWEEN, ERROR, PLACES, STAGES
from odescope.model.linear_solve import solve_in_place
from odescope.model.standstill import Contacts, balance, lasts, settle, show, touch
from odescope.parallel.kernels import kernel

STEPS_AN_INTERVAL = 2000  # more between two nodes than this, or than its share in time of all, and the run has ended:
STEPS_AT_LEAST = 100_000  # all are so many, of samples that may be far apart,
STEPS_ON_AVERAGE = 100  # and so many a node, for long records
STRICTER = 100.0  # times: so much less may a step miss that passes over samples, which had shown it what it misses
LOCATED = 1e-10  # of the time between two nodes: so sharply is it known when an edge changes
LARGEST = 1e12  # times the largest initial state, or 1
REACHED, GREW, STIFF = range(3)  # how a run ends


class Equations(NamedTuple):
    """A model as the kernel takes it.

    `instructions` compute the slots `outputs` from states, inputs and values of signs: A row by row, then b, so
    (T * T + T,) of them for T targets. following (n,) says for each state which state is its derivative, or
    -1 - (number of its target). edges (K, n + 1) are what the signs are of (see `standstill`).
    """

    instructions: Instructions
    outputs: IntArray
    following: IntArray
    edges: FloatArray


class Drive(NamedTuple):
    """Inputs that are linear between nodes: at every sample, and wherever an input has a kink between samples.

    Shapes: t (M,) seconds; sample (M,) the number of the sample that a node is, or -1; begin, end (M - 1, inputs) the
    inputs just after a node and just before the next; period (M - 1,) seconds between the samples around an interval;
    bent (M,) at which nodes an input has a kink (see `bends`).
    """

    t: FloatArray
    sample: IntArray
    begin: FloatArray
    end: FloatArray
    period: FloatArray
    bent: BoolArray

    def part(self, first: int, stop: int) -> Drive:
        """Return the drive from one sample on until before another, numbered anew."""
        low, high = (int(np.flatnonzero(self.sample == sample)[0]) for sample in (first, stop - 1))
        begin, end, period = (part[low:high] for part in (self.begin, self.end, self.period))
        sample, bent = self.sample[low : high + 1], self.bent[low : high + 1]
        return Drive(self.t[low : high + 1], np.where(sample < 0, sample, sample - first), begin, end, period, bent)


def bends(t: FloatArray, begin: FloatArray, end: FloatArray) -> BoolArray:
    """Return at which nodes (M,) an input jumps or goes on with another slope; the first and the last count as such.

    Args:
        t: (M,) the nodes, seconds.
        begin: (M - 1, inputs) just after a node.
        end: (M - 1, inputs) just before the next.
    """
    slope = (end - begin) / np.diff(t)[:, None]
    bent = np.ones(len(t), dtype=np.bool_)
    bent[1:-1] = np.any((begin[1:] != end[:-1]) | (slope[1:] != slope[:-1]), axis=1)
    return bent


@kernel(inline=True)
def _derivative(equations, x, work, a, b, out):
    """Write x' (n,) to `out`; work (slots, 1) holds inputs and signs, a (T, T) and b (T, 1) are scratch."""
    n, targets = x.shape[0], b.shape[0]
    outputs, following = equations.outputs, equations.following
    for i in range(n):
        work[i, 0] = x[i]
    run_tape(equations.instructions, work, 1)
    for i in range(targets):
        for j in range(targets):
            a[i, j] = work[outputs[i * targets + j], 0]
        b[i, 0] = work[outputs[targets * targets + i], 0]
    solve_in_place(a, b)
    for i in range(n):
        out[i] = x[following[i]] if following[i] >= 0 else b[-1 - following[i], 0]


@kernel()
def _hold(equations, x, work, a, b, contacts, limited, out):
    """Add to the derivative what edges that are held do.

    Args:
        equations: what to integrate.
        x: (n,) the state.
        work: (slots, 1) holds inputs and signs, those that are held as zero.
        a: (T, T) scratch.
        b: (T, 1) scratch.
        contacts: the edges; values of those that are held are written to.
        limited: whether they may be let go.
        out: (n,) the derivative without them, written to.
    """
    first = work.shape[0] - equations.instructions.code.shape[0] - contacts.held.shape[0]
    for k in range(contacts.held.shape[0]):
        if contacts.held[k]:
            work[first + k, 0] = 1.0
            _derivative(equations, x, work, a, b, contacts.response[k])
            work[first + k, 0] = 0.0
            for i in range(x.shape[0]):
                contacts.response[k, i] -= out[i]
    balance(contacts, out, limited)
    show(contacts, work[first:, 0])


@kernel(inline=True)
def _read_off(x, step, k, share, out):
    """Write the state (n,) at a share of a step from x (n,), of which k (7, n) are the slopes, to `out`."""
    for i in range(x.shape[0]):
        out[i] = x[i]
    for r in range(7):
        weight = 0.0
        for power in range(3, -1, -1):
            weight = (weight + BETWEEN[r, power]) * share
        for i in range(x.shape[0]):
            out[i] += step * weight * k[r, i]


@kernel()
def integrate(equations, drive, initial, states, rtol, atol):
    """Write the states (N, n) at the samples; return how many samples were reached, and how the run ended.

    Steps pass over nodes at which no input bends, where their error is a hundredth of what it may be otherwise. A step
    over which an edge changes is cut in halves until it ends there; where there are edges, no step passes over a node,
    so that none is missed that changes back. Longer than a screen because a step, its error and the length of the next
    share a dozen scalars.

    Args:
        equations: what to integrate.
        drive: the inputs, and where to record.
        initial: (n,) states at the first node.
        states: (N, n) is written to.
        rtol: tolerance of a step, relative to the largest value that a state has had: to a run, not to a value that
            happens to pass zero.
        atol: (n,) absolute tolerances of a step.
    """
    n, targets, edges = initial.shape[0], 0, equations.edges.shape[0]
    while targets * targets + targets < equations.outputs.shape[0]:
        targets += 1
    inputs, nodes = drive.begin.shape[1], drive.t.shape[0]
    work = np.empty((n + inputs + edges + equations.instructions.code.shape[0], 1))
    a, b = np.empty((targets, targets)), np.empty((targets, 1))
    x, y, k, scale = initial.copy(), np.empty(n), np.empty((7, n)), np.abs(initial)
    held, values, response = np.empty(edges, np.bool_), np.empty(edges), np.empty((edges, n))
    contacts = Contacts(equations.edges, held, values, response, np.empty((edges, edges)), np.empty(edges))
    touch(contacts, x, scale, atol)
    show(contacts, work[n + inputs :, 0])
    for i in range(x.shape[0]):
        states[0, i] = x[i]
    reached = 1
    h, total_steps = 0.0, 0
    budget = STEPS_AT_LEAST + STEPS_ON_AVERAGE * nodes
    largest = LARGEST * max(1.0, np.abs(initial).max())
    passed = 0  # the last node that the run has reached
    while passed < nodes - 1:
        first, last = passed, passed + 1
        while edges == 0 and not drive.bent[last] and last < nodes - 1:
            last += 1
        since, period = drive.t[first], drive.period[first]
        span = drive.t[last] - since
        begin, end = drive.begin[first], drive.end[last - 1]
        done, fresh = 0.0, first == 0 or edges > 0
        for j in range(inputs):  # the slopes that end a step begin the next, but for inputs that jump
            fresh = fresh or begin[j] != drive.end[first - 1, j]
        low, high = 0.0, 0.0  # between these lengths of a step an edge changes; high is 0 where none was seen
        if h <= 0.0 or h > period:
            h = period
        steps, share = 0, 0.0
        while done < span:
            if steps == 0:
                to_next = drive.t[passed + 1] - drive.t[passed]
                share = max(STEPS_AN_INTERVAL, (budget - total_steps) * to_next / (drive.t[-1] - drive.t[passed]))
            step = span - done if span - done < h * (1.0 + 1e-9) else h
            if high > 0.0:
                step = high if high - low <= LOCATED * span else 0.5 * (low + high)
            for s in range(7):
                if s == 0 and not fresh:
                    for i in range(n):
                        k[0, i] = k[6, i]
                    continue
                fraction = (done + PLACES[s] * step) / span
                for j in range(inputs):
                    work[n + j, 0] = begin[j] + fraction * (end[j] - begin[j])
                for i in range(n):
                    total = 0.0
                    for r in range(s):
                        total += STAGES[s, r] * k[r, i]
                    y[i] = x[i] + step * total
                _derivative(equations, y, work, a, b, k[s])
                if edges > 0:
                    _hold(equations, y, work, a, b, contacts, s == 0, k[s])
            error = 0.0
            for i in range(n):
                estimate = 0.0
                for r in range(7):
                    estimate += ERROR[r] * k[r, i]
                limit = atol[i] + rtol * max(scale[i], abs(y[i]))
                error += (step * estimate / limit) ** 2
            error = np.sqrt(error / n)
            over = step > period * (1.0 + 1e-9)
            if over:
                error *= STRICTER
            steps += 1
            total_steps += 1
            if error <= 1.0 and step != high and edges > 0 and not lasts(contacts, y, scale, atol):
                high, fresh = step, True
            elif error <= 1.0 and step < high:
                low, fresh = step, True
            elif error <= 1.0:
                for i in range(n):
                    scale[i] = max(scale[i], abs(y[i]))
                    if not abs(y[i]) < largest:
                        return reached, GREW
                before = done
                done = span if step == span - done else done + step
                fresh = False
                while passed < last and drive.t[passed + 1] - since <= done:
                    passed += 1
                    steps = 0
                    if drive.sample[passed] >= 0 and passed < last:
                        at = (drive.t[passed] - since - before) / step
                        _read_off(x, step, k, at, states[drive.sample[passed]])
                        reached += 1
                for i in range(n):
                    x[i] = y[i]
                if edges > 0:
                    settle(contacts, x, scale, atol)
                    show(contacts, work[n + inputs :, 0])
                    fresh, low, high = high > 0.0, 0.0, 0.0
                ahead = step * (5.0 if error < 1e-4 else min(5.0, 0.9 * error**-0.2))
                if not over:
                    ahead = max(ahead * STRICTER**-0.2, min(ahead, period))
                # A step cut short by a node says nothing of how long the next may be.
                h = max(h, ahead) if step < h else ahead
            else:
                fresh = True
                h = step * (max(0.1, 0.9 * error**-0.2) if error < 1e300 else 0.1)
                if over:
                    h = max(h, period)
                low, high = 0.0, 0.0
                if not h > 1e-12 * period:
                    return reached, GREW
            if steps > share or total_steps > budget:
                return reached, STIFF
        if drive.sample[last] >= 0:
            for i in range(x.shape[0]):
                states[drive.sample[last], i] = x[i]
            reached += 1
    return reached, REACHED
