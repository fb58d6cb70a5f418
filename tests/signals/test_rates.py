"""Velocities measured beside positions."""

import numpy as np
import pytest
from logs import oscillator

import odescope
from odescope.errors import InputError
from odescope.recordings.coordinate import Coordinate
from odescope.signals.estimate import Channel, Signals
from odescope.signals.rates import rates_given, refuse_rates
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

T = 0.01 * np.arange(3000)
X, V = np.sin(T) + 0.3 * np.cos(2.7 * T), np.cos(T) - 0.81 * np.sin(2.7 * T)


def signals_of(x_order, lag=0, factor=1.0, noise=0.0):
    other = factor * np.roll(V, lag) + noise * np.random.default_rng(0).standard_normal(len(T))
    coordinates = (Coordinate("x", x_order), Coordinate("v"))
    rows = {"x": X, "v": other, "x_dot": V, "v_dot": np.gradient(other, 0.01), "x_ddot": np.gradient(V, 0.01)}
    names = tuple(dict.fromkeys(n for c in coordinates for n in (*c.states, c.target)))
    channels = tuple(Channel(c.name, 1e-3, 1.0) for c in coordinates)
    return Signals(names, (np.array([rows[n] for n in names]),), (0.0,), 0.01, channels, coordinates, ())


@pytest.mark.parametrize(
    ("lag", "factor", "noise", "refused"),
    [(0, 1.0, 0.0, True), (0, 1.0, 0.05, True), (0, 1.01, 0.0, True), (0, 0.5, 0.0, False), (40, 1.0, 0.0, False)],
)
def test_a_velocity_beside_a_position_of_order_2_is_refused_with_what_to_write(lag, factor, noise, refused):
    """One of another scale, or that lags behind, may be a quantity of its own."""
    found = signals_of(2, lag, factor, noise)
    if refused:
        with pytest.raises(InputError, match=r"v is the rate of x: of order 2, .* Leave v out; or, .* both order = 1"):
            refuse_rates(found)
    else:
        refuse_rates(found)


def test_of_order_1_it_is_an_equation():
    found = signals_of(1)
    refuse_rates(found)
    assert [(c.name, other.name) for c, other in rates_given(found, 0.02)] == [("x", "v")]


def test_both_measurements_count_where_both_have_order_1():
    """The velocity is then a state that is measured: coefficients are those of the system, with smaller errors."""
    log = oscillator(1200)
    truth = oscillator(1200, noise=0.0)
    v = np.gradient(truth["x"], 0.02, edge_order=2) + 1e-3 * np.random.default_rng(1).standard_normal(1200)
    fast = Candidates(basis=("x", "v", "u"), degree=1)
    both = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(), "v": Measured()},
        inputs={"u": Driven(hold="linear", delay=0.0)},
        library=fast,
    )
    found = odescope.identify(both, log | {"v": v})
    rows = {(r.equation, r.term): r.coefficient for r in found.coefficients}
    assert rows == pytest.approx(
        {("x_dot", "v"): 1.0, ("v_dot", "x"): -4.0, ("v_dot", "v"): -0.3, ("v_dot", "u"): 1.0}, rel=0.02
    )
    second = {"x": Measured(order=2), "v": Measured()}
    study = Study(data=Data(time="t"), coordinates=second, inputs=both.inputs)
    with pytest.raises(InputError, match="v is the rate of x"):
        odescope.identify(study, log | {"v": v})


def test_a_velocity_called_as_the_state_is_told_the_same():
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2), "x_dot": Measured()})
    with pytest.raises(InputError, match=r"'x_dot' is used twice .*: of order 2, x has its rate .*with another name"):
        study.measured()
