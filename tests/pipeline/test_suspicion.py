"""Functions that no library names, from the record to the model and its notes."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import simulate
from odescope.export.model_file import from_json, to_json
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.suspicion import _imitation, imitates
from odescope.model.scores import SuspicionScore
from odescope.pipeline.identification import identify
from odescope.pipeline.suspicion import _joined, replaces
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study
from odescope.study.toml import parse_study, study_toml

NOISE = 0.01


def recorded(rate, starts, t, seed, drive=None):
    """Return logs of x' = rate(x, u) at 1 % noise."""
    rng, logs = np.random.default_rng(seed), []
    for start in starts:
        u = np.zeros(len(t)) if drive is None else drive(t, rng)
        solved = solve_ivp(
            lambda now, x, u=u: [rate(x[0], np.interp(now, t, u))],
            (t[0], t[-1]), [start], t_eval=t, rtol=1e-9, atol=1e-11, max_step=4 * (t[1] - t[0]),
        )  # fmt: skip
        logs.append({"t": t, "x": solved.y[0], **({} if drive is None else {"u": u})})
    size = NOISE * np.concatenate([log["x"] for log in logs]).std()
    for log in logs:
        log["x"] = log["x"] + size * rng.standard_normal(len(t))
    return logs


def inflow(t, rng):
    f, phase = rng.uniform(0.02, 0.3, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    return 0.5 + 0.15 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1)


def study(driven=True, **library):
    return Study(
        data=Data(time="t"),
        coordinates={"x": Measured()},
        inputs={"u": Driven()} if driven else {},
        library=Candidates(**library),
    )


@pytest.fixture(scope="module")
def logs():
    return recorded(lambda x, u: u - 0.5 * np.log(x), [1.0, 4.0], np.arange(0.0, 60.0, 0.05), 0, inflow)


@pytest.fixture(scope="module")
def found(logs):
    return identify(study(), logs)


@pytest.mark.slow
def test_a_logarithm_that_no_library_names_is_found_with_errors_that_hold(found):
    terms = {t.text: t for t in found.model.relations[0].terms}
    assert set(terms) == {"x_dot", "u", "log(x)"}
    for name, value in {"u": -1.0, "log(x)": 0.5}.items():
        assert abs(terms[name].coefficient - value) < 4.0 * terms[name].std_error


def test_what_was_tried_and_what_it_was_worth_is_said(found):
    said = [s for s in found.model.scores.suspicions if s.found]
    assert [(s.target, s.variable, s.found) for s in said] == [("x_dot", "x", ("log(x)",))]
    assert {"log(x)", "sqrt(x)", "tanh(x/scale_x)"} <= set(said[0].tried)
    # Nothing is compared where the model without it follows the record only under process noise.
    assert said[0].gain is None or said[0].gain > 10.0
    assert any("log(x) in place of" in note for note in found.notes)
    assert from_json(to_json(found.model)).scores.suspicions == found.model.scores.suspicions


@pytest.mark.slow
def test_the_rate_of_hill_is_found_with_its_order():
    """A gene that activates itself, and its product that decays."""
    logs = recorded(
        lambda x, u: u + 2.0 * x**2 / (1.0 + x**2) - 1.2 * x, [0.1, 0.6, 2.0], np.arange(0.0, 30.0, 0.05), 0, inflow
    )
    model = identify(study(), logs).model
    terms = {t.text: t for t in model.relations[0].terms}
    (hill,) = set(terms) - {"x_dot", "u", "x"}
    assert model.parameters[0].written == ("x**order_x/(level_x**order_x + x**order_x)",)
    for name, value in {"u": -1.0, "x": 1.2, hill: -2.0}.items():
        assert abs(terms[name].coefficient - value) < 4.0 * terms[name].std_error
    for name, value in {"order_x": 2.0, "level_x": 1.0}.items():
        found = next(p for p in model.parameters if p.name == name)
        assert abs(found.value - value) < 4.0 * found.std_error


