"""Forms that compete: Lagrange's equations, reactions, relations; what is said of each, and what is refused."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from identification_cases import REGRESSED, TIME, noisy
from scipy.integrate import solve_ivp

from odescope.commands.demo import cart_pendulum, simulate_log
from odescope.errors import InputError
from odescope.export.model_file import from_json, to_json
from odescope.model.notes import trust
from odescope.model.relation import NORMAL
from odescope.model.simulation import simulate
from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Driven, Measured, Study

CART = Study(
    data=TIME,
    coordinates={"x": Measured(order=2, cyclic=True), "phi": Measured(order=2, angle=True)},
    inputs={"u": Driven()},
    library=Candidates(form="lagrangian"),
)
# In units of the force; the joint friction is that of the paper, and R is half of the power that is lost.
ENERGIES = {
    ("kinetic", "x_dot**2"): 0.9,
    ("kinetic", "phi_dot*x_dot*cos(phi)"): 0.18,
    ("kinetic", "phi_dot**2"): 0.02754,
    ("potential", "cos(phi)"): -1.7658,
    ("dissipation", "x_dot**2"): 5.0,
    ("dissipation", "phi_dot**2"): 0.005,
    ("force", "u on x"): 1.0,
}


def with_library(study, **options):
    return msgspec.structs.replace(study, library=Candidates(**options))


def columns(log, kept=slice(None)):
    return {"t": log.t[kept], "x": log.measured[kept, 0], "phi": log.measured[kept, 1], "u": log.force[kept]}


def found(result):
    return {(m.kind, m.name): m for m in result.model.mechanisms}


def assert_cart(result, scale=1.0):
    mechanisms = found(result)
    assert mechanisms.keys() == ENERGIES.keys()
    for key, truth in ENERGIES.items():
        m = mechanisms[key]
        error = 0.0 if m.std_error is None else m.std_error
        assert abs(m.coefficient - scale * truth) <= 5.0 * error + 1e-12, key
        assert error < 0.01 * abs(m.coefficient), key


# Lagrange's equations


@pytest.fixture(scope="module")
def log():
    return simulate_log(0, 3)


@pytest.fixture(scope="module")
def lagrangian(log):
    return identify(CART, columns(log))


def test_lagranges_equations_of_the_cart_are_exact(lagrangian):
    assert_cart(lagrangian)
    assert lagrangian.refinement.follows
    # Alone, it has nobody to compete with, and regression on relations was not asked for.
    assert lagrangian.model.scores.forms == ()
    assert lagrangian.searches == ()
    assert lagrangian.chosen == ()
    assert "regression" not in lagrangian.seconds


def test_the_relations_are_what_the_mechanisms_add_up_to(lagrangian):
    m = {key: f.coefficient for key, f in found(lagrangian).items()}
    mass, couple = 2.0 * m["kinetic", "x_dot**2"], m["kinetic", "phi_dot*x_dot*cos(phi)"]
    inertia = 2.0 * m["kinetic", "phi_dot**2"]
    expected = [
        {"x_ddot": 1.0, "phi_ddot*cos(phi)": couple / mass, "phi_dot**2*sin(phi)": -couple / mass,
         "x_dot": 2.0 * m["dissipation", "x_dot**2"] / mass, "u": -1.0 / mass},
        {"phi_ddot": 1.0, "x_ddot*cos(phi)": couple / inertia, "sin(phi)": -m["potential", "cos(phi)"] / inertia,
         "phi_dot": 2.0 * m["dissipation", "phi_dot**2"] / inertia},
    ]  # fmt: skip
    for relation, terms in zip(lagrangian.model.relations, expected, strict=True):
        assert {t.text: t.coefficient for t in relation.terms} == pytest.approx(terms, rel=1e-9)
        for t in relation.terms[1:]:
            low, high = t.interval
            assert low < t.coefficient < high
            assert high - low == pytest.approx(2.0 * NORMAL * t.std_error)


def test_the_relations_in_the_file_simulate_the_log(lagrangian, log):
    text = to_json(lagrangian.model)
    read = from_json(text)
    assert read.mechanisms == lagrangian.model.mechanisms
    assert read.relations == lagrangian.model.relations
    assert to_json(read) == text
    kept = slice(0, 3000)
    run = simulate(read, log.t[kept], log.force[kept, None], log.states[0])
    assert run.ended is None
    # It falls over from next to upright, which makes little differences large.
    off = np.abs(run.states - log.states[kept]).max(axis=0) / np.ptp(log.states[kept], axis=0)
    assert off.max() < 0.02


def test_errors_of_relations_hold_the_truth(lagrangian):
    m1, mc, a1 = 1.0, 0.8, 0.18
    inertia = 1.7 * m1 * a1**2
    truth = [
        {"x_dot": 10.0 / (m1 + mc), "u": -1.0 / (m1 + mc), "phi_ddot*cos(phi)": m1 * a1 / (m1 + mc)},
        {"sin(phi)": m1 * 9.81 * a1 / inertia, "x_ddot*cos(phi)": m1 * a1 / inertia, "phi_dot": 0.01 / inertia},
    ]
    for relation, terms in zip(lagrangian.model.relations, truth, strict=True):
        stated = {t.text: t for t in relation.terms}
        for text, value in terms.items():
            assert abs(stated[text].coefficient - value) < 5.0 * stated[text].std_error


def test_the_same_study_gives_the_same_file(lagrangian, log):
    assert to_json(identify(CART, columns(log)).model) == to_json(lagrangian.model)


@pytest.mark.slow
def test_ties_give_the_scale(log):
    """With the mass known and not the force, everything is in kilograms all the same."""
    tied = with_library(CART, form="lagrangian", ties=("x_dot**2 in kinetic = 0.9",))
    result = identify(tied, columns(log))
    mechanisms = found(result)
    assert mechanisms.keys() == ENERGIES.keys()
    assert mechanisms["kinetic", "x_dot**2"].coefficient == 0.9
    assert mechanisms["kinetic", "x_dot**2"].std_error is None
    for key, truth in ENERGIES.items():
        m = mechanisms[key]
        assert abs(m.coefficient - truth) <= 5.0 * (m.std_error or 0.0)


def test_terms_of_ones_own_are_all_that_is_looked_for(log):
    own = with_library(
        CART, form="lagrangian",
        kinetic=("x_dot**2", "phi_dot**2", "x_dot*phi_dot*cos(phi)", "x_dot*phi_dot*sin(phi)"),
        potential=("cos(phi)", "sin(phi)"), dissipation=("x_dot**2", "phi_dot**2"), forces={"x": ("u",)},
    )  # fmt: skip
    assert_cart(identify(own, columns(log)))


def test_without_the_likelihood_the_regression_on_mechanisms_is_the_model(log):
    result = identify(msgspec.structs.replace(CART, likelihood=REGRESSED), columns(log))
    assert result.refinement is None
    mechanisms = found(result)
    for key, truth in ENERGIES.items():
        assert mechanisms[key].coefficient == pytest.approx(truth, rel=0.15), key
        assert mechanisms[key].std_error is None


@pytest.mark.slow
def test_a_delay_is_estimated_for_lagranges_equations_too():
    log = simulate_log(2, 2)
    data = columns(log)
    data["u"] = np.interp(log.t + 0.03, log.t, log.force)  # it acts 0.03 s after it was recorded
    terms = ("u", "x_dot", "phi_dot", "sin(phi)", "phi_dot**2*sin(phi)", "x_ddot", "phi_ddot")
    terms += ("x_ddot*cos(phi)", "phi_ddot*cos(phi)")
    late = with_library(CART, form="lagrangian", terms=terms, coupled=True)
    late = msgspec.structs.replace(late, inputs={"u": Driven(delay="estimate")})
    result = identify(late, {name: values[:20_000] for name, values in data.items()})
    assert result.model.scores.delays["u"].delay == pytest.approx(0.03, abs=0.002)
    assert found(result)["kinetic", "x_dot**2"].coefficient == pytest.approx(0.9, rel=0.01)


# auto


def test_auto_says_how_each_form_did_and_takes_the_better():
    result = identify(with_library(CART), columns(simulate_log(1, 3)))
    scores = {s.form: s for s in result.model.scores.forms}
    assert scores.keys() == {"lagrangian", "relations"}
    assert [s.form for s in scores.values() if s.chosen] == ["lagrangian"]
    assert scores["lagrangian"].follows
    assert scores["lagrangian"].misfit == pytest.approx(1.0, abs=0.1)
    assert scores["lagrangian"].coefficients == len(ENERGIES) - 1
    assert scores["relations"].coefficients > len(ENERGIES)
    assert all(0.0 <= s.free_run <= 1.0 for s in scores.values())
    assert_cart(result)
    assert len(result.searches) == 2  # the relations were looked for all the same
    # What is known of those is not said of these: of mechanisms the denominators and free runs are.
    for score in result.model.scores.targets.values():
        assert (score.r2_held_out, score.rmse_held_out, score.explained_held_out, score.condition) == (None,) * 4
        assert not score.denominator.vanishes
    assert set(result.model.scores.targets) == {"x_ddot", "phi_ddot"}
    lines = " ".join(trust(result.model.scores))
    assert "of the variance of" not in lines
    assert "Fitted without the held-out stretches and run freely over them" in lines
    assert from_json(to_json(result.model)).scores.forms == result.model.scores.forms


FORMS = [
    ("two of order 2", CART.coordinates, {}, ("relations", "lagrangian")),
    ("one of order 2", {"x": Measured(order=2)}, {}, ("relations",)),
    ("one of two of order 1", {"x": Measured(order=2), "y": Measured()}, {}, ("relations",)),
    ("terms of ones own", CART.coordinates, {"terms": ("x_dot", "phi_dot", "x_ddot", "phi_ddot")}, ("relations",)),
    ("the paper's", CART.coordinates, {"preset": "paper"}, ("relations",)),
    ("by name", CART.coordinates, {"form": "relations"}, ("relations",)),
    ("by a term of an energy", CART.coordinates, {"potential": ("cos(phi)",)}, ("lagrangian",)),
    ("by a reaction", {"a": Measured(), "b": Measured()}, {"reactions": ("a -> b",)}, ("reactions",)),
]


@pytest.mark.parametrize(("coordinates", "library", "forms"), [f[1:] for f in FORMS], ids=[f[0] for f in FORMS])
def test_which_forms_compete(coordinates, library, forms):
    study = Study(coordinates=coordinates, library=Candidates(**library))
    assert study.forms() == forms
    # Without the likelihood nothing judges between forms.
    without = msgspec.structs.replace(study, likelihood=REGRESSED)
    assert without.forms() == (forms if len(forms) == 1 else ("relations",))


# reactions


SPECIES = {name: Measured() for name in "SECP"}
COMPOSITION = {"S": "s", "E": "e", "C": "s e", "P": "s"}
RATES = {"S + E -> C": 2.0, "C -> S + E": 0.5, "C -> E + P": 1.0}


def slope(_, y):
    bind, split = 2.0 * y[0] * y[1] - 0.5 * y[2], y[2]
    return [-bind, split - bind, bind - split, split]


@pytest.fixture(scope="module")
def enzyme():
    """Three runs of S + E <-> C -> E + P, with noise of 1 % of each amount's own spread."""
    rng, t, runs = np.random.default_rng(0), 0.02 * np.arange(400), []
    for s, e in ((1.0, 0.5), (2.0, 0.3), (0.6, 0.8)):
        y = solve_ivp(slope, (0.0, t[-1]), [s, e, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-11).y
        runs.append({"t": t, **{name: noisy(rng, row, 0.01) for name, row in zip("SECP", y, strict=True)}})
    return runs


@pytest.mark.slow
@pytest.mark.parametrize(
    "library",
    [
        pytest.param({"composition": COMPOSITION}, id="composition"),
        pytest.param(
            {"form": "reactions", "reactions": ("S + E <-> C", "C <-> E + P", "S <-> P")},
            id="named",
        ),
        pytest.param(
            {"reactions": ("S + E <-> C", "C -> E + P", "S -> P"), "composition": COMPOSITION},
            id="both",
        ),
    ],
)
def test_the_reactions_of_an_enzyme_are_found_with_their_rates(enzyme, library):
    result = identify(Study(data=TIME, coordinates=SPECIES, library=Candidates(**library)), enzyme)
    assert {m.name for m in result.model.mechanisms} == RATES.keys()
    for m in result.model.mechanisms:
        assert m.kind == "reaction"
        assert abs(m.coefficient - RATES[m.name]) < 5.0 * m.std_error
        assert m.std_error < 0.05 * m.coefficient
    # One rate stands in every balance that it enters.
    balances = [{t.text: t.coefficient for t in r.terms} for r in result.model.relations]
    assert [b["C"] for b in balances] == pytest.approx(
        [-rates_of(result)["C -> S + E"], -1.0 * sum(rates_of(result)[n] for n in ("C -> S + E", "C -> E + P")),
         sum(rates_of(result)[n] for n in ("C -> S + E", "C -> E + P")), -rates_of(result)["C -> E + P"]]
    )  # fmt: skip
    assert [b.get("E*S", b.get("S*E", 0.0)) for b in balances] == pytest.approx(
        [s * rates_of(result)["S + E -> C"] for s in (1.0, 1.0, -1.0, 0.0)]
    )
    read = from_json(to_json(result.model))
    assert read.mechanisms == result.model.mechanisms


def rates_of(result):
    return {m.name: m.coefficient for m in result.model.mechanisms}


# what is refused


@pytest.mark.parametrize(
    ("library", "message"),
    [
        ({"form": "lagrangian", "kinetic": ("x_dot",)}, "adds nothing to any equation"),
        ({"form": "lagrangian", "potential": ("x_dot**2",)}, "a potential is a function of positions"),
        ({"form": "lagrangian", "forces": {"y": ("u",)}}, "there is no coordinate 'y'"),
        ({"form": "lagrangian", "ties": ("u = y",)}, "'y'"),
        ({"form": "reactions", "reactions": ("x -> phi",)}, "order"),
    ],
)
def test_what_a_form_cannot_hold_is_refused_before_anything_is_computed(library, message):
    t = 0.01 * np.arange(500)
    data = {"t": t, "x": np.sin(t), "phi": np.cos(2.0 * t), "u": np.sin(3.0 * t)}
    stages = []
    with pytest.raises(InputError, match=message):
        identify(with_library(CART, **library), data, watch=lambda e: stages.append(getattr(e, "stage", None)))
    assert "signals" not in stages


@pytest.mark.parametrize(
    ("library", "message"),
    [
        ({"form": "relations", "kinetic": ("x_dot**2",)}, r'kinetic belongs to form = "lagrangian", but form is "rela'),
        ({"form": "lagrangian", "reactions": ("a -> b",)}, r'reactions belongs to form = "reactions"'),
        ({"form": "reactions"}, r'form = "reactions" needs \[library\] reactions'),
        ({"kinetic": ("x_dot**2",), "reactions": ("a -> b",)}, "they belong to different forms"),
    ],
)
def test_options_that_belong_to_another_form_are_refused(library, message):
    with pytest.raises(InputError, match=message):
        Candidates(**library)


def test_the_truth_of_the_tests_is_that_of_the_demo():
    """Energies by hand against the demo's explicit model, at rest and upside down."""
    m = ENERGIES
    mass, couple = 2.0 * m["kinetic", "x_dot**2"], m["kinetic", "phi_dot*x_dot*cos(phi)"]
    inertia, gravity = 2.0 * m["kinetic", "phi_dot**2"], -m["potential", "cos(phi)"]
    rng = np.random.default_rng(0)
    for _ in range(5):
        phi, v, w, u = rng.uniform(-2.0, 2.0, 4)
        a = np.array([[mass, couple * np.cos(phi)], [couple * np.cos(phi), inertia]])
        b = [couple * w**2 * np.sin(phi) - 10.0 * v + u, -gravity * np.sin(phi) - 0.01 * w]
        run = simulate(cart_pendulum(), np.array([0.0, 1e-4]), np.full((2, 1), u), np.array([0.0, phi, v, w]))
        rates = (run.states[1, 2:] - run.states[0, 2:]) / 1e-4
        np.testing.assert_allclose(rates, np.linalg.solve(a, b), rtol=0.02, atol=0.05)
