"""Constants within functions, from the study to the model."""

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import InputError, simulate
from odescope.export.languages.text import to_text
from odescope.export.model_file import from_json, to_json
from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study
from odescope.study.toml import parse_study, study_toml

PERIOD, COUNT, NOISE = 0.01, 2000, 0.002
TRUTH = {"x": -4.0, "x_dot": -0.3, "u": 1.0, "tanh(x_dot/v0)": -0.8}
WIDTH = 0.15


def logged(seed, width=WIDTH, noise=NOISE, count=COUNT):
    """Return a log of x'' = u - 4 x - 0.3 x' - 0.8 tanh(x'/width)."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(count)
    f, phase = rng.uniform(0.1, 1.2, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    u = 1.2 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1)

    def rate(now, x):
        return x[1], np.interp(now, t, u) - 4.0 * x[0] - 0.3 * x[1] - 0.8 * np.tanh(x[1] / width)

    x = solve_ivp(rate, (0.0, t[-1]), (0.5, 0.0), t_eval=t, rtol=1e-8, atol=1e-10, max_step=2 * PERIOD).y[0]
    return {"t": t, "x": x + noise * rng.standard_normal(count), "u": u}


def study(parameters, basis=("x", "x_dot", "u", "tanh(x_dot/v0)"), degree=2):
    return Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2)},
        inputs={"u": Driven()},
        library=Candidates(basis=basis, degree=degree, parameters=parameters),
    )


@pytest.fixture(scope="module")
def log():
    return logged(0)


@pytest.fixture(scope="module")
def found(log):
    return identify(study({"v0": (0.01, 1.0)}), log)


@pytest.mark.parametrize(
    ("true", "count", "noise"), [(0.002, COUNT, 1e-4), (0.004, COUNT, 1e-4), (0.01, COUNT, 1e-4), (0.002, 600, 2e-5)]
)
def test_the_width_of_dry_friction_is_the_true_one_however_often_it_was_halved_on_the_way(true, count, noise):
    library = Candidates(terms=("u", "x", "x_dot", "sign(x_dot)"))
    model = identify(msgspec.structs.replace(study({}), library=library), logged(0, true, noise, count)).model
    (width,) = model.parameters
    assert abs(width.value - true) < 4.0 * width.std_error < 0.04 * true
    assert len(model.relations[0].terms) == 5


def test_the_law_is_found_with_its_constant_and_errors_that_hold(found):
    model = found.model
    (width,) = model.parameters
    terms = {
        dict(zip(width.terms, width.written, strict=True)).get(t.text, t.text): t for t in model.relations[0].terms
    }
    assert set(terms) == {"x_ddot", *TRUTH}
    for name, value in TRUTH.items():
        assert abs(terms[name].coefficient + value) < 4.0 * terms[name].std_error
    assert width.name == "v0"
    assert abs(width.value - WIDTH) < 4.0 * width.std_error
    assert width.std_error < 0.02 * WIDTH


@pytest.mark.slow
def test_from_a_range_that_the_data_give_it_is_the_same(found, log):
    scaled = identify(study({"v0": "scale"}), log).model.parameters[0]
    own = found.model.parameters[0]
    assert scaled.value == pytest.approx(own.value, abs=0.1 * own.std_error)
    assert scaled.std_error == pytest.approx(own.std_error, rel=0.05)


def test_people_read_the_name_and_files_hold_numbers(found):
    model = found.model
    text = to_text(model, digits=3)
    value = model.parameters[0].value
    assert "tanh(x_dot/v0)" in text
    assert f"v0 = {value:.4f}"[:10] in text
    assert all("v0" not in t.term.text for t in model.relations[0].terms)
    again = from_json(to_json(model))
    assert again.equations == model.equations
    assert to_text(again) == to_text(model)
    assert "±" in model._repr_html_()
    assert "v0" in model._repr_latex_() or "v_{0}" in model._repr_latex_()


def test_the_model_runs_with_its_constant(found, log):
    model = found.model
    run = simulate(model, log["t"], log["u"][:, None], np.array([0.5, 0.0]))
    assert np.sqrt(np.mean((run.states[:, 0] - log["x"][: len(run.t)]) ** 2)) < 1.5 * NOISE


def test_a_constant_that_the_range_keeps_from_its_best_value_ends_at_the_range(log):
    model = identify(study({"v0": (0.3, 3.0)}), log).model
    (width,) = model.parameters
    assert width.value == pytest.approx(0.3, rel=1e-3)


@pytest.mark.parametrize(
    ("parameters", "basis", "said"),
    [
        (
            {"v0": (0.1, 1.0), "w": (1.0, 2.0)},
            ("x", "x_dot", "tanh(x_dot/v0)"),
            "no candidate term holds the constant w",
        ),
        ({"v0": (0.1, 1.0)}, ("x", "v0*x_dot"), "the constant v0 is a factor"),
        (
            {"a": (0.1, 1.0), "b": (0.1, 1.0), "c": (0.1, 1.0)},
            ("x", "tanh(a*x + b*x_dot + c*u)"),
            "holds 3 constants, a, b, c",
        ),
        ({"v0": (-1.0, 1.0)}, ("x", "tanh(x_dot/v0)"), r"divides by the constant v0, .* -1 to 1, holds zero"),
        ({"K": (-3.0, -0.1)}, ("x_dot", "x", "log(x - K)"), "has no value on the data at K = "),
    ],
)
def test_a_constant_that_cannot_be_looked_for_is_refused(log, parameters, basis, said):
    with pytest.raises(InputError, match=said):
        identify(study(parameters, basis), log | {"x": log["x"] - 5.0} if "K" in parameters else log)


@pytest.mark.parametrize("span", ["[1.0, 0.1]", "[0.5, 0.5]", "[0.1, inf]", '"wide"', "3.0"])
def test_a_range_that_is_none_is_refused(span):
    text = f'[coordinates.x]\norder = 2\n[library]\nbasis = ["x"]\n[library.parameters]\nv0 = {span}\n'
    with pytest.raises(InputError, match=r"v0|parameters"):
        parse_study(text)


def test_a_constant_is_no_state_and_a_study_reads_back():
    plain = study({"v0": (0.01, 1.0), "n": "scale"}, ("x", "tanh(x_dot/v0)", "abs(x)**n"))
    assert parse_study(study_toml(plain)) == plain
    with pytest.raises(InputError, match="'x' is taken"):
        study({"x": (0.1, 1.0)}).scope()
