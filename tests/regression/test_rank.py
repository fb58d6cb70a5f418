import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanics import ARMS, CART, ELASTIC, FORCE, MASSES, coordinate_sets, scope_of

from odescope.library.lagrangian import lagrangian
from odescope.recordings.coordinate import Coordinate
from odescope.regression.rank import told_apart

repeatable = settings(derandomize=True, deadline=None, max_examples=12)


def mechanisms_of(coordinates, inputs=(), **by_hand):
    return lagrangian(coordinates, inputs, scope_of(coordinates, inputs), **by_hand)


def examined(mechanisms, coordinates, inputs=(), seed=0):
    kept, left_out = told_apart(mechanisms, coordinates, inputs, np.random.default_rng(seed))
    return [str(m) for m in kept], {str(m): {str(o) for o in others} for m, others in left_out}


@repeatable
@given(coordinate_sets(), st.integers(0, 2**32 - 1))
def test_all_of_a_default_is_told_apart(coordinates, seed):
    mechanisms = mechanisms_of(coordinates, FORCE)
    assert told_apart(mechanisms, coordinates, FORCE, np.random.default_rng(seed)) == (mechanisms, ())


CASES = {
    "equal but for a total derivative": (
        ELASTIC,
        {"kinetic": ["r_dot**2", "phi_dot**2", "r*phi_dot*sin(phi)", "r_dot*cos(phi)"]},
        {"phi_dot*r*sin(phi) in kinetic": {"r_dot*cos(phi) in kinetic"}},
    ),
    "an identity": (
        ARMS,
        {"potential": ["cos(phi1)**2", "sin(phi1)**2", "cos(2*phi1)", "cos(phi2)"]},
        {
            "sin(phi1)**2 in potential": {"cos(phi1)**2 in potential"},
            "cos(2.0*phi1) in potential": {"cos(phi1)**2 in potential"},
        },
    ),
    "a square and its parts": (
        MASSES,
        {"potential": ["(x - y)**2", "x*y", "x**2", "y**2", "(x - 1)**2", "x"]},
        {
            "y**2 in potential": {"(x - y)**2 in potential", "x*y in potential", "x**2 in potential"},
            "(-1.0 + x)**2 in potential": {"x in potential", "x**2 in potential"},
        },
    ),
    "a weight that is also a force": (
        MASSES,
        {"potential": ["x", "y"], "forces": {"x": ["1"]}},
        {"x in potential": {"1 in force on x"}},
    ),
    "a friction that is also a force": (
        MASSES,
        {"dissipation": ["x_dot**2", "y_dot**2", "(x_dot - y_dot)**2"], "forces": {"x": ["x_dot", "y_dot"]}},
        {
            "x_dot in force on x": {"x_dot**2 in dissipation"},
        },
    ),
    "relative friction and what it is made of": (
        MASSES,
        {"dissipation": ["x_dot**2", "y_dot**2", "x_dot*y_dot", "(x_dot - y_dot)**2"]},
        {
            "(x_dot - y_dot)**2 in dissipation": {
                f"{term} in dissipation" for term in ("x_dot**2", "x_dot*y_dot", "y_dot**2")
            },
        },
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_a_combination_is_left_out_and_said(name):
    coordinates, by_hand, expected = CASES[name]
    nothing = {"kinetic": [f"{c.name}_dot**2" for c in coordinates], "potential": (), "dissipation": (), "forces": {}}
    mechanisms = mechanisms_of(coordinates, **(nothing | by_hand))
    kept, left_out = examined(mechanisms, coordinates)
    assert left_out == expected
    assert kept == [str(m) for m in mechanisms if str(m) not in expected]


@repeatable
@given(st.permutations(range(6)))
def test_simple_ones_stay_whatever_the_order(order):
    terms = ["x", "x**2", "x**3", "(x - 1)**3", "(x - 2)**3", "y**2"]
    mechanisms = mechanisms_of(
        MASSES, potential=[terms[k] for k in order], dissipation=(), forces={}, kinetic=["x_dot**2", "y_dot**2"]
    )
    _, left_out = told_apart(mechanisms, MASSES, (), np.random.default_rng(0))
    # Of three cubes that differ by x**2 and x, and a constant, one stays: the first.
    cubes = [m for m in mechanisms if m.size == 3]
    assert [m for m, _ in left_out] == cubes[1:]


def test_a_function_without_values_at_most_states_stays_and_does_no_harm():
    # The two have no state in common; a third has none at all.
    potential = ["sqrt(r)", "log(-r)", "log(r - 10)", "r", "cos(phi)**2", "sin(phi)**2"]
    mechanisms = mechanisms_of(ELASTIC, potential=potential, forces={})
    kept, left_out = examined(mechanisms, ELASTIC)
    assert left_out == {"sin(phi)**2 in potential": {"cos(phi)**2 in potential"}}
    assert {"sqrt(r) in potential", "log(-r) in potential", "log(-10.0 + r) in potential"} <= set(kept)


def test_where_nothing_has_values_all_stay():
    coordinates = (Coordinate("q", 2),)
    mechanisms = mechanisms_of(
        coordinates, kinetic=["q_dot**2*log(q - 9)"], potential=["log(q - 9)"], dissipation=(), forces={}
    )
    assert told_apart(mechanisms, coordinates, (), np.random.default_rng(0)) == (mechanisms, ())
    assert told_apart((), coordinates, (), np.random.default_rng(0)) == ((), ())


def test_angles_go_round_the_circle_and_inputs_are_drawn():
    # Over less than the circle or with a constant input, these would look alike.
    mechanisms = mechanisms_of(CART, FORCE, potential=["abs(sin(phi))", "sin(phi)"], forces={"phi": ["1", "u", "u**2"]})
    assert examined(mechanisms, CART, FORCE)[1] == {}
