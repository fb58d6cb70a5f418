"""Sentences on free runs, and on what a model is not for."""

import pytest

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.cautions import cautions
from odescope.model.free_run_notes import free_run_sentences, parting_sentences, unexplained_parting
from odescope.model.model import Model
from odescope.model.notes import warnings_of
from odescope.model.relation import Relation, RelationTerm
from odescope.model.scores import CoordinateRun, FreeRun, Likelihood, ModelScores
from odescope.recordings.coordinate import Coordinate, Input


def run(duration, valid, recording=1, fit=None, **more):
    coordinates = {"x": CoordinateRun(valid, fit, 0.1)}
    return FreeRun(duration, valid, recording=recording, coordinates=coordinates, **more)


def told(*runs):
    return list(free_run_sentences(runs))


def test_one_recording_is_told_in_seconds():
    start = "Run freely from its start, it stays with the recording for "
    assert told(run(8.0, 8.0, fit=98.76)) == [f"{start}all of its 8 s (fit of x 98.8 %)."]
    assert told(run(65.0, 36.34, fit=10.0)) == [f"{start}36.34 of 65 s."]
    assert told(run(11.98, 11.96)) == [f"{start}11.96 of 11.98 s."]  # as many digits as what it is of
    assert told(run(8.0, 8.0, recorded=3600.0)) == [f"{start}all of the first 8 s, which were tried, of 3600 s."]
    assert told(run(8.0, 8.0, fit=99.99)) == [f"{start}all of its 8 s (fit of x over 99.9 %)."]
    assert told(run(8.0, 0.5, ended="met a pole"))[1] == "The free run ended early: met a pole."
    assert told() == []


JOINED = Likelihood(True, 1.0, 0.001, True, 1, None, (), ())
NOISY = Likelihood(True, 1.0, 1.0, True, 1, {"x_dot": 0.1}, (), ())


@pytest.mark.parametrize(
    ("judged", "growth", "words"),
    [
        (JOINED, 100.0, "as any law does where errors grow by themselves (100 times until then): in chaos"),
        (JOINED, 1.2, "although errors do not grow by themselves in it (1.2 times until then): that speaks against it"),
        (JOINED, None, "after 0.5 s. Predictions of a few steps judge it"),
        (NOISY, 1234.5, "adds up, and errors grow by themselves (1,234 times until then), as in chaos"),
        (NOISY, 1.2, "what it leaves unexplained adds up"),
    ],
)
def test_that_a_law_parts_from_its_record_is_excused_where_errors_grow(judged, growth, words):
    runs = [run(8.0, 0.5, growth=growth)]
    (sentence,) = parting_sentences(runs, judged)
    assert words in sentence
    assert "parts from" in sentence
    against = growth == 1.2 and judged is JOINED
    assert ("grow by themselves" in sentence) == (growth in (100.0, 1234.5) or against)
    assert unexplained_parting(runs, judged) == ((sentence,) if against else ())
    assert (sentence in warnings_of(ModelScores(free_runs=tuple(runs), likelihood=judged), None)) == against


def test_no_excuse_is_made_for_what_runs_away_or_does_not_part():
    for growth in (None, 20.0):
        assert not list(parting_sentences([run(8.0, 0.5, ended="met a pole", growth=growth)], JOINED))
    assert not list(parting_sentences([run(8.0, 8.0)], JOINED))
    lost = Likelihood(False, 9.0, 1.0, True, 1, None, (), ())
    assert not list(parting_sentences([run(8.0, 0.5, growth=100.0)], lost))


@pytest.mark.parametrize("judged", [JOINED, NOISY])
def test_what_runs_away_where_errors_grow_may_be_kept_in_place_by_a_controller(judged):
    runs = [run(8.0, 0.25, growth=20.0, ended="met a pole"), run(8.0, 0.5, 2, growth=1234.5, ended="met a pole")]
    (sentence,) = parting_sentences([*runs, run(8.0, 0.75, 3, growth=1.0)], judged)
    assert "after 0.5 s and then runs away" in sentence
    assert "grow by themselves (1,234 times until then)" in sentence
    assert "in a machine that only its controller keeps from falling" in sentence
    assert "in chaos" not in sentence
    assert unexplained_parting(runs, judged) == ()


