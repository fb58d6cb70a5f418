"""The sentence that says before the equations what a model is worth, or why it is uncertain as a whole."""

import msgspec
import pytest

from odescope.model.scores import Conserved, Doubts, Likelihood, ModelScores, PathScore, SuspicionScore, TargetScore
from odescope.model.worth import uncertain, verdict


def likelihood_of(follows, process_noise):
    return Likelihood(follows, 1.0, 0.0, True, 1, process_noise, (), ())


@pytest.mark.parametrize(
    ("follows", "process_noise", "error", "r2", "words"),
    [
        (True, None, 0.01, 0.99, ""),
        (True, None, 0.9, 0.99, ""),  # chaos
        (True, {"x_dot": 0.1}, 0.1, 0.2, ""),
        (True, {"x_dot": 0.1}, 0.8, 0.99, "off by 0.8 times the standard deviation of the record"),
        (False, None, 0.01, 0.99, "does not follow the record"),
        (None, None, None, 0.8, ""),
        (None, None, None, 0.3, "30.00 % of the variance of x_dot"),
    ],
)
def test_an_uncertain_model_is_said_to_be_so_in_one_sentence(follows, process_noise, error, r2, words):
    path = () if error is None else (PathScore(3, error, 0.0, None, None, True),)
    judged = None if follows is None else likelihood_of(follows, process_noise)
    found = uncertain(ModelScores({"x_dot": TargetScore(r2_held_out=r2)}, likelihood=judged, path=path))
    assert found.startswith("uncertain: ") if words else found == ""
    assert words in found
    assert "\n" not in found


@pytest.mark.parametrize(
    ("drift", "process_noise", "said"),
    [(0.3, {"x_dot": 0.1}, True), (0.03, {"x_dot": 0.1}, False), (0.3, None, False), (None, {"x_dot": 0.1}, False)],
)
def test_reactions_that_lack_a_feed_are_uncertain_where_the_record_asks_for_noise(drift, process_noise, said):
    kept = (Conserved("A + B", (), True, drift),)
    found = uncertain(ModelScores(likelihood=likelihood_of(True, process_noise), conserved=kept))
    assert found.startswith("uncertain: these reactions would keep A + B constant") == said
    assert ('"-> S"' in found) == said


def test_a_model_without_scores_is_not_called_uncertain():
    assert uncertain(None) == ""


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ({"x_dot": 0.01}, ""),
        ({"x_dot": 0.3}, ""),
        ({"x_dot": 0.4}, "uncertain: this model leaves 40.00 % of x_dot unexplained, by root mean squares"),
        (
            {"x_dot": 0.4, "y_dot": 0.1, "z_dot": 0.9},
            "uncertain: this model leaves 40.00 % of x_dot and 90.00 % of z_dot unexplained, by root mean squares",
        ),
    ],
)
def test_a_model_that_leaves_much_of_a_target_is_uncertain(parts, said):
    judged = msgspec.structs.replace(likelihood_of(True, dict.fromkeys(parts, 1.0)), unexplained=parts)
    assert uncertain(ModelScores(likelihood=judged)) == said


@pytest.mark.parametrize(
    ("judged", "warned", "told"),
    [
        ({}, False, "this model follows the record to within its noise; no term of it is in doubt"),
        ({}, True, "this model follows the record to within its noise; what may be in doubt is warned of below"),
        (
            {"process_noise": {"x_ddot": 0.1}, "unexplained": {"x_ddot": 0.012}},
            False,
            "this model follows the record but for 1.20 % of x_ddot",
        ),
        (
            {"process_noise": {"x_ddot": 0.1}, "unexplained": {"x_ddot": 0.0004}},
            False,
            "this model follows the record but for less than 0.05 % of every target",
        ),
        ({"process_noise": {"x_ddot": 0.1}}, True, "this model follows the record"),
    ],
)
def test_a_sentence_says_what_a_model_is_worth(judged, warned, told):
    scores = ModelScores(likelihood=msgspec.structs.replace(likelihood_of(True, None), **judged))
    assert verdict(scores, None, warned) == told


def test_what_is_uncertain_as_a_whole_is_said_in_its_place():
    scores = ModelScores(likelihood=likelihood_of(False, None))
    assert verdict(scores, None, False) == uncertain(scores) != ""
    assert verdict(None, None, True) == verdict(ModelScores(), None, True) == ""


def suspected(variable, terms, found=()):
    return SuspicionScore("x_ddot", variable, "powers", terms, 0.0, 1.0, ("tanh(x)", "sqrt(x)"), found, -20.0)


THIN, ALIKE = ("x_dot", "x_ddot", 3.1), ("x**3", "x_ddot", "sin(x)")
IMITATES = "what it has for x_ddot may imitate another function"


@pytest.mark.parametrize(
    ("suspicions", "thin", "alike", "told"),
    [
        ([suspected("x", 3), suspected("x_dot", 3)], (), (), IMITATES),
        ([suspected("x", 2)], (), (), "what may be in doubt is warned of below"),  # two powers are rarely a function
        ([suspected("x", 0, ("tanh(x)",))], (THIN,), (), "in doubt is x_dot in x_ddot"),
        ([suspected("x", 3)], (THIN,), (THIN, ALIKE), f"{IMITATES}; in doubt are x_dot in x_ddot and x**3 in x_ddot"),
        ([], [(f"x**{n}", "v", 3.0) for n in range(5)], (), "in doubt are x**0 in v, x**1 in v, x**2 in v and 2 more"),
    ],
)
def test_what_may_be_in_doubt_is_named_before_the_equations(suspicions, thin, alike, told):
    scores = ModelScores(likelihood=likelihood_of(True, None), suspicions=tuple(suspicions))
    found = verdict(scores, Doubts(False, False, None, tuple(thin), tuple(alike)), True)
    assert found.startswith("this model follows the record to within its noise; ")
    assert found.endswith(told)