def test_without_suspicion_an_imitation_stays_and_is_wrong_beyond_the_record(found, logs):
    plain = identify(study(suspect=False), logs).model
    assert plain.scores.suspicions == ()
    assert not any("log" in t.text for t in plain.relations[0].terms)
    t = np.arange(0.0, 600.0, 1.0)
    more = np.full((len(t), 1), 1.2 * logs[0]["u"].max())
    level = np.exp(more[0, 0] / 0.5)
    ends = [simulate(m, t, more, np.array([2.0])).states[-1, 0] for m in (found.model, plain)]
    assert abs(ends[0] / level - 1.0) < 0.05
    assert not abs(ends[1] / level - 1.0) < 0.05


@pytest.mark.parametrize(
    ("rate", "terms"),
    [
        (lambda x, _: x * (1.0 - x / 3.0), {"x", "x**2"}),
        (lambda x, _: x * (1.0 - x / 3.0) * (x / 0.8 - 1.0), {"x", "x**2", "x**3"}),
    ],
    ids=["logistic growth", "growth with a threshold"],
)
def test_powers_that_are_the_law_stay_and_are_what_they_were(rate, terms):
    logs = recorded(rate, [1.0, 4.0, 0.6], np.arange(0.0, 8.0, 0.02), 0)
    suspecting, plain = identify(study(driven=False), logs), identify(study(driven=False, suspect=False), logs)
    assert {t.text for t in plain.model.relations[0].terms} == {"x_dot", *terms}
    assert suspecting.model.relations == plain.model.relations
    (said,) = suspecting.model.scores.suspicions
    assert said.found == ()
    assert said.gain is None or said.gain < 0.0
    warned = any("no further than the record went, x =" in note for note in suspecting.notes)
    assert warned == (len(terms) > 2)
    assert any("no further than" in note for note in suspecting.warnings) == warned


@pytest.mark.slow
def test_a_pendulum_whose_position_nobody_called_an_angle_has_its_sine():
    """While its energy stays the square of its rate is a function of the position: x and x x_dot^2 imitate the sine."""
    t = np.arange(0.0, 20.0, 0.02)
    x = solve_ivp(lambda _, s: [s[1], -4.0 * np.sin(s[0])], (0.0, 20.0), [1.9, 0.0], t_eval=t, rtol=1e-9).y[0]
    swinging = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)})
    for seed in range(3):
        log = {"t": t, "x": x + 0.02 * x.std() * np.random.default_rng(seed).standard_normal(len(t))}
        terms = {t.text: t for t in identify(swinging, [log]).model.relations[0].terms}
        assert set(terms) == {"x_ddot", "sin(x)"}
        assert abs(terms["sin(x)"].coefficient - 4.0) < 4.0 * terms["sin(x)"].std_error


@pytest.mark.parametrize(
    ("texts", "rate", "suspected"),
    [
        (("x", "x*v**2"), "v", True),
        (("x*v**2", "x*v**4"), "v", True),
        (("x", "x*v"), "v", False),
        (("x", "x*v**2"), None, False),
        (("x", "v*x**2"), "x", False),
        (("v", "v**2"), "v", False),
    ],
)
def test_beside_even_powers_of_its_rate_a_position_may_be_a_function(texts, rate, suspected):
    products = [Product(None, parse_term(text, Scope.of(["x", "v"]))) for text in texts]
    found = _imitation(0, products, "x", (), rate)
    assert (found is not None) == suspected
    for product in products if suspected else ():
        assert imitates(product, 0, [found])


@pytest.mark.parametrize(
    ("below", "texts", "terms"),
    [
        (("x**2",), ("1", "i**2"), 0),  # i**2/x**2 - g, as under a magnet: powers
        (("x",), ("1", "i", "x"), 0),
        (("x",), ("1", "x**2"), 2),  # 1/x + x may be a function of x
        (("1", "x"), ("i",), 1),
    ],
)
def test_what_is_divided_by_one_power_goes_with_powers(below, texts, terms):
    scope = Scope.of(["x", "i"])
    products = [Product("a", parse_term(t, scope)) for t in below]
    products += [Product(None, parse_term(t, scope)) for t in texts]
    assert _imitation(0, products, "x", (), None).terms == terms


