"""Models that were found as mechanisms: a cart with a pendulum, and an enzyme; standard errors are a share of all."""

import numpy as np

from odescope.library.lagrangian import lagrangian
from odescope.library.parse import Scope
from odescope.library.reactions import reactions
from odescope.model.assembled import relations_of, stated
from odescope.model.model import Model
from odescope.recordings.coordinate import Coordinate, Input, state_names

CART = (Coordinate("x", 2, cyclic=True, unit="m"), Coordinate("phi", 2, angle=True))
FORCE = (Input("u", unit="N"),)
SPECIES = tuple(Coordinate(name, unit="mol") for name in "SEC")


def model_of(coordinates, inputs, mechanisms, theta, error):
    theta, known = np.array(theta), np.array([m.known is None for m in mechanisms])
    covariance = np.diag((error * theta * known) ** 2)
    relations = relations_of(mechanisms, theta, covariance, [c.target for c in coordinates])
    return Model(coordinates, inputs, relations, mechanisms=stated(mechanisms, theta, covariance))


def cart(error=1e-3):
    scope = Scope.of([*state_names(CART), "u", *(c.target for c in CART)])
    mechanisms = lagrangian(
        CART,
        FORCE,
        scope,
        kinetic=("x_dot**2", "x_dot*phi_dot*cos(phi)", "phi_dot**2"),
        potential=("cos(phi)",),
        dissipation=("x_dot**2",),
        forces={"x": ["u"]},
    )
    return model_of(CART, FORCE, mechanisms, [0.9, 0.18, 0.0275, -1.8, 5, 1], error)


def enzyme():
    mechanisms = reactions(SPECIES, (), named=["S + E <-> C"], composition=None)
    return model_of(SPECIES, (), mechanisms, [1, 1, 1, 0.98, 0.4], 0.01)
