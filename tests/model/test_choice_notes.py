"""Sentences on what was suspected of terms that may imitate a function."""

import pytest

from odescope.model.notes import notes_of, warnings_of
from odescope.model.scores import ModelScores, SuspicionScore


def said(scores):
    return notes_of(scores, (), None)


@pytest.mark.parametrize(("rates", "degrees"), [((0.0158, 0.0191), True), ((0.01, 0.05), False), ((0.9, 1.1), False)])
def test_what_repeats_every_360_may_be_an_angle_in_degrees(rates, degrees):
    wave = ("sin(rate_x*x)",)
    found = SuspicionScore("x_ddot", "x", "recurring", 0, *rates, tried=wave, found=wave, gain=50.0)
    (note,) = said(ModelScores(suspicions=(found,)))
    assert ('unit = "deg" in [coordinates.x]' in note) == degrees


@pytest.mark.parametrize("tried", [("log(x)", "sqrt(x)"), ()])
@pytest.mark.parametrize(("terms", "warns"), [(2, False), (3, False), (4, True)])
def test_a_short_fraction_is_a_law_and_a_long_one_may_imitate_a_function(terms, warns, tried):
    found = SuspicionScore("x_dot", "x", "fractions", terms, 0.1, 2.0, tried=tried, found=(), gain=-424.0)
    scores = ModelScores(suspicions=(found,))
    (note,) = said(scores)
    assert note.startswith("x_dot holds x in a denominator: ")
    assert ("if these terms imitate another function" in note) == warns
    assert warnings_of(scores, None) == ((note,) if warns else ())


def test_what_is_left_beside_a_function_in_place_of_a_fraction_is_one_too():
    wave = {"tried": ("tan(x)", "sin(x)"), "found": ("tan(x)",), "gain": 21.0}
    told = {n: SuspicionScore("x_ddot", "x", "fractions", n, -0.4, 0.5, **wave) for n in (3, 5)}
    (short,), (long,) = (said(ModelScores(suspicions=(score,))) for score in told.values())
    assert short == (
        "x_ddot has tan(x) in place of a fraction in x, which lowers -2 log-likelihood + penalty by 21"
        " (2 functions competed)"
    )
    assert long.startswith(f"{short}; if these terms imitate another function")


@pytest.mark.parametrize(
    ("gain", "told"),
    [
        (-17260.4, "none is better than the model's own terms, the best is worse by far"),
        (-172.4, "none is better than the model's own terms, the best raises -2 log-likelihood + penalty by 172"),
        (-0.3, "none is better than the model's own terms"),  # by 0 is nothing to read
        (None, "none is better than the model's own terms"),
        (12.0, "none is better in the end than the model's own terms"),
        (float("-inf"), "with none of them can the record be followed"),
    ],
)
def test_functions_that_do_not_win_are_told_beside_the_terms_that_do(gain, told):
    found = SuspicionScore("x_dot", "x", "powers", 2, 0.1, 2.0, tried=("log(x)", "sqrt(x)"), found=(), gain=gain)
    (note,) = said(ModelScores(suspicions=(found,)))
    assert note == f"x_dot holds several powers of x: 2 functions of it were tried, {told}"
