"""Dependent candidates, data that support no model, and tables over seeds."""

from __future__ import annotations

import importlib

import msgspec
import numpy as np
import pytest
from identification_cases import (
    DEMO,
    assert_recovers,
    band,
    noisy,
    relations,
    runge_kutta,
    study_of,
)

from odescope.commands.demo import cart_pendulum, table_two
from odescope.errors import InputError, NoModelError
from odescope.likelihood.search import LikelihoodSearch
from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Driven, Measured, Regression


def test_an_identity_left_in_is_named_in_the_notes(log):
    kept = slice(0, 40_000, 5)
    data = {name: values[kept] for name, values in log.items()}
    terms = ("1", "u", "x_dot", "cos(phi)**2", "sin(phi)**2", "phi_dot*cos(phi)", "phi_dot**2*sin(phi)")
    terms += ("sin(phi)*cos(phi)", "x_ddot", "x_ddot*cos(phi)**2", "u*cos(phi)", "x_dot*cos(phi)", "sin(phi)")
    terms += ("phi_ddot", "phi_ddot*cos(phi)**2", "phi_dot", "phi_dot**2*sin(phi)*cos(phi)")
    result = identify(msgspec.structs.replace(DEMO, library=Candidates(terms=terms)), data)
    assert result.notes[0] == "these data cannot tell sin(phi)**2 from a combination of 1, cos(phi)**2"
    for row in table_two(cart_pendulum(), result.model):
        if row.found is not None and row.truth is not None:
            assert row.found == pytest.approx(row.truth, rel=0.03)


def test_a_constant_input_is_refused_by_name():
    t = 0.01 * np.arange(500)
    with pytest.raises(InputError, match="'u' is constant in all recordings"):
        identify(
            study_of(coordinates={"x": Measured()}, inputs={"u": Driven()}),
            {"t": t, "x": np.exp(-t), "u": np.full(500, 2.0)},
        )


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_is_no_signal(order, seed):
    rng = np.random.default_rng(seed)
    study = study_of(coordinates={"x": Measured(order=order)})
    with pytest.raises(NoModelError, match=r"the signals stage came out empty: x holds nothing above its noise") as e:
        identify(study, {"t": 0.01 * np.arange(3000), "x": rng.standard_normal(3000)})
    assert (e.value.stage, e.value.exit_code) == ("signals", 3)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_a_random_walk_has_no_law(order, seed):
    rng = np.random.default_rng(seed)
    study = study_of(coordinates={"x": Measured(order=order), "y": Measured(order=order)})
    walks = {name: np.cumsum(rng.standard_normal(3000)) for name in "xy"}
    with pytest.raises(NoModelError, match="the selection stage came out empty") as e:
        identify(study, {"t": 0.01 * np.arange(3000), **walks})
    assert e.value.stage == "selection"
    assert "none is left" in str(e.value) or "less than the 50% asked for" in str(e.value)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_a_random_walk_has_no_law_for_the_likelihood_either(order):
    """With process noise a search describes any record, whatever its terms."""
    rng = np.random.default_rng(0)
    coordinates = {"x": Measured(order=order), "y": Measured(order=order)}
    study = study_of(coordinates=coordinates, likelihood=LikelihoodSearch(budget=4.0))
    walks = {name: np.cumsum(rng.standard_normal(1000)) for name in "xy"}
    with pytest.raises(NoModelError, match="the selection stage came out empty"):
        identify(study, {"t": 0.01 * np.arange(1000), **walks})


@pytest.fixture(scope="module")
def driven():
    """x' = -x + u."""
    rng, t = np.random.default_rng(3), 0.02 * np.arange(2000)
    u = band(rng, len(t), 0.02, 1.0)
    x = runge_kutta(lambda s, u: u - s, t, (0.0,), u)[:, 0]
    return {"t": t, "x": noisy(rng, x, 0.001), "u": u}


DRIVEN = study_of(coordinates={"x": Measured()}, inputs={"u": Driven()})


def test_a_driver_that_was_not_recorded_leaves_no_model(driven):
    assert_recovers(identify(DRIVEN, driven), {"x_dot": {"x_dot": 1.0, "x": 1.0, "u": -1.0}}, rel=0.01)
    with pytest.raises(NoModelError, match="or something that drives the system was not recorded") as e:
        identify(msgspec.structs.replace(DRIVEN, inputs={}), driven)
    assert e.value.stage == "selection"
    assert "order" not in str(e.value)


