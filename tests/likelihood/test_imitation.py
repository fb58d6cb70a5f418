"""Functions that come nearest to what a relation says, against least squares with known constants."""

import numpy as np
import pytest

from odescope.library.expression import ONE
from odescope.library.families import families_of
from odescope.library.parse import Scope, parse_term
from odescope.likelihood.imitation import Choice, Imitated, Placed, Samples, choices_of

Z = np.linspace(0.3, 4.0, 400)
W = np.cos(3.0 * Z)


def imitated(said):
    return Imitated(said, np.array([np.ones_like(Z)]), Samples({"z": Z, "w": W}))


def choice(text):
    return next(c for c in choices_of(families_of("z", Z, ()), (ONE,)) if len(c.terms) == 1 and text in c.terms[0].text)


@pytest.mark.parametrize(
    ("text", "said"),
    [("sqrt(z)", np.sqrt(Z)), ("log(z)", np.log(Z)), ("tanh(", np.tanh(Z / 0.9)), ("sin(", np.sin(1.1 * Z))],
)
def test_the_function_that_was_said_comes_nearest(text, said):
    found = imitated(2.0 - 0.7 * said)
    ranked = found.ranked([choice(t) for t in ("sqrt(z)", "log(z)", "tanh(", "sin(")], [])
    assert text in ranked[0][1].choice.terms[0].text


@pytest.mark.parametrize("head", [-0.27, 0.137, 0.9])
def test_a_root_with_a_constant_is_told_from_what_its_grid_is_too_coarse_for(head):
    found = imitated(2.0 - 0.7 * np.sqrt(head + Z))
    single = [c for c in choices_of(families_of("z", Z, ()), (ONE,)) if len(c.constants) == 1 and len(c.terms) == 1]
    (squares, placed), *_ = found.ranked(single, [])
    assert placed.choice.terms[0].text == "sqrt(head_z + z)"
    assert placed.values["head_z"] == pytest.approx(head, abs=1e-4)
    assert squares < 1e-6 * found.nearest(choice("half_z"), [])[0]


def test_no_curve_has_two_spellings_where_functions_are_multiplied_by_their_variable():
    texts = {c.terms[0].text for c in choices_of(families_of("z", Z, ()), (ONE, parse_term("z", Scope.of(["z"]))))}
    assert {"half_z*(half_z + z)**-1", "z*(half_z + z)**-1", "z**2*(half_z + z)**-1"} <= texts
    assert "half_z*z*(half_z + z)**-1" not in texts


def test_functions_at_fewer_samples_are_those_of_all():
    samples, function = Samples({"z": Z, "w": W}), choice("tanh(")
    points, columns = samples.on_grid(function)
    fewer = samples.thinned(3)
    assert fewer.on_grid(function)[0] == points
    np.testing.assert_array_equal(fewer.on_grid(function)[1], columns[:, :, ::3])
    assert samples.thinned(3) is fewer  # and evaluated once


def test_what_is_missed_is_that_of_least_squares_at_the_same_constants():
    rng = np.random.default_rng(1)
    found = imitated(np.sqrt(Z) + 0.3 * np.tanh(Z / 0.5) + 0.1 * rng.standard_normal(len(Z)))
    other = Placed(choice("sqrt(z)"))
    missed, placed = found.nearest(choice("tanh("), [other])
    columns = np.column_stack([np.ones_like(Z), np.sqrt(Z), np.tanh(Z / placed.values["scale_z"])])
    coefficients, squares, *_ = np.linalg.lstsq(columns, found.said)
    assert missed == pytest.approx(float(squares[0]), rel=1e-8)
    assert found.coefficients([other, placed]) == pytest.approx(coefficients, rel=1e-6)


def test_two_functions_are_found_together():
    said = 1.5 * np.sqrt(Z) - 2.0 * np.abs(W)
    level = choices_of(families_of("z", Z, ()), (ONE,))
    swing = choices_of(families_of("w", W, ()), (ONE,))
    few = [[c for c in among if not c.constants] for among in (level, swing)]
    texts = [p.choice.terms[0].text for p in imitated(said).together(few)]
    assert texts == ["sqrt(z)", "abs(w)"]


def test_a_function_that_says_what_others_say_gains_nothing():
    found = imitated(np.sqrt(Z))
    one = choice("sqrt(z)")
    alone, _ = found.nearest(Choice(), [Placed(one)])
    again, _ = found.nearest(one, [Placed(one)])
    assert again == pytest.approx(alone, abs=1e-12)


def test_sine_and_cosine_of_one_rate_may_stand_together():
    pairs = [c for c in choices_of(families_of("z", Z, ()), (ONE,)) if len(c.terms) > 1]
    assert [[t.text for t in c.terms] for c in pairs] == [["sin(z)", "cos(z)"], ["sin(rate_z*z)", "cos(rate_z*z)"]]
    said = np.sin(1.3 * Z + 0.8)
    missed, placed = imitated(said).nearest(pairs[1], [])
    assert missed < 1e-2 * float(said @ said)
    assert placed.values["rate_z"] == pytest.approx(1.3, rel=0.1)


def test_functions_that_come_near_together_are_found_where_none_does_alone():
    rng = np.random.default_rng(0)
    z, w = rng.uniform(-1.5, 1.5, (2, 600))
    w -= 0.9 * z  # what both say nearly cancels, so that either alone leaves about all
    said = 2.0 * np.tanh(z / 0.6) + 2.2 * np.tanh(w / 0.5)
    found = Imitated(said, np.array([np.ones_like(z)]), Samples({"z": z, "w": w}))
    choices = [choices_of(families_of(n, v, ()), (ONE,)) for n, v in (("z", z), ("w", w))]
    simple = [[Choice(), *(c for c in among if len(c.constants) < 2 and len(c.terms) < 2)] for among in choices]
    placed = found.together(simple)
    assert ["tanh" in p.choice.terms[0].text for p in placed] == [True, True]
    assert found.missed(placed) < 1e-6 * float(said @ said)


def test_one_function_may_multiply_all_that_a_fraction_divides():
    scope = Scope.of(["x", "w"])
    rests = [parse_term(text, scope) for text in ("x", "x**2")]
    among = choices_of(families_of("w", W + 3.0, ()), (ONE, *rests), (), (ONE, *rests))
    common = [c for c in among if c.common]
    assert common
    assert all(c.size == 3 for c in common)
    found = Imitated(np.exp(0.7 * W) * (Z - 0.2 * Z**2), np.array([np.ones_like(Z)]), Samples({"x": Z, "w": W + 3.0}))
    (squares, placed), *_ = found.ranked(among, [])
    assert [t.text for t in placed.choice.terms] == ["x*exp(rise_w**-1*w)", "x**2*exp(rise_w**-1*w)"]
    assert placed.values["rise_w"] == pytest.approx(1.0 / 0.7, rel=1e-6)
    assert squares < 1e-12 * float(found.said @ found.said)
