"""Functions of two variables: which the data allow, and where their constants are looked for."""

import numpy as np
import pytest

from odescope.library.pairs import MANY, may_be_angles, pair_families
from odescope.library.readable import readable
from odescope.library.tape import evaluate, write_tape

T = np.linspace(0.0, 9.0, 80)
ROLES = ("rise_x_y", "fall_x_y", "edge_x_y")
X, Y = 0.5 * np.sin(T), 3.0 + 0.2 * np.cos(1.3 * T)


def texts(values):
    return {readable(f.term) for f in pair_families(values, ())}


def test_the_root_of_a_difference_needs_its_sign_and_its_size_a_change_of_it():
    assert "sqrt(-x + y)" in texts({"x": X, "y": Y})
    assert "abs(x - y)" not in texts({"x": X, "y": Y})
    assert "abs(x - y)" in texts({"x": X, "y": Y - 3.0})


def test_a_difference_that_may_be_an_angle_makes_angles_of_both():
    small = 0.1 * np.cos(1.3 * T)
    assert "sin(x - y)" in texts({"x": X, "y": small})
    assert may_be_angles({"x": X, "y": small}) == {"x", "y"}
    assert may_be_angles({"x": 0.1 * X, "y": small}) == frozenset()
    warm = 20.0 + np.abs(X)
    assert "warm" not in may_be_angles({"warm": warm, "x": X})
    assert not any("sin" in t for t in texts({"x": 0.1 * X, "y": small}))


@pytest.mark.parametrize(
    ("units", "sine", "size"),
    [
        ({}, True, True),
        ({"x": "mol/L"}, False, True),
        ({"x": "K", "y": "K"}, False, True),
        ({"x": "K", "y": "g"}, False, False),
    ],
)
def test_amounts_are_no_angles_and_what_has_two_units_has_no_difference(units, sine, size):
    values = {"x": X, "y": 0.1 * np.cos(1.3 * T)}
    found = {readable(f.term) for f in pair_families(values, (), units)}
    assert ("sin(x - y)" in found, "abs(x - y)" in found) == (sine, size)
    assert ("x" in may_be_angles(values, units)) is sine


def test_constants_are_looked_for_within_their_ranges_and_under_free_names():
    taken = {"offset_x_y"}
    for family in pair_families({"x": X, "y": Y}, taken):
        ranges = {c.name: (c.low, c.high) for c in family.constants}
        assert not taken & ranges.keys()
        for point in family.points:
            assert [name for name, _ in point] == [c.name for c in family.constants]
            assert all(ranges[name][0] <= value <= ranges[name][1] for name, value in point)


@pytest.mark.parametrize("count", [2, 3])
def test_there_are_functions_of_every_pair_and_of_none_where_there_are_too_many(count):
    values = {f"x{k}": np.sin((k + 1) * T) for k in range(count)}
    pairs = {frozenset(f.term.names & values.keys()) for f in pair_families(values, ())}
    assert len(pairs) == count * (count - 1) // 2
    assert pair_families({f"x{k}": np.sin((k + 1) * T) for k in range(MANY + 1)}, ()) == ()


def test_rates_that_two_amounts_limit_are_those_of_amounts():
    amount = 1.0 + 0.5 * np.cos(1.3 * T)
    limited = {f"{above}/(1.0 + below_x*x + below_y*y)" for above in ("x", "y", "x*y")}
    limited.add("x*y/((half_x + x)*(half_y + y))")
    assert limited <= texts({"x": amount, "y": Y})
    assert not any("below" in t or "half" in t for t in texts({"x": X, "y": Y}))


def test_a_rate_may_go_with_how_much_there_is_of_one_amount_for_another_but_not_where_both_vanish():
    per = "x*y/(ratio_x_y*x + y)"
    amount = 0.5 + 0.5 * np.cos(1.3 * T)
    assert per in texts({"x": amount, "y": Y})
    assert per not in texts({"x": amount, "y": 2.0 * amount})
    assert per not in texts({"x": X, "y": Y})


def test_diodes_and_backlash_are_of_differences_that_change_their_sign():
    values = {"x": 6.0 * X, "y": Y - 3.0}
    both = {f.term.text: f for f in pair_families(values, ())}
    rise, fall, edge = (next(f for f in both.values() if name in f.term.names) for name in ROLES)
    constants = {"rise_x_y": 0.1, "fall_x_y": 0.3, "edge_x_y": 0.2}
    difference = values["x"] - values["y"]
    expected = np.exp(difference / 0.1), np.exp(-difference / 0.3), 2.0 * np.clip(difference, -0.2, 0.2)
    for family, right in zip((rise, fall, edge), expected, strict=True):
        tape = write_tape(["x", "y", *(c.name for c in family.constants)], [family.term])
        rows = [values["x"], values["y"], *(np.full_like(X, constants[c.name]) for c in family.constants)]
        np.testing.assert_allclose(evaluate(tape, np.array(rows))[0], right, rtol=1e-12, atol=1e-12)
    assert not {n for f in pair_families({"x": X, "y": Y}, ()) for n in f.term.names} & set(ROLES)


def test_a_difference_that_has_a_limit_on_one_side_may_have_a_steep_exponential_there():
    difference = np.linspace(-20.0, 0.8, 80)
    families = pair_families({"x": difference + Y, "y": Y}, ())
    (rise,) = (c for f in families for c in f.constants if c.name == "rise_x_y")
    (fall,) = (c for f in families for c in f.constants if c.name == "fall_x_y")
    assert rise.low == pytest.approx(20.0 / 100.0)  # of which the largest exponent is a hundred
    assert fall.low == pytest.approx(20.0 / 30.0)
