"""The states that a fit says there are at every average of a record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.likelihood.fit import Fit
from odescope.likelihood.search_space import SearchSpace


def followed(space: SearchSpace, found: Fit) -> tuple[FloatArray, BoolArray]:
    """Return what a fit says of every average (N, c), and which of these (N,) are in a segment.

    Args:
        space: of the fit.
        found: it.
    """
    states, seen = states_of(space, found)
    offsets = space.program(found.present).offsets
    theta = found.theta[found.present]
    return states[:, space.frame.measured] + np.where(offsets < 0, 0.0, theta[offsets]), seen


def states_of(space: SearchSpace, found: Fit) -> tuple[FloatArray, BoolArray]:
    """Return the states (N, n) of a fit at every average, and which of these (N,) are in a segment.

    Args:
        space: of the fit.
        found: it.
    """
    segments, count = space.segments, space.segments.count
    states, seen = np.zeros((len(segments.measured), found.x0.shape[1])), np.zeros(len(segments.measured), np.bool_)
    seen[segments.start], states[segments.start] = True, found.x0
    # A run to every average from the start of its segment: the kernel gives the end of each.
    owner = np.repeat(np.arange(len(count)), count - 1)
    steps = np.concatenate([np.arange(1, n) for n in count])
    runs = replace(segments, start=segments.start[owner], count=steps, joined=np.zeros(len(owner), np.bool_))
    program, none = space.program(found.present), np.zeros(0, dtype=np.int64)
    at = segments.start[owner] + steps
    ends = space.on(runs).evaluator.integrate(program, found.theta[found.present], none, found.x0[owner]).last
    states[at], seen[at] = ends, True
    return states, seen
