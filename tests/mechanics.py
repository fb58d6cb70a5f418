"""For tests of mechanisms: coordinates, known ones and at random, and values of their names."""

import numpy as np
from hypothesis import strategies as st

from odescope.library.parse import Scope
from odescope.recordings.coordinate import Coordinate, Input, state_names

CART = (Coordinate("x", 2, cyclic=True), Coordinate("phi", 2, angle=True))
ARMS = (Coordinate("phi1", 2, angle=True), Coordinate("phi2", 2, angle=True))
ELASTIC = (Coordinate("r", 2), Coordinate("phi", 2, angle=True))
MASSES = (Coordinate("x", 2), Coordinate("y", 2))
FORCE = (Input("u"),)


def positions(count):
    return tuple(Coordinate(f"x{k}", 2) for k in range(count))


def arms(count):
    return tuple(Coordinate(f"phi{k}", 2, angle=True) for k in range(count))


def names_of(coordinates, inputs=()):
    return [*state_names(coordinates), *(i.name for i in inputs), *(c.target for c in coordinates)]


def scope_of(coordinates, inputs=()):
    return Scope.of(names_of(coordinates, inputs))


def values_of(coordinates, inputs=(), count=40):
    """Random values of the names, (names, count), of both signs."""
    return np.random.default_rng(5).uniform(-2.0, 2.0, (len(names_of(coordinates, inputs)), count))


@st.composite
def coordinate_sets(draw):
    """One to three coordinates, each a position or an angle, cyclic or not."""
    flags = draw(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=3))
    return tuple(Coordinate("pqr"[k], 2, angle=a, cyclic=c) for k, (a, c) in enumerate(flags))
