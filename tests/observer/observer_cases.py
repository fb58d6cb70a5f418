"""What the tests of the observer share: a driven pendulum, and logs of it."""

import numpy as np
from built_models import build

from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record

PERIOD = 0.02

PENDULUM = build(
    [Coordinate("phi", order=2, angle=True)],
    [Input("u")],
    [
        ("phi_ddot", "1", 1.0),
        ("phi_ddot", "cos(phi)**2", -0.2),
        (None, "sin(phi)", 9.81),
        (None, "phi_dot*abs(phi_dot)", 0.05),
        (None, "phi_dot", 0.1),
        (None, "u*cos(phi)", -2.0),
    ],
)


def push(t):
    return 1.5 * np.sin(1.3 * t) + np.sin(2.9 * t + 1.0)


def swing(rng, samples, process=0.0):
    """True states of the pendulum; with process noise, by RK4 on an angular acceleration that is kicked between."""
    t = PERIOD * np.arange(samples)
    start = rng.uniform(-2.0, 2.0, 2)
    if not process:
        return t, simulate(PENDULUM, t, push(t)[:, None], start).states

    def right(time, x):
        moment = 2.0 * np.interp(time, t, push(t)) * np.cos(x[0])
        rest = moment - 9.81 * np.sin(x[0]) - 0.05 * x[1] * abs(x[1]) - 0.1 * x[1]
        return np.array([x[1], rest / (1.0 - 0.2 * np.cos(x[0]) ** 2)])

    steps, states, x = 4, [start], start
    h = PERIOD / steps
    for k in range(steps * (samples - 1)):
        time = k * h
        a = right(time, x)
        b = right(time + h / 2, x + h / 2 * a)
        c = right(time + h / 2, x + h / 2 * b)
        d = right(time + h, x + h * c)
        x = x + h / 6 * (a + 2 * b + 2 * c + d) + np.array([0.0, process * np.sqrt(h) * rng.standard_normal()])
        if (k + 1) % steps == 0:
            states.append(x)
    return t, np.array(states)


def log(rng, t, states, noise, counts=None):
    """The pendulum's record: its angle with noise, the velocity nowhere."""
    phi = states[:, 0] + noise * rng.standard_normal(len(t))
    behind = None if counts is None else np.column_stack([counts, np.ones(len(t))])
    return Record(t, np.column_stack([phi, push(t)]), ("phi", "u"), counts=behind)
