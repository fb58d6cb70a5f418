"""Functions of two states together, from the record to the model and its notes."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Measured, Study

pytestmark = pytest.mark.slow

T = np.linspace(0.0, 12.0, 200)


def found(rate, start, noise):
    solved = solve_ivp(lambda _, s: rate(*s), (0.0, 12.0), start, t_eval=T, rtol=1e-10, atol=1e-12).y
    values = solved + noise * solved.std(axis=1)[:, None] * np.random.default_rng(0).standard_normal(solved.shape)
    names = "xyz"[: len(start)]
    study = Study(data=Data(time="t"), coordinates={n: Measured() for n in names})
    return identify(study, {"t": T, **dict(zip(names, values, strict=True))})


def terms(result, relation):
    return {t.product.text for t in result.model.relations[relation].terms if t.product.factor is None}


@pytest.fixture(scope="module")
def coupled():
    return found(
        lambda x, y: [-1.3 * np.sin(x) + 0.5 * np.sin(x - y), -0.9 * np.sin(y) - 0.5 * np.sin(x - y)], [2.0, -0.8], 1e-4
    )


def test_a_coupling_by_the_difference_of_two_angles_is_found(coupled):
    assert terms(coupled, 0) == {"sin(x)", "sin(x - y)"}
    assert terms(coupled, 1) == {"sin(y)", "sin(x - y)"}


def test_what_was_found_is_said(coupled):
    said = [s for s in coupled.model.scores.suspicions if s.reason == "pair"]
    assert {s.target: s.found for s in said if s.found} == dict.fromkeys(("x_dot", "y_dot"), ("sin(x - y)",))
    assert any("has sin(x - y), found among functions of two variables together" in note for note in coupled.notes)


def test_products_of_two_states_stay_products():
    result = found(lambda x, y: [1.5 * x - x * y, -3.0 * y + x * y], [4.0, 2.0], 0.01)
    assert terms(result, 0) == {"x", "x*y"}
    assert terms(result, 1) == {"y", "x*y"}