def test_what_negative_powers_divide_may_be_a_function_although_it_holds_none():
    """N - 0.25 N^2 - k P N^2/(1 + N^2), written by N^2."""
    scope = Scope.of(["N", "P", "k"])
    products = [Product("N_dot", parse_term(t, scope)) for t in ("1", "N**-2")]
    products += [Product(None, parse_term(t, scope)) for t in ("N", "1/N", "N**2", "1", "P*k")]
    found = _imitation(0, products, "N", (), None)
    assert found.squared
    assert parse_term("P*k", scope) in found.beside


def test_what_is_fixed_by_name_is_not_suspected():
    assert study().suspects == ("x", "u")
    assert study(suspect=False).suspects == ()
    assert study(terms=("x", "x**2", "x_dot")).suspects == ()
    assert study(preset="paper").suspects == ()
    assert parse_study(study_toml(study(suspect=False))) == study(suspect=False)


def ending(exact, deviance, error, block=1, width=0.001, noisy=None, terms=5, spread=0.0):
    """Return what the choice between two ends of a likelihood stage looks at; with noise of the process its cost."""
    segments = SimpleNamespace(block=block, samples=1000, driven=None)
    outcome = SimpleNamespace(deviance=deviance, width=width, sure=exact)
    made = SimpleNamespace(exact=exact, outcome=outcome, free_run_error=error, space=SimpleNamespace(segments=segments))
    made.path = SimpleNamespace(choice=SimpleNamespace(spread=spread))
    made.process = None if noisy is None else SimpleNamespace(penalised=noisy)
    made.follows, made.fit = exact or noisy is not None, SimpleNamespace(free=range(terms))
    made.gained_over = partial(Refinement.gained_over, made)
    return made


def noisy(cost, error, terms, spread=0.0):
    return ending(False, 0.0, error, noisy=cost, terms=terms, spread=spread)


def without_noise(cost, error):
    """Return such an end of five terms that is compared with one that has noise of the process, at its cost there."""
    made = ending(True, cost, error)
    made.gained_over = lambda before: before.process.penalised - cost
    return made


@pytest.mark.parametrize(
    ("before", "after", "replaced"),
    [
        (ending(True, 100.0, 0.01), ending(True, 80.0, 0.02), True),
        (ending(True, 100.0, 0.01), ending(True, 101.0, 0.005), False),
        (ending(False, 100.0, 0.01), ending(True, 80.0, 0.009), True),
        (ending(False, 100.0, 0.01), ending(True, 80.0, 0.02), False),  # many terms, and none is physics
        (ending(False, 100.0, 0.01), ending(False, 80.0, 0.001), False),
        (ending(False, 100.0, np.inf), ending(True, 80.0, 0.3), True),
        (ending(True, 100.0, 0.02), ending(True, 900.0, 0.01, block=5), True),  # densities of other averages
        (ending(True, 100.0, 0.01), ending(True, -900.0, 0.02, block=5), False),
        (ending(True, 100.0, 0.01, width=1.0), ending(True, 120.0, 0.02), True),  # which follows in one piece
        (ending(True, 100.0, 0.02), ending(True, 80.0, 0.01, width=1.0), False),
        (noisy(100.0, 0.10, 5), noisy(80.0, 0.10, 5), True),
        (noisy(100.0, 0.10, 5), noisy(95.0, 0.10, 4), False),  # which is hardly likelier
        (noisy(100.0, 0.10, 5), noisy(80.0, 0.12, 4), False),  # nor runs as near
        (noisy(100.0, 0.10, 5), noisy(80.0, 0.12, 4, 0.03), True),  # from stretch to stretch errors differ by more
        (noisy(100.0, 0.10, 5), noisy(80.0, 0.09, 6), False),  # one more function explains anything
        (noisy(100.0, 0.10, 5), noisy(80.0, 0.04, 6), True),
        (noisy(100.0, 0.004, 5), noisy(80.0, 0.006, 4), True),  # both are near enough
        (noisy(100.0, 0.004, 5), without_noise(80.0, 0.006), True),  # noise of the process stood for a law
        (noisy(100.0, 0.004, 5), without_noise(95.0, 0.006), False),
        (noisy(100.0, 0.004, 4), without_noise(80.0, 0.006), False),
        (noisy(100.0, 0.10, 5), without_noise(80.0, 0.12), False),
        (ending(True, 100.0, 0.01), noisy(-900.0, 0.001, 4), False),
    ],
)
def test_functions_replace_what_does_not_follow_the_record_only_if_they_run_freely_no_worse(before, after, replaced):
    assert replaces(after, before) is replaced


