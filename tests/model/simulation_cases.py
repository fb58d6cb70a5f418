"""What the tests of simulation and simulation_ends share."""

import numpy as np
from built_models import build

from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input


def free(model, t, initial, **options):
    return simulate(model, t, np.empty((len(t), 0)), np.asarray(initial, dtype=float), **options)


X, Y = Coordinate("x"), Coordinate("y")


DECAY = build([X], [], [("x_dot", "1", 1.0), (None, "x", 1.0)])


# a pendulum on a cart: its raw Lagrange equations, and solved for the accelerations
MC, M1, A1, I1, BC, B1, G = 1.2, 0.4, 0.3, 0.012, 3.0, 0.02, 9.81


CART_COORDINATES = [Coordinate("x", order=2, cyclic=True), Coordinate("phi", order=2, angle=True)]


def lagrange(hold):
    return build(
        CART_COORDINATES,
        [Input("u", hold=hold)],
        [
            ("x_ddot", "1", MC + M1),
            ("phi_ddot", "cos(phi)", M1 * A1),
            (None, "u", -1.0),
            (None, "x_dot", BC),
            (None, "sin(phi)*phi_dot**2", -M1 * A1),
        ],
        [
            ("phi_ddot", "1", I1 + M1 * A1**2),
            ("x_ddot", "cos(phi)", M1 * A1),
            (None, "phi_dot", B1),
            (None, "sin(phi)", M1 * G * A1),
        ],
    )