def test_one_run_that_parts_without_a_reason_is_not_excused_by_others():
    runs = [run(8.0, 0.5, growth=100.0), run(8.0, 7.0, 2, growth=1.0), run(8.0, 0.2, 3, growth=200.0)]
    (sentence,) = parting_sentences(runs, JOINED)
    assert "after 7 s, although errors do not grow" in sentence
    (sentence,) = parting_sentences([runs[0], runs[2]], JOINED)
    assert "after 0.2 s, as any law does" in sentence


def test_of_several_recordings_it_is_told_which_is_lost_first():
    start = "Run freely from their starts, it stays with "
    fits = [run(8.0, 8.0, k, fit=90.0 + k) for k in (1, 2, 3)]
    assert told(*fits) == [f"{start}all 3 recordings to their ends (fit of x 91 % to 93 %)."]
    lost = told(fits[0], run(8.0, 2.0, 2), run(4.0, 0.5, 3))
    assert lost == [
        f"{start}1 of 3 recordings to their ends and parts from the others soonest after 0.5 of 4 s of recording 3."
    ]
    none = told(run(8.0, 2.0, 1), run(4.0, 0.5, 2))
    assert none == [f"{start}none of the 2 recordings to its end; it parts soonest after 0.5 of 4 s of recording 2."]
    spread = told(run(8.0, 8.0, 1), run(8.0, 8.0, 90))
    assert spread == [f"{start}all 2 recordings that were tried, of 90, to their ends."]


TERMS = {"x_ddot": (1.0, None), "sin(phi)": (2.0, 0.1), "x_dot": (0.3, 0.2), "u": (-1.0, 0.01)}


def model(terms=TERMS, scores=None):
    scope = Scope.of(("x", "phi", "x_dot", "phi_dot", "u"))
    first = [
        RelationTerm(Product("x_ddot") if t == "x_ddot" else Product(None, parse_term(t, scope)), c, e)
        for t, (c, e) in terms.items()
    ]
    second = [RelationTerm(Product("phi_ddot"), 1.0), RelationTerm(Product(None, parse_term("phi", scope)), 4.0, 0.1)]
    return Model(
        (Coordinate("x", 2, cyclic=True), Coordinate("phi", 2, angle=True)),
        (Input("u"),),
        (Relation(tuple(first)), Relation(tuple(second))),
        scores=scores,
        domain={"x": (-9.0, 9.0), "phi": (-0.2, 0.3), "x_dot": (-1.0, 2.0), "phi_dot": (-3.0, 4.0), "u": (-5.0, 5.0)},
    )


def test_the_data_bound_what_it_is_for():
    (ranges,) = [line for line in cautions(model(), {"u": "N"}) if "extrapolates" in line]
    assert "u from −5 to 5 N" in ranges
    assert "phi from −0.2 to 0.3," in ranges  # an angle that never turned over
    assert "x from" not in ranges  # cyclic: the equations do not hold it


def test_terms_of_which_little_is_known_are_named():
    lines = cautions(model(), {})
    assert lines[-1].endswith("no small part of them: x_dot in x_ddot (± 67 %).")
    sure = cautions(model({**TERMS, "x_dot": (0.3, 0.003)}), {})
    assert sure[-1] == "The least certain coefficient is that of sin(phi) in x_ddot: ± 5 %."


def test_how_far_ahead_is_the_soonest_that_a_free_run_parts():
    scores = ModelScores(free_runs=(run(8.0, 8.0), run(8.0, 3.21, 2), run(8.0, 5.0, 3)))
    assert "further ahead than some 3.2 s" in cautions(model(scores=scores), {})[0]
    whole = ModelScores(free_runs=(run(8.0, 8.0),))
    assert not any("further ahead" in line for line in cautions(model(scores=whole), {}))


@pytest.mark.parametrize("follows", [True, False])
def test_a_model_that_is_uncertain_as_a_whole_says_so_first(follows):
    scores = ModelScores(likelihood=Likelihood(follows, 9.0, 0.1, True, 3, None, (), ()))
    assert cautions(model(scores=scores), {})[0].startswith("Uncertain: ") is not follows


def test_terms_are_told_as_they_are_typed():
    scope = Scope.of(["S", "K"])
    term = RelationTerm(Product(None, parse_term("S*(S + K)**-1", scope)), -2.0, 0.01)
    one = RelationTerm(Product("S_dot", parse_term("1", scope)), 1.0)
    model = Model((Coordinate("S"),), (Input("K"),), (Relation((one, term)),), ModelScores(), {}, {})
    assert "The least certain coefficient is that of S/(K + S) in S_dot: ± 0.5 %." in cautions(model, {})