def test_what_the_time_drives_is_compared_by_its_free_runs_with_what_has_noise_of_the_process():
    forced = ending(True, 80.0, 0.05)
    forced.space.segments.driven = SimpleNamespace(holds=("linear",))
    assert forced.gained_over(noisy(100.0, 0.10, 5)) is None
    assert replaces(forced, noisy(100.0, 0.10, 5))


def swinging(t, rng):
    f, phase = rng.uniform(0.02, 0.2, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    return 0.8 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1)


@pytest.mark.slow
def test_what_is_limited_to_both_sides_is_found_with_its_limits():
    for seed in range(5):
        t = np.arange(0.0, 60.0, 0.05)
        logs = recorded(lambda x, u: u - 0.3 * x - 1.5 * np.clip(x, -0.7, 0.7), [1.0, -2.0], t, seed, swinging)
        model = identify(study(), logs).model
        (edge,) = model.parameters
        assert abs(edge.value - 0.7) < 4.0 * edge.std_error
        assert {t.text for t in model.shown_relations[0].terms} == {
            "x_dot", "x", "u", "(abs(edge_x + x) - abs(edge_x - x))**1",
        }  # fmt: skip


@pytest.mark.slow
def test_chuas_circuit_has_its_diode():
    """Chua, Komuro and Matsumoto (1986), doi:10.1109/TCS.1986.1085869: a resistance with two kinks, at +-1."""
    rate = lambda _, s: [  # noqa: E731
        9.0 * (s[1] - 0.286 * s[0] + 0.2145 * (abs(s[0] + 1.0) - abs(s[0] - 1.0))), s[0] - s[1] + s[2], -14.3 * s[1],
    ]  # fmt: skip
    t, three = np.linspace(0.0, 40.0, 2500), {name: Measured() for name in "xyz"}
    states = [
        solve_ivp(rate, (0.0, 40.0), [x, 0.0, -0.1], t_eval=t, rtol=1e-9, atol=1e-11, max_step=0.01).y
        for x in (0.1, 0.3)
    ]
    size = 0.003 * np.concatenate(states, axis=1).std(axis=1)[:, None]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        noisy = [s + size * rng.standard_normal(s.shape) for s in states]
        logs = [{"t": t, **dict(zip("xyz", s, strict=True))} for s in noisy]
        model = identify(Study(data=Data(time="t"), coordinates=three), logs).model
        (edge,) = model.parameters
        assert abs(edge.value - 1.0) < 4.0 * edge.std_error
        assert [len(r.terms) for r in model.relations] == [4, 4, 2]


@pytest.mark.slow
def test_what_holds_a_constant_of_the_library_stands_beside_no_other_function():
    """Two powers of u beside one: a function of u may stand there, but none of u and of the constant."""
    t = np.arange(0.0, 60.0, 0.05)
    logs = recorded(lambda x, u: (u + 0.8 * u**2) * np.exp(-x / 0.7) - x, [0.1, 1.0], t, 0, inflow)
    library = {"basis": ("x", "u", "exp(-x/k)"), "degree": 3, "parameters": {"k": (0.2, 3.0)}}
    model = identify(study(**library), logs).model
    (constant,) = model.parameters
    assert abs(constant.value - 0.7) < 4.0 * constant.std_error
    assert set(constant.written) == {"u*exp(-x/k)", "u**2*exp(-x/k)"}
    assert len(model.relations[0].terms) == 4


