"""What keeps a mechanism with dry friction at rest: the part of the simulation that knows sticking from sliding.

Every sign of the equations is of an edge v = c x + c0 and either *moves*, with the value 1 or -1, or is *held*, v = 0,
with the value that keeps v there. The derivative is affine in the values s of those that are held,

    v' = push - pull s,        pull = - dv' / ds,

so v' = 0 is a linear system. Where a value would leave [-1, 1] friction is overcome and the edge moves; where v
arrives at 0 the values are found within [-1, 1]: either v' = 0, or s = 1 and v' > 0, or s = -1 and v' < 0. That is a
linear complementarity problem, solved by projected Gauss-Seidel sweeps, which do not mind edges that depend on each
other, as two rates and their difference do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.parallel.kernels import kernel

SWEEPS = 200  # of Gauss-Seidel; one is exact where a single edge is held
BALANCED = 1e-13  # change of a value that ends them
SLACK = 1e-9  # by which a value may leave [-1, 1] before it is let go
NEAR = 1e-12  # of the largest that an edge has been: that near to zero it is zero


class Contacts(NamedTuple):
    """The edges and where they stand, with scratch.

    Shapes, for K edges of n states: edges (K, n + 1), held (K,), values (K,) of the signs, response (K, n) of the
    derivative to each value, pull (K, K), push (K,).
    """

    edges: FloatArray
    held: BoolArray
    values: FloatArray
    response: FloatArray
    pull: FloatArray
    push: FloatArray


@kernel(inline=True)
def along(edge: FloatArray, x: FloatArray) -> float:
    """Return v = c x + c0."""
    total = 0.0
    for i in range(x.shape[0]):
        total += edge[i] * x[i]
    return total + float(edge[x.shape[0]])


@kernel(inline=True)
def nearness(edge: FloatArray, scale: FloatArray, atol: FloatArray) -> float:
    """Return the size of v up to which it is zero.

    Args:
        edge: (n + 1,) c and c0.
        scale: (n,) the largest size that each state has had.
        atol: (n,) absolute tolerances of a step.
    """
    total = 0.0
    for i in range(scale.shape[0]):
        total += abs(edge[i]) * (0.01 * float(atol[i]) + NEAR * float(scale[i]))
    return total


@kernel()
def touch(contacts: Contacts, x: FloatArray, scale: FloatArray, atol: FloatArray) -> None:
    """Set where every edge stands at the state x (n,): held at zero, or moving with its sign.

    Args:
        contacts: held and values are written to.
        x: (n,) the state.
        scale: (n,) the largest size that each state has had.
        atol: (n,) absolute tolerances of a step.
    """
    for k in range(contacts.held.shape[0]):
        v = along(contacts.edges[k], x)
        contacts.held[k] = abs(v) <= nearness(contacts.edges[k], scale, atol)
        contacts.values[k] = 0.0 if contacts.held[k] else np.sign(v)


@kernel()
def show(contacts: Contacts, signs: FloatArray) -> None:
    """Write the values of signs as the equations are to have them: zero for those that are held."""
    for k in range(contacts.held.shape[0]):
        signs[k] = 0.0 if contacts.held[k] else contacts.values[k]


@kernel()
def balance(contacts: Contacts, out: FloatArray, limited: bool) -> None:
    """Find the values of the edges that are held, and add what they do to the derivative.

    Args:
        contacts: response holds what a value of 1 adds to the derivative, for the edges that are held. Values are
            written to; where they are limited, those that reach the limit are held no longer.
        out: (n,) the derivative without them, written to.
        limited: whether values end at -1 and 1. Without, v' = 0 and the caller looks at what it took.
    """
    edges, held, values, response, pull, push = contacts
    n, count = out.shape[0], held.shape[0]
    for k in range(count):
        if held[k]:
            push[k] = along(edges[k], out) - edges[k, n]
            for j in range(count):
                pull[k, j] = edges[k, n] - along(edges[k], response[j]) if held[j] else 0.0
    for _ in range(SWEEPS):
        change = 0.0
        for k in range(count):
            if held[k]:
                rest = push[k]
                for j in range(count):
                    if j != k:
                        rest -= pull[k, j] * values[j] if held[j] else 0.0
                # A sign that does not brake its own edge cannot hold it, and follows it.
                value = rest / pull[k, k] if pull[k, k] > 0.0 else np.sign(rest) if limited else 0.0
                if limited:
                    value = min(1.0, max(-1.0, value))
                change = max(change, abs(value - values[k]))
                values[k] = value
        if not change > BALANCED:
            break
    for k in range(count):
        if held[k]:
            for i in range(n):
                out[i] += response[k, i] * values[k]
            held[k] = not (limited and abs(values[k]) >= 1.0)


@kernel()
def lasts(contacts: Contacts, x: FloatArray, scale: FloatArray, atol: FloatArray) -> bool:
    """Say whether every edge still does what it did: moves the same way, or is held with less than all friction.

    Args:
        contacts: values are those at x.
        x: (n,) the state after a step.
        scale: (n,) the largest size that each state has had.
        atol: (n,) absolute tolerances of a step.
    """
    for k in range(contacts.held.shape[0]):
        v, near = along(contacts.edges[k], x), nearness(contacts.edges[k], scale, atol)
        if contacts.held[k]:
            if not (abs(v) <= near and abs(contacts.values[k]) <= 1.0 + SLACK):
                return False
        elif not contacts.values[k] * v >= -near:
            return False
    return True


@kernel()
def settle(contacts: Contacts, x: FloatArray, scale: FloatArray, atol: FloatArray) -> None:
    """After a step, stop the edges that have passed zero, and take from those that are held what rounding moved.

    Args:
        contacts: held and values are written to.
        x: (n,) the state, written to.
        scale: (n,) the largest size that each state has had.
        atol: (n,) absolute tolerances of a step.
    """
    n = x.shape[0]
    for k in range(contacts.held.shape[0]):
        edge = contacts.edges[k]
        v, near = along(edge, x), nearness(edge, scale, atol)
        if contacts.held[k] and abs(v) > near:
            # Nothing held it: its sign does not brake it.
            contacts.held[k], contacts.values[k] = False, np.sign(v)
        elif not contacts.held[k] and contacts.values[k] * v < -near:
            contacts.held[k] = True
        if contacts.held[k]:
            square = 0.0
            for i in range(n):
                square += edge[i] ** 2
            for i in range(n):
                x[i] -= v * edge[i] / square
