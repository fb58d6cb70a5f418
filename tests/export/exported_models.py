"""Models and records for the round trips of exports: a free run of odescope is what each is compared with."""

from dataclasses import replace

import msgspec
import numpy as np
from hand_models import relation

from odescope.commands.demo import cart_pendulum
from odescope.library.parse import Scope
from odescope.model.model import Model
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input

TIMES = 0.01 * np.arange(1001)


def driven_cart(hold="linear", delay=0.0):
    """The pendulum on a cart, hanging, an input that may be late, and offsets that no equation may notice."""
    model = cart_pendulum()
    coordinates = tuple(msgspec.structs.replace(c, offset=0.125) for c in model.coordinates)
    return replace(model, coordinates=coordinates, inputs=(Input("u", hold, "N", delay),))


def push(t=TIMES):
    """A smooth force (N, 1), of frequencies far below those of the samples."""
    return (8.0 * np.sin(2.0 * t) + 3.0 * np.cos(5.3 * t + 0.4))[:, None]


def slider():
    """Two masses on a rough table, a spring between them: edges of either and of their difference, and an offset."""
    names = ["p", "q", "p_dot", "q_dot", "f"]
    scope = Scope.of(names)
    return Model(
        (Coordinate("p", 2), Coordinate("q", 2, offset=-0.5)),
        (Input("f", "linear"),),
        (
            relation(
                scope,
                ("p_ddot", "1", 1.0),
                ("q_ddot", "1", 0.25),
                (None, "f", -1.0),
                (None, "p", 4.0),
                (None, "q", -3.0),
                (None, "p_dot", 0.1),
                (None, "sign(p_dot)", 0.9),
            ),
            relation(
                scope,
                ("q_ddot", "1", 1.0),
                ("p_ddot", "1", 0.25),
                (None, "q", 3.0),
                (None, "p", -3.0),
                (None, "sign(q_dot)", 0.7),
                (None, "q_dot", 0.05),
            ),
        ),
        domain={"p_dot": (-1.0, 1.2), "q_dot": (-1.5, 1.5)},
    )


def reactor():
    """Two concentrations of order 1, a rational rate, a square root and an input; no friction."""
    scope = Scope.of(["s", "e", "feed"])
    return Model(
        (Coordinate("s", 1, unit="mol/l"), Coordinate("e", 1)),
        (Input("feed", "zero"),),
        (
            relation(
                scope,
                ("s_dot", "1", 1.0),
                ("s_dot", "s", 0.4),
                (None, "s*e", 0.7),
                (None, "feed", -1.0),
                (None, "(s + 2.5)**-1", -0.3),
            ),
            relation(scope, ("e_dot", "1", 1.0), (None, "sqrt(s)", -1 / 3), (None, "e**2*exp(-0.5*s)", 0.9)),
        ),
    )


def free_run(model, inputs, start, t=TIMES):
    run = simulate(model, t, inputs, np.array(start, dtype=float), rtol=1e-11, atol=1e-13)
    assert run.ended is None
    return run.states