def score(target, variable, reason="powers", tried=(), found=(), terms=0):
    return SuspicionScore(target, variable, reason, terms, 0.0, 1.0, tried, found, 5.0)


def test_two_passes_say_what_the_model_in_the_end_holds():
    mechanisms = [
        SimpleNamespace(parts=(SimpleNamespace(relation=r, product=Product(None, parse_term(text, Scope.of("xy")))),))
        for r, text in enumerate(("sqrt(x)", "log(y)"))
    ]
    space = SimpleNamespace(mechanisms=mechanisms, frame=SimpleNamespace(targets=("x_dot", "y_dot")))
    kept = SimpleNamespace(space=space, fit=SimpleNamespace(present=(0, 1)))
    first = [
        score("x_dot", "x", "fractions", ("sqrt(x)", "log(x)"), ("sqrt(x)",)),
        score("y_dot", "x", "fractions", ("tanh(x)",), ("tanh(x)",)),  # which is in no relation any more
        score("y_dot", "y", "fractions", ("log(y)", "sqrt(y)"), ("sqrt(y)",), 2),
        score("y_dot", "", "pair"),
    ]
    second = [score("y_dot", "y", "powers", ("log(y)", "sqrt(y)"), ("log(y)",)), score("y_dot", "", "sine")]
    said = {(s.target, s.variable or s.reason): (s.reason, s.found) for s in _joined(first, second, kept)}
    assert said == {
        ("x_dot", "x"): ("fractions", ("sqrt(x)",)),
        ("y_dot", "x"): ("fractions", ()),
        ("y_dot", "y"): ("powers", ("log(y)",)),
        ("y_dot", "pair"): ("pair", ()),
        ("y_dot", "sine"): ("sine", ()),
    }


def eliminated(seed):
    """Return a log of a drug in blood and tissue, which is eliminated by Michaelis and Menten, at 1 % noise."""
    rng, t, hold = np.random.default_rng(seed), np.arange(0.0, 40.0, 0.05), 40
    doses, states = rng.choice([0.0, 0.0, 50.0, 100.0, 150.0], len(t) // hold), [np.zeros(2)]
    for k, dose in enumerate(doses):
        there = 0.05 * np.arange(k * hold, (k + 1) * hold + 1)
        rate = lambda _, c, dose=dose: [  # noqa: E731
            dose / 10.0 - 3.0 * c[0] / (2.0 + c[0]) - 0.5 * c[0] + 0.3 * c[1], 0.5 * c[0] - 0.3 * c[1]
        ]  # fmt: skip
        solved = solve_ivp(rate, (there[0], there[-1]), states[-1], t_eval=there[1:], rtol=1e-9, atol=1e-11)
        states.extend(solved.y.T)
    c = np.array(states)[: len(t)].T
    blood, tissue = c + NOISE * c.std(axis=1, keepdims=True) * rng.standard_normal(c.shape)
    return {"t": t, "b": blood, "c": tissue, "u": np.repeat(doses, hold)}


@pytest.mark.slow
def test_a_saturation_is_found_beside_what_goes_in_proportion():
    """It is a constant but near nothing, where a root imitates it."""
    given = Study(data=Data(time="t"), coordinates={n: Measured() for n in "bc"}, inputs={"u": Driven()})
    found = []
    for seed in range(6):
        relation = identify(given, eliminated(seed)).model.relations[0]
        rest = {t.text for t in relation.terms} - {"b_dot", "b", "c", "u"}
        found.append(len(rest) == 1 and len(relation.terms) == 5 and "+ b)**-1" in rest.pop())
    assert sum(found) >= 4
