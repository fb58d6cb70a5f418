"""Functions that powers of a variable may imitate, and which of them data allow."""

import numpy as np
import pytest

from odescope.library.constants import thinned_grid
from odescope.library.families import POINTS, families_of, is_switched
from odescope.library.parse import Scope, parse_term
from odescope.library.readable import readable
from odescope.library.tape import evaluate, write_tape


def texts(values, taken=()):
    return {readable(f.term) for f in families_of("z", values, taken)}


def test_what_has_no_sign_has_roots_and_logarithms_and_what_has_one_a_size():
    level, swing = texts(np.linspace(0.2, 3.0, 500)), texts(np.linspace(-1.0, 2.0, 500))
    assert {"sqrt(z)", "log(z)", "z**exponent_z"} <= level
    assert not {"sqrt(z)", "log(z)", "z**exponent_z"} & swing
    assert {"abs(z)", "z*abs(z)"} <= swing
    assert "tanh(z/scale_z)" in level & swing


def test_a_level_that_noise_takes_below_nothing_has_a_root_and_no_logarithm():
    found = texts(np.linspace(-0.01, 3.0, 500))
    assert {"sign(z)*sqrt(abs(z))"} == {text for text in found if "sqrt" in text and "_z" not in text}
    assert "log(z)" not in found
    assert "z/(half_z + z)" in found


def test_a_saturation_of_what_noise_takes_below_nothing_has_its_pole_beyond_that():
    for low in (-0.1, 1e-3, 0.5):
        halves = [
            c for f in families_of("z", np.linspace(low, 3.0, 500), ()) for c in f.constants if c.name == "half_z"
        ]
        assert len(set(halves)) == 1
        assert halves[0].low >= max(-2.0 * low, 0.03)


@pytest.mark.parametrize(("low", "high"), [(-1.0, 2.0), (-2.0, 1.0)])
def test_what_has_a_sign_may_have_limits_which_it_reaches_on_both_sides(low, high):
    values = np.linspace(low, high, 500)
    (limited,) = (f for f in families_of("z", values, ()) if [c.name for c in f.constants] == ["edge_z"])
    (edge,) = limited.constants
    assert 0.0 < edge.low < edge.high < 1.0
    for at in (edge.low, edge.high):
        (found,) = evaluate(write_tape(["z", "edge_z"], [limited.term]), np.array([values, np.full_like(values, at)]))
        np.testing.assert_allclose(found, 2.0 * np.clip(values, -at, at), atol=1e-12)
    assert not any(c.name == "edge_z" for f in families_of("z", np.linspace(0.2, 3.0, 500), ()) for c in f.constants)


@pytest.mark.parametrize(("low", "high"), [(0.2, 3.0), (-1.0, 2.0), (-5.0, -4.0), (101_325.0, 130_000.0)])
def test_a_root_ends_below_or_above_all_values(low, high):
    values = np.linspace(low, high, 500)
    ends = {c.name: c for f in families_of("z", values, ()) for c in f.constants if "sqrt(" in f.term.text}
    assert -ends["head_z"].high < -ends["head_z"].low < low
    assert high < ends["supply_z"].low < ends["supply_z"].high


HILL, HALDANE = "z**order_z/(level_z**order_z + z**order_z)", "z/(affinity_z + z + z**2/inhibition_z)"
OF_SIZE = "abs(z)**order_z/(level_z**order_z + abs(z)**order_z)"


@pytest.mark.parametrize(
    ("low", "rates"),
    [(0.2, {HILL, HALDANE}), (-0.01, {OF_SIZE, HALDANE}), (-1.0, set())],
    ids=["amount", "noise", "signed"],
)
def test_an_amount_has_the_rates_of_hill_and_haldane(low, rates):
    scope = Scope.of(["z"], constants=["order_z", "level_z", "affinity_z", "inhibition_z"])
    known = {readable(parse_term(text, scope)): text for text in (HILL, OF_SIZE, HALDANE)}
    assert {known[text] for text in texts(np.linspace(low, 3.0, 500)) & set(known)} == rates


def test_what_is_always_negative_has_the_functions_of_its_size():
    values = np.linspace(0.2, 3.0, 500)
    here, mirrored = families_of("z", values, ()), families_of("z", -values, ())
    assert len(here) == len(mirrored)
    for one, other in zip(here, mirrored, strict=True):
        names = [c.name for c in one.constants]
        if not names or names[0].startswith(("exponent", "half", "scale", "level", "affinity")):
            assert [c.name for c in other.constants] == names
            columns = [np.full_like(values, c.nominal) for c in one.constants]
            (at,) = evaluate(write_tape(["z", *names], [one.term]), np.array([values, *columns]))
            (turned,) = evaluate(write_tape(["z", *names], [other.term]), np.array([-values, *columns]))
            np.testing.assert_allclose(np.abs(turned), np.abs(at), rtol=1e-12)


@pytest.mark.parametrize(("low", "there"), [(0.2, True), (-0.01, True), (-1.0, False)])
def test_an_amount_may_fill_up_as_an_exponential_does(low, there):
    filling = "(1.0 - exp(-{}/filled_z))**1"
    known = {filling.format("z"), filling.format("abs(z)")}
    assert bool(known & texts(np.linspace(low, 3.0, 500))) is there