def misread(seed, rate, states, lost):
    """A log of what a study takes for a state of first order; of what drives it `lost` times another is not read."""
    rng, t = np.random.default_rng(seed), 0.02 * np.arange(3000)
    u, other = band(rng, len(t), 0.02, 0.5), band(rng, len(t), 0.02, 0.5)
    x = runge_kutta(rate, t, (0.0,) * states, u + lost * other)[:, 0]
    return {"t": t, "x": noisy(rng, x, 1e-4), "u": u}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 5])
def test_a_position_taken_for_a_state_of_first_order_is_told_from_a_driver_that_was_not_recorded(seed):
    data = misread(seed, lambda s, v: np.array([s[1], v - 4.0 * s[0] - 0.5 * s[1]]), 2, 0.0)
    with pytest.raises(NoModelError, match="Try order = 2 for x"):
        identify(DRIVEN, data)
    higher = msgspec.structs.replace(DRIVEN, coordinates={"x": Measured(order=2)})
    found = relations(identify(higher, data))["x_ddot"]
    assert [found[term] for term in ("x", "x_dot", "u")] == pytest.approx([4.0, 0.5, -1.0], rel=0.01)
    with pytest.raises(NoModelError) as ended:
        identify(DRIVEN, misread(seed, lambda s, v: v - 2.0 * s, 1, 3.0))
    assert "Try order" not in str(ended.value)


def competing_species(noise, recordings, duration, period, seed):
    """x' = x (3 - x - 2 y), y' = y (2 - x - y) from several places: one of the two dies out, the other settles."""
    rng, t, runs = np.random.default_rng(seed), np.arange(0.0, duration, period), []
    for start in rng.uniform(0.2, 3.0, (recordings, 2)):
        s = runge_kutta(lambda s, _: s * (np.array([3.0, 2.0]) - s[0] - s[1] * np.array([2.0, 1.0])), t, start, 0 * t)
        runs.append({"t": t, "x": noisy(rng, s[:, 0], noise), "y": noisy(rng, s[:, 1], noise)})
    return runs


SPECIES = study_of(coordinates={"x": Measured(), "y": Measured()})
SETTLES = {"x_dot": {"x_dot", "x", "x**2", "x*y"}, "y_dot": {"y_dot", "y", "y**2", "x*y"}}


@pytest.mark.parametrize("seed", [0, 2])
def test_a_record_that_comes_to_rest_has_a_law(seed):
    """All that happens is in one fold of five, which the others tell nothing of."""
    found = relations(identify(SPECIES, competing_species(0.0, 1, 60.0, 0.05, seed)))
    assert {target: set(terms) for target, terms in found.items()} == SETTLES


@pytest.mark.slow
def test_a_species_that_dies_out_is_no_factor_of_a_relation():
    """With noise it is below nothing at times, where y x_dot = 3 x y - ... has no solution for x_dot."""
    study = msgspec.structs.replace(SPECIES, likelihood=LikelihoodSearch())
    found = relations(identify(study, competing_species(0.01, 3, 20.0, 0.02, 0)))
    assert {target: set(terms) for target, terms in found.items()} == SETTLES


def test_a_library_without_the_right_terms_leaves_no_model(driven):
    wrong = Candidates(terms=("x**2", "x**3", "x*u", "x_dot"))
    with pytest.raises(NoModelError, match=r"Either the library\s+lacks the right terms"):
        identify(msgspec.structs.replace(DRIVEN, library=wrong), driven)


def test_a_candidate_that_is_not_finite_on_the_data_is_named(driven):
    study = msgspec.structs.replace(DRIVEN, library=Candidates(basis=("x", "u", "log(x)"), degree=1))
    with pytest.raises(InputError, match=r"the candidate log\(x\) has no finite value on \d+ samples"):
        identify(study, driven)


def test_more_candidates_than_samples_are_refused(driven):
    study = msgspec.structs.replace(DRIVEN, library=Candidates(basis=("x", "u"), degree=12))
    few = {name: values[:120] for name, values in driven.items()}
    with pytest.raises(InputError, match=r"\d+ samples cannot decide between \d+ candidate terms for x_dot: record"):
        identify(study, few)


def test_candidates_too_large_to_square_are_refused_by_name(driven):
    study = msgspec.structs.replace(DRIVEN, library=Candidates(basis=("x", "u", "exp(x)"), degree=1))
    large = {**driven, "x": 400.0 + driven["x"]}
    with pytest.raises(InputError, match=r"exp\(x\)"):
        identify(study, large)


def test_a_study_without_a_state_in_its_library_is_refused(driven):
    study = msgspec.structs.replace(DRIVEN, library=Candidates(terms=("u", "x_dot")))
    with pytest.raises(InputError, match="no candidate term contains a state"):
        identify(study, driven)


