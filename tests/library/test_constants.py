"""Constants within functions: values, grids, terms with numbers in their places, and how people read them."""

import numpy as np
import pytest

from odescope.errors import InputError
from odescope.library.constants import Constant, grid_for, grid_of, term_at
from odescope.library.mechanism import Part
from odescope.library.parse import Scope, parse_term
from odescope.library.reactions import reactions
from odescope.library.readable import readable
from odescope.library.tape import evaluate, write_tape
from odescope.recordings.coordinate import Coordinate

SCOPE = Scope.of(["x", "y"], constants=["K", "n", "a"])
NAMES = ["x", "y", "K", "n", "a"]
VALUES = {"K": 0.7, "n": 2.5, "a": -1.3}
TEXTS = (
    "tanh(x/K)",
    "x**n",
    "y*x**n/(K**n + x**n)",
    "exp(-a/x)",
    "1/(1 + exp(-n*(x - K)))",
    "sin(n*x)*y**2",
    "(x/K)**n",
    "x/(K + x)",
    "log(x + K)**2",
    "x**(-n)",
    "tanh(x/0.5)",
)


def values(term, names, columns):
    return evaluate(write_tape(names, [term]), np.array(columns))[0]


@pytest.mark.parametrize("text", TEXTS)
def test_a_term_with_numbers_has_the_values_of_the_term_with_names(text):
    x, y = np.random.default_rng(0).uniform(0.2, 3.0, (2, 20))
    term = parse_term(text, SCOPE)
    share, plain = term_at(term, VALUES)
    assert not plain.names & set(VALUES)
    named = values(term, NAMES, [x, y, *(np.full(20, v) for v in VALUES.values())])
    np.testing.assert_allclose(share * values(plain, ["x", "y"], [x, y]), named, rtol=1e-12)
    # What a model file holds reads back as the same.
    assert parse_term(plain.text, Scope.of(["x", "y"])) == plain


@pytest.mark.parametrize(
    ("text", "power"),
    [
        ("(x**2)**n", 1.5),
        ("(x**2)**n", 1.4),
        ("(-x)**n", 1.4),
        ("(x*y)**n", 0.5),
        ("(x/y)**n", 1.5),
        ("(-x)**n", 17.25),
    ],
)
def test_a_power_of_what_may_be_positive_where_its_letters_are_not_keeps_its_value(text, power):
    x, y = -np.random.default_rng(0).uniform(0.5, 1.5, (2, 20))
    share, plain = term_at(parse_term(text, SCOPE), {"n": power})
    expected = eval(text, {"x": x, "y": y, "n": power})  # noqa: S307 (the texts above)
    np.testing.assert_allclose(share * values(plain, ["x", "y"], [x, y]), expected, rtol=1e-12)
    assert parse_term(plain.text, Scope.of(["x", "y"])) == plain


@pytest.mark.parametrize("text", TEXTS)
def test_what_people_read_reads_back_as_the_same_term(text):
    term = parse_term(text, SCOPE)
    assert parse_term(readable(term), SCOPE) == term


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("v0**-1*x", "x/v0"),
        ("x**n*(K**n + x**n)**-1", "x**n/(K**n + x**n)"),
        ("exp(-K/x)", "exp(-K/x)"),
        ("1/(K*x)", "1/(K*x)"),
        ("(x/K)**n*y", "y*(x/K)**n"),
        ("y*exp(-n*log(x))", "y*x**(-n)"),
        ("exp(-3*x**-1)", "exp(-3.0/x)"),
    ],
)
def test_terms_are_shown_as_one_would_type_them(text, shown):
    scope = Scope.of(["x", "y"], constants=["K", "n", "v0"])
    assert readable(parse_term(text, scope)) == shown
    assert parse_term(shown, scope) == parse_term(text, scope)


def test_a_power_with_a_constant_for_exponent_needs_that_constant_declared():
    with pytest.raises(InputError, match="an exponent must be a plain number"):
        parse_term("x**y", SCOPE)
    with pytest.raises(InputError, match=r"\[library.parameters\]\n    E = "):
        parse_term("exp(-E/x)", SCOPE)
    with pytest.raises(InputError, match=r"x\*\*3, not x\^3"):
        parse_term("x^3", SCOPE)
    with pytest.raises(InputError) as caught:
        parse_term("E", Scope.of(["x"]))
    assert "library.parameters" not in str(caught.value)


@pytest.mark.parametrize(("low", "high"), [(0.01, 10.0), (-4.0, -0.5), (-2.0, 5.0)])
def test_a_constant_stays_in_its_range_and_its_coefficient_gives_its_value(low, high):
    middle = Constant("c", low, high, low).evenly(1)[0]
    constant = Constant("c", low, high, float(middle))
    assert constant.at(0.0) == pytest.approx(middle)
    least, largest = constant.limits
    assert sorted((constant.at(least), constant.at(largest))) == pytest.approx([low, high])
    assert low <= constant.at(-1e3) <= high
    assert low <= constant.at(1e3) <= high
    for value in constant.evenly(7):
        step = 1e-6
        p = constant.coefficient(float(value))
        assert constant.at(p) == pytest.approx(value)
        assert (constant.at(p + step) - constant.at(p - step)) / (2 * step) == pytest.approx(constant.slope(value))


def test_a_grid_is_fine_where_a_function_changes_fast_and_coarse_where_it_hardly_does():
    t = np.linspace(0.0, 40.0, 1000)
    frequency, width = Constant("w", 0.5, 5.0, 1.0), Constant("v", 10.0, 100.0, 30.0)
    fast = grid_for(frequency, np.sin(np.multiply.outer(frequency.evenly(400), t))[:, None])
    slow = grid_for(width, np.tanh(np.sin(t) / width.evenly(400)[:, None])[:, None])
    assert len(fast) > 100
    assert len(slow) == 1  # tanh is a line there, whatever the width
    gaps = np.diff(fast)
    assert gaps.max() < 0.15  # a resonance of a record of 40 s is about 2 pi / 40 wide


def test_grids_of_two_constants_cross_and_are_thinned():
    one = Constant("a", 1.0, 2.0, 1.5, grid=tuple(np.linspace(1.0, 2.0, 50)))
    other = Constant("b", 1.0, 2.0, 1.5, grid=(1.2, 1.7))
    points = grid_of([one, other], 300, 8)
    assert len(points) == 16
    assert {p["b"] for p in points} == {1.2, 1.7}
    assert len(grid_of([one])) == 50
    assert grid_of([]) == []


def test_fluxes_that_saturate_stand_beside_mass_action():
    scope = Scope.of("AB", constants=["K", "K_A"])
    species = [Coordinate("A"), Coordinate("B")]
    named = reactions(species, (), named=["A -> B: A/(K + A)"], composition=None, scope=scope)
    assert [m.term for m in named[2:]] == ["A*(A + K)**-1"]
    both = reactions(species, (), named=["A -> B", "B -> A"], composition=None, saturating=["A"], scope=scope)
    assert [m.term for m in both[2:]] == ["A", "B", "A*(A + K_A)**-1"]
    assert [p.share for p in both[4].parts] == [1.0, -1.0]
    assert all(isinstance(p, Part) for p in both[4].parts)
    with pytest.raises(InputError, match="both ways with one flux"):
        reactions(species, (), named=["A <-> B: A"], composition=None, scope=scope)
    with pytest.raises(InputError, match="'C', which is no species"):
        reactions(species, (), named=["A -> B"], composition=None, saturating=["C"], scope=scope)