def test_what_falls_again_with_a_speed_is_a_function_of_an_amount_too():
    falling = "z/(critical_z**2 + z**2)"
    assert all(falling in texts(np.linspace(low, 3.0, 500)) for low in (0.0, 0.2, -1.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_hardly_moves_beside_its_size_has_ranges_that_go_upwards(sign):
    for offset in (3.0, 30.0, 300.0, 1000.0, 101_325.0):
        found = families_of("z", sign * np.linspace(offset, offset + 1.0, 500), ())
        assert all(c.low < c.high for f in found for c in f.constants)
        assert any(f.term.text.startswith("exp(rise") for f in found) == (offset < 330.0)


def test_what_conducts_to_one_side_may_have_a_steep_exponential_there():
    found = {c.name: c for f in families_of("v", np.linspace(-2.6, 0.6, 500), ()) for c in f.constants}
    assert found["rise_v"].low < 0.03 < found["fall_v"].low


def test_what_does_not_vary_has_none():
    assert families_of("z", np.full(100, 2.0), ()) == ()


@pytest.mark.parametrize(("low", "high"), [(0.2, 3.0), (-1.0, 1.0), (290.0, 350.0), (1e-6, 2e-6)])
def test_every_function_has_values_over_the_whole_of_its_grid(low, high):
    values = np.linspace(low, high, 200)
    for family in families_of("z", values, ()):
        names = [c.name for c in family.constants]
        tape = write_tape(["z", *names], [family.term])
        for place, constant in enumerate(family.constants):
            assert 1 <= len(constant.grid) <= POINTS
            for value in constant.grid:
                fixed = [value if k == place else c.nominal for k, c in enumerate(family.constants)]
                found = evaluate(tape, np.array([values, *(np.full_like(values, v) for v in fixed)]))
                assert np.isfinite(found).all()


def test_constants_have_names_that_are_not_taken():
    families = families_of("z", np.linspace(0.2, 3.0, 100), {"scale_z", "scale_z_2"})
    names = {c.name for f in families for c in f.constants}
    assert "scale_z_3" in names
    assert not {"scale_z", "scale_z_2"} & names


def test_a_thinned_grid_is_spread_evenly_over_the_whole_one():
    grid = tuple(float(k) for k in range(100))
    assert thinned_grid(grid, 200) == grid
    found = thinned_grid(grid, 10)
    assert len(found) == 10
    assert np.ptp(np.diff(found)) <= 1.0
    assert found[0] < 10.0
    assert found[-1] >= 90.0


@pytest.mark.parametrize(("unit", "shift"), [("°C", 273.15), ("K", 0.0)])
def test_a_temperature_has_the_law_of_arrhenius_and_nothing_else_has(unit, shift):
    kelvins = np.linspace(300.0, 350.0, 100)
    (law,) = (f for f in families_of("z", kelvins - shift, (), unit=unit) if "activation_z" in f.term.text)
    assert not any("activation" in text for text in texts(kelvins - shift))
    tape = write_tape(["z", "activation_z"], [law.term])
    low, high = evaluate(tape, np.array([kelvins - shift, np.full(100, 6000.0)]))[0][[0, -1]]
    assert np.log(high / low) == pytest.approx(6000.0 * (1.0 / 300.0 - 1.0 / 350.0))
    assert low < 1.0 < high  # about the middle: factor and energy can be told apart
    (radiating,) = (f for f in families_of("z", kelvins - shift, (), unit=unit) if f.term.text.endswith("**4"))
    assert evaluate(write_tape(["z"], [radiating.term]), (kelvins - shift)[None])[0] == pytest.approx(kelvins**4)


@pytest.mark.parametrize(("unit", "angles"), [(None, True), ("rad", True), ("mol/L", False), ("°C", False)])
def test_what_has_another_unit_is_no_angle(unit, angles):
    found = {readable(f.term) for f in families_of("z", np.linspace(-1.0, 2.0, 100), (), unit=unit)}
    assert ("sin(z)" in found) is angles
    assert "sin(rate_z*z)" in found


@pytest.mark.parametrize(
    ("squared", "divided", "position", "there"),
    [
        (True, True, True, {"before", "behind", "critical"}),
        (True, False, False, {"critical"}),
        (False, True, True, {"before", "behind"}),
        (True, True, False, {"critical"}),
        (False, False, True, set()),
    ],
)
def test_what_has_a_square_below_it_is_a_function_only_where_one_divides_and_a_pole_of_positions(
    squared, divided, position, there
):
    families = families_of("z", np.linspace(-1.0, 2.0, 500), ())
    roles = {c.name.removesuffix("_z") for f in families if f.suits(squared, divided, position) for c in f.constants}
    assert roles & {"before", "behind", "critical"} == there
    assert {"edge", "head", "supply"} <= roles


@pytest.mark.parametrize(("low", "high", "there"), [(0.5, 3.0, True), (-3.0, -0.5, True), (-0.5, 3.0, False)])
def test_a_distance_has_the_square_of_its_reciprocal(low, high, there):
    families = families_of("z", np.linspace(low, high, 100), ())
    assert ("1/z**2" in {readable(f.term) for f in families if f.suits(False, False, True)}) is there
    assert "1/z**2" not in {readable(f.term) for f in families if f.suits(True, True, False)}


@pytest.mark.parametrize(
    ("values", "switched"),
    [
        ([0.0] * 50 + [1.5] * 45 + [0.7] * 5, True),  # averages over steps lie between
        ([0.0] * 88 + [0.4] * 6 + [1.5] * 2 + [1.0] * 4, True),
        ([0.0] * 80 + [0.4] * 12 + [1.5] * 2 + [1.0] * 6, False),  # pulses of several heights
    ],
)
def test_what_is_switched_has_no_functions(values, switched):
    assert is_switched(np.array(values)) is switched
    assert (families_of("u", np.array(values), ()) == ()) is switched