def test_two_relations_that_say_the_same_determine_nothing():
    """The one law of a' = u - a, b' = -u - b without u is a' + b' = -(a + b), whichever target it is sought for."""
    rng, t = np.random.default_rng(9), 0.01 * np.arange(4000)
    u = band(rng, len(t), 0.01, 0.8)
    s = runge_kutta(lambda s, u: np.array([u, -u]) - s, t, (3.0, 1.0), u)
    study = study_of(
        coordinates={"a": Measured(), "b": Measured()},
        library=Candidates(terms=("a", "b", "a_dot", "b_dot"), coupled=True),
    )
    with pytest.raises(NoModelError, match="the model stage came out empty: the best relations of the targets do not"):
        identify(study, {"t": t, "a": noisy(rng, s[:, 0], 1e-3), "b": noisy(rng, s[:, 1], 1e-3)})


def test_nested_search_can_be_switched_off_and_still_finds_a_plain_law(driven):
    study = msgspec.structs.replace(DRIVEN, regression=Regression(nested=False))
    assert_recovers(identify(study, driven), {"x_dot": {"x_dot": 1.0, "x": 1.0, "u": -1.0}}, rel=0.01)


@pytest.fixture(scope="module")
def table():
    bench = importlib.import_module("demo_table")
    return {level: [bench.run((seed, level, 0.01)) for seed in range(20)] for level in (1, 2)}


@pytest.mark.slow
def test_level_1_is_exact_in_18_of_20(table):
    for k, target in enumerate(("x_ddot", "phi_ddot")):
        outcomes = [run[k] for run in table[1]]
        assert {o.target for o in outcomes} == {target}
        exact = [o for o in outcomes if not o.missing and not o.extra]
        assert len(exact) >= 18, target
        assert max(o.error for o in exact) < 0.02, target


@pytest.mark.slow
def test_level_2_is_exact_but_for_joint_friction(table):
    cart, pendulum = ([run[k] for run in table[2]] for k in (0, 1))
    assert sum(not o.missing and not o.extra for o in pendulum) >= 17
    assert sum(not o.extra and o.missing <= {"phi_dot*cos(phi)"} for o in cart) >= 13


@pytest.mark.slow
@pytest.mark.parametrize("name", ["michaelis-menten", "lorenz", "predator-prey"])
def test_other_systems_over_seeds(systems, name):
    found = [systems.attempt((name, 0.001, seed)) for seed in range(10)]
    for target in systems.CASES[name].truth:
        assert sum(outcome[target] == "" for outcome in found) >= 9, target


@pytest.mark.slow
def test_searches_begin_from_as_many_proposals_as_asked_for_and_the_best_end_is_taken(systems):
    """On the first of these logs the first proposal and the forward selection both end worse than a later proposal.

    On the other one, at 50 % noise, no search is clear: all proposals are tried, beside the forward selection.
    """

    def ends(name, noise, seed, starts):
        case = systems.CASES[name]
        library = msgspec.structs.replace(case.study.library, suspect=False)  # functions begin from what was found
        data = systems.noisy(case, noise, np.random.default_rng(seed))
        studies = (
            msgspec.structs.replace(case.study, library=library, likelihood=LikelihoodSearch(starts=n)) for n in starts
        )
        return [identify(study, data) for study in studies]

    few, more = ends("predator-prey", 0.3, 9, (1, 4))
    assert few.model.scores.likelihood.starts == 3  # rows are few: candidates of low degree are a start, too
    assert more.refinement.outcome.penalised < few.refinement.outcome.penalised - 5.0
    few, more = ends("michaelis-menten", 0.5, 7, (2, 4))
    assert more.model.scores.likelihood.starts > few.model.scores.likelihood.starts > 3
    assert more.refinement.outcome.penalised < few.refinement.outcome.penalised + 1e-3


@pytest.mark.parametrize(
    ("name", "noise", "seed", "penalised"),
    [
        ("michaelis-menten", 0.5, 7, 158.2),
        pytest.param("predator-prey", 0.2, 11, 596.1, marks=pytest.mark.slow),
        pytest.param("predator-prey", 0.3, 1, 485.3, marks=pytest.mark.slow),
        pytest.param("predator-prey", 0.2, 4, 457.9, marks=pytest.mark.slow),
    ],
)
def test_no_coefficient_runs_off_beside_one_that_is_next_to_nothing(systems, name, noise, seed, penalised):
    """Logs on which a search came to hold a weak coefficient: all others then grew without end."""
    case = systems.CASES[name]
    result = identify(case.study, systems.noisy(case, noise, np.random.default_rng(seed)))
    assert result.refinement.outcome.penalised < penalised
    assert np.abs(result.refinement.fit.theta).max() < 100.0
    assert all(abs(t.coefficient) < 100.0 for r in result.model.relations for t in r.terms)
