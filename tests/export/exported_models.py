"""Models and records for the round trips of exports: a free run of odescope is what each is compared with."""

from dataclasses import dataclass, replace

import msgspec
import numpy as np
from found_models import cart, model_of
from hand_models import relation

from odescope.commands.demo import cart_pendulum
from odescope.library.parse import Scope
from odescope.library.reactions import reactions
from odescope.model.model import Model
from odescope.model.simulation import drive, simulate
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


RECORD = 0.05 * np.arange(201)  # seconds; delays are no multiples of the period


def sliding():
    """A mass that an input, late and held, drives over a rough table; it never stands still."""
    scope = Scope.of(["p", "p_dot", "f"])
    terms = [("p_ddot", "1", 1.0), (None, "f", -1.0), (None, "sign(p_dot)", 0.9), (None, "p_dot", 0.4)]
    domain = {"p_dot": (0.5, 6.0)}
    return Model((Coordinate("p", 2),), (Input("f", "zero", "N", 0.137),), (relation(scope, *terms),), domain=domain)


def network():
    """An enzyme at work, fed by an input that is held and late: mass action, of which two relations share targets."""
    species = tuple(Coordinate(name) for name in "SECP")
    feed = (Input("feed", "zero", None, 0.137),)
    named = ["S + E <-> C", "C -> P + E", "feed -> S", "P ->"]
    mechanisms = reactions(species, feed, named=named, composition=None)
    return model_of(species, feed, mechanisms, [1, 1, 1, 1, 2.0, 0.4, 0.9, 0.7, 0.2], 0.01)


def energies():
    """The pendulum on a cart as Lagrange's equations have it: targets stand together in each relation."""
    return replace(cart(), inputs=(Input("u", "linear", "N", 0.0634),))


@dataclass(frozen=True)
class RoundTrip:
    """A model with a delay, the inputs (N, 1) of a record at RECORD, and where it starts."""

    model: Model
    inputs: object
    start: tuple[float, ...]

    @property
    def exact(self):
        """The free run, (N, states)."""
        return free_run(self.model, self.inputs, self.start, RECORD)

    def largest(self, found):
        """The largest error of states (N, n), in sizes of the states."""
        return (np.abs(found - self.exact) / np.abs(self.exact).max(axis=0)).max()

    def pieces(self):
        """Between what times every input as it acts is a line, and its values there."""
        driven = drive(self.model.inputs, RECORD, self.inputs)
        return zip(driven.t[:-1], driven.t[1:], driven.begin, driven.end, driven.sample[1:], strict=False)


ROUND_TRIPS = {
    "demo": RoundTrip(driven_cart("linear", 0.0634), push(RECORD), (0.1, 0.4, 0.0, -0.2)),
    "friction": RoundTrip(sliding(), 2.5 + np.sign(np.sin(1.7 * RECORD))[:, None], (0.0, 1.5)),
    "lagrangian": RoundTrip(energies(), push(RECORD), (0.1, 0.4, 0.0, -0.2)),
    "network": RoundTrip(network(), 0.6 + 0.4 * np.sign(np.sin(1.7 * RECORD))[:, None], (1.0, 0.5, 0.1, 0.0)),
}
