"""Runs of a machine under inputs that may be held, late, computed from where the machine is, and disturbed.

Between two samples the solver stops wherever an input has a kink or a step and begins afresh behind it, so that no step
passes over one. Dry friction is steep rather than a step, tanh(v/width), and error control resolves it.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.integrate import DOP853

Rate = Callable[[np.ndarray, np.ndarray], np.ndarray]  # the derivative of the states, of states and inputs
Drive = Callable[[int, np.ndarray], np.ndarray]  # the inputs commanded at a sample, given the last states known then


def travel(
    rate: Rate,
    t: np.ndarray,
    drive: Drive,
    start: np.ndarray,
    beside: np.ndarray,
    delay: float = 0.0,
    held: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (N, n) at the samples, and the inputs (N, m) commanded there.

    A linear input is computed one sample ahead, from the states at the sample before; a held one from those at its own.

    Args:
        rate: of the states under the inputs that act.
        t: (N,) sample times.
        drive: what commands.
        start: (n,) states at t[0]; before, the first command acted.
        beside: (N, m) what acts beside the inputs, constant from each sample to the next.
        delay: seconds from command to action.
        held: samples that a command is held; 0: commands are linear between samples.
    """
    states, commands = np.empty((len(t), len(start))), np.empty(beside.shape)
    states[0], commands[0] = start, drive(0, start)
    since, level, slope = t[0], np.zeros(beside.shape[1]), np.zeros(beside.shape[1])

    def acting(now: float, s: np.ndarray) -> np.ndarray:
        return rate(s, level + (now - since) * slope)

    solver = DOP853(acting, t[0], start, t[1], rtol=1e-9, atol=1e-11)
    for k in range(len(t) - 1):
        if not held:
            commands[k + 1] = drive(k + 1, states[k])
        kinks = t[slice(*np.searchsorted(t, (t[k] - delay, t[k + 1] - delay)))] + delay
        nodes = [t[k], *(c for c in kinks if t[k] < c < t[k + 1]), t[k + 1]]
        for since, end in pairwise(nodes):
            # The middle of an interval lies off every kink, so that rounding cannot pick the command beside.
            j = int(np.searchsorted(t, 0.5 * (since + end) - delay, side="right")) - 1
            if held or j < 0:
                level, slope = commands[max(j, 0)] + beside[k], np.zeros(beside.shape[1])
            else:
                slope = (commands[j + 1] - commands[j]) / (t[j + 1] - t[j])
                level = commands[j] + (since - delay - t[j]) * slope + beside[k]
            solver.t_bound, solver.status, solver.f = end, "running", acting(since, solver.y)
            while solver.status == "running":
                failure = solver.step()
                if failure:
                    raise RuntimeError(failure)
        states[k + 1] = solver.y
        if held:
            commands[k + 1] = commands[k] if (k + 1) % held else drive(k + 1, states[k + 1])
    return states, commands
