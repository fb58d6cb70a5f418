"""Models in the unit of time of their log: the numbers that a fit in that unit would have."""

import numpy as np
import pytest

from odescope.library.expression import ONE
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.model import Model
from odescope.model.recorded_time import counted_in, in_told_time, recorded_unit, told_unit
from odescope.model.relation import FoundMechanism, Relation, RelationTerm
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input

SCOPE = Scope.of(["x", "x_dot", "y", "u", "t"])


def relation(target, terms):
    """Return target = the terms, each with an error of a tenth."""
    parts = [(target, "1", 1.0), *((None, text, -value) for text, value in terms.items())]
    return Relation(
        tuple(
            RelationTerm(Product(factor, ONE if text == "1" else parse_term(text, SCOPE)), value, abs(value) / 10.0)
            for factor, text, value in parts
        )
    )


def model(relations, coordinates, inputs=(), unit="h", mechanisms=()):
    return Model(
        tuple(coordinates), tuple(inputs), tuple(relations), mechanisms=mechanisms, provenance={"time_unit": unit}
    )


def test_rates_and_accelerations_are_those_of_a_fit_in_that_unit():
    """Run over two hours in seconds, and over 2 in hours: the same positions, and rates 3600 times as large."""
    laws = [
        relation("x_ddot", {"x": -4e-6, "x_dot": -3e-4, "x_dot**3": -70.0, "y": 1e-6}),
        relation("y_dot", {"y": -2e-4, "x": 1e-4, "1": 5e-5}),
    ]
    found = model(laws, [Coordinate("x", 2), Coordinate("y", 1)])
    hourly = in_told_time(found)
    t = np.linspace(0.0, 7200.0, 50)
    slow = simulate(found, t, None, {"x": 1.0, "x_dot": 1e-3, "y": 0.5})
    fast = simulate(hourly, t / 3600.0, None, {"x": 1.0, "x_dot": 3.6, "y": 0.5})
    assert fast.states / [1.0, 1.0, 3600.0] == pytest.approx(slow.states, rel=1e-5, abs=1e-7)
    assert np.ptp(slow.states[:, 0]) > 0.5
    errors = [t.std_error / abs(t.coefficient) for r in hourly.relations for t in r.terms]
    assert errors == pytest.approx([0.1] * len(errors))


@pytest.mark.parametrize(("unit", "told", "rate"), [("us", "us", 0.4), ("ns", "ns", 4e-4), ("ms", "s", 4e5)])
def test_what_is_faster_than_any_machine_is_told_in_its_unit_too(unit, told, rate):
    found = model([relation("y_dot", {"y": -4e5})], [Coordinate("y", 1)], unit=unit)
    assert told_unit(found) == told
    assert in_told_time(found).relations[0].terms[1].coefficient == pytest.approx(rate)


def test_terms_with_a_target_keep_what_they_are_beside_it():
    law = Relation(
        (*relation("y_dot", {"y": -2e-4}).terms, RelationTerm(Product("y_dot", parse_term("y", SCOPE)), 0.3))
    )
    (hourly,) = in_told_time(model([law], [Coordinate("y", 1)])).relations
    assert [t.coefficient for t in hourly.terms] == pytest.approx([1.0, 0.72, 0.3])


def test_rates_of_reactions_are_told_likewise():
    decay = FoundMechanism("y -> ", "reaction", "y", 2e-4, 1e-5)
    found = model([relation("y_dot", {"y": -2e-4})], [Coordinate("y", 1)], mechanisms=(decay,))
    (mechanism,) = in_told_time(found).mechanisms
    assert (mechanism.coefficient, mechanism.std_error) == pytest.approx((0.72, 0.036))


@pytest.mark.parametrize(
    "found",
    [
        model([relation("x_ddot", {"tanh(x_dot)": -1.0})], [Coordinate("x", 2)]),
        model([relation("y_dot", {"y": -1.0})], [Coordinate("y", 1)], unit="s"),
        model([relation("y_dot", {"y": -1.0})], [Coordinate("y", 1)], unit="ms"),
        model(
            [relation("x_ddot", {"x": -1.0})],
            [Coordinate("x", 2)],
            mechanisms=(FoundMechanism("x**2", "potential", "x**2", 0.5),),
        ),
    ],
)
def test_what_cannot_be_said_in_another_unit_stays_in_seconds(found):
    assert in_told_time(found) is found


def test_the_time_within_a_function_stays_in_seconds():
    wave = Model(
        (Coordinate("y", 1),),
        (Input("t"),),
        (relation("y_dot", {"sin(t)": -1.0}),),
        provenance={"time_unit": "h", "time": "clock", "columns": {"t": "clock"}},
    )
    assert in_told_time(wave) is wave


def test_durations_are_told_in_it():
    assert counted_in(5400.0, "h") == 1.5
    assert counted_in(0.0021, "ms") == pytest.approx(2.1)
    assert recorded_unit(model([relation("y_dot", {"y": -1.0})], [Coordinate("y", 1)], unit="furlong")) == "s"
