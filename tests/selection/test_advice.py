"""What a record itself shows of why it has no law."""

import numpy as np
import pytest

from odescope.library.candidates import Library
from odescope.library.parse import Scope
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record, Records
from odescope.regression.problem import pose
from odescope.regression.rows import PlainRows
from odescope.selection.advice import advice, idle_inputs
from odescope.signals.estimate import Channel, Signals

PERIOD, COUNT = 0.01, 4000
T = PERIOD * np.arange(COUNT)


def smooth(seed):
    """A sum of ten waves, and its rate."""
    rng = np.random.default_rng(seed)
    frequency, phase, size = rng.uniform(0.5, 6.0, 10), rng.uniform(0.0, 6.0, 10), rng.standard_normal(10)
    angle = np.outer(T, frequency) + phase
    return np.sin(angle) @ size, np.cos(angle) @ (size * frequency)


def signals_of(columns, coordinates, inputs=(), cutoff=5.0):
    names = [n for c in coordinates for n in (*c.states, c.target)] + [i.name for i in inputs]
    channels = tuple(Channel(c.name, 1e-3, cutoff) for c in coordinates)
    values = np.array([columns[n] for n in names])
    return Signals(tuple(names), (values,), (0.0,), PERIOD, channels, tuple(coordinates), tuple(inputs))


def said(columns, coordinates, inputs=(), t=T, cutoff=5.0, time_unit=None):
    signals = signals_of(columns, coordinates, inputs, cutoff)
    names, measured = signals.names, [c.name for c in coordinates] + [i.name for i in inputs]
    record = Record(t, np.array([columns[n] for n in measured]).T, tuple(measured))
    library = Library.of(("1", *(c.name for c in coordinates), coordinates[0].target), Scope.of(names))
    problem = pose(signals, coordinates[0].target, coordinates[0].order, library, PlainRows())
    return advice(Records.of(record), signals, (problem,), time_unit)


def first_order():
    x, rate = smooth(0)
    return {"x": x, "x_dot": rate}


def test_a_sound_record_is_given_no_advice():
    y, y_rate = smooth(1)
    u, _ = smooth(2)
    columns = {**first_order(), "y": y, "y_dot": y_rate, "u": u}
    assert said(columns, [Coordinate("x"), Coordinate("y")], [Input("u")]) == ()


def test_time_in_whole_numbers_may_be_milliseconds():
    (sentence,) = said(first_order(), [Coordinate("x")], t=10.0 * np.arange(COUNT))
    assert sentence.startswith("time counts in whole numbers, a sample every 10")
    assert said(first_order(), [Coordinate("x")], t=540.0 * np.arange(COUNT), time_unit="h") == ()


@pytest.mark.parametrize(("noise", "given"), [(0.0, True), (0.05, True), (0.5, False)])
def test_a_rate_given_beside_its_quantity_is_named(noise, given):
    columns = first_order()
    v = columns["x_dot"] + noise * columns["x_dot"].std() * np.random.default_rng(3).standard_normal(COUNT)
    columns |= {"v": v, "v_dot": np.gradient(v, PERIOD)}
    told = said(columns, [Coordinate("x"), Coordinate("v")])
    want = "v is the rate of x: give x order = 2 and leave v out of the coordinates"
    assert (told == (want,)) is given
    assert bool(told) is given


def test_an_input_that_a_controller_makes_of_the_states_is_named_and_one_with_a_disturbance_is_not():
    columns = {"q": smooth(4)[0], "q_dot": smooth(4)[1], "q_ddot": smooth(5)[0]}
    feedback = 2.0 - 3.0 * columns["q"] - 0.5 * columns["q_dot"]
    (sentence,) = said({**columns, "u": feedback}, [Coordinate("q", 2)], [Input("u")])
    assert sentence.startswith("u is a function of q, q_dot, as under feedback")
    disturbed = feedback + 0.3 * smooth(6)[0]
    assert said({**columns, "u": disturbed}, [Coordinate("q", 2)], [Input("u")]) == ()


@pytest.mark.parametrize(("reference", "fed_back"), [(0.3, True), (3.0, False)])
def test_an_input_that_no_equation_holds_is_named_and_why_that_may_be_feedback_alone(reference, fed_back):
    columns = {"q": smooth(4)[0], "q_dot": smooth(4)[1], "q_ddot": smooth(5)[0]}
    columns["u"] = 2.0 - 3.0 * columns["q"] - 0.5 * columns["q_dot"] + reference * smooth(6)[0]
    signals = signals_of(columns, [Coordinate("q", 2)], [Input("u")])
    (sentence,) = idle_inputs(signals, ())
    assert sentence.startswith("u is in none of the equations")
    assert ("under feedback" in sentence) is fed_back
    assert not list(idle_inputs(signals, {"u"}))


def test_a_record_too_short_for_its_library_is_told_with_what_it_holds():
    (sentence,) = said(first_order(), [Coordinate("x")], cutoff=0.1)
    assert "about 8 independent values, few for the 3 candidates for x_dot" in sentence
