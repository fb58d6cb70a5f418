"""States that nobody called angles: products of their sines and cosines, where the data ask for these."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.errors import NoModelError
from odescope.pipeline.angular import with_angles
from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Measured, Study

T = np.linspace(0.0, 10.0, 400)


def logged(rate, start, noise, seed=0):
    solved = solve_ivp(lambda _, s: rate(s), (0.0, 10.0), start, t_eval=T, rtol=1e-10, atol=1e-12).y.T
    size = noise * solved.std(axis=0)
    values = solved + size * np.random.default_rng(seed).standard_normal(solved.shape)
    return {"t": T, **dict(zip("xy", values.T, strict=False))}


def study(*names, **library):
    return Study(data=Data(time="t"), coordinates={n: Measured() for n in names}, library=Candidates(**library))


def terms(result, relation):
    return {t.product.text for t in result.model.relations[relation].terms if t.product.factor is None}


@pytest.fixture(scope="module")
def oscillators():
    return logged(
        lambda s: [1.432 + np.sin(s[1]) * np.cos(s[0]), 0.972 + np.sin(s[1]) * np.cos(s[0])], [2.2, 0.67], 0.003
    )


@pytest.mark.slow
def test_a_product_of_sine_and_cosine_of_two_states_is_found(oscillators):
    result = identify(study("x", "y"), oscillators)
    for relation in (0, 1):
        assert terms(result, relation) == {"1", "cos(x)*sin(y)"}
    found = [s for s in result.model.scores.suspicions if s.reason == "angle"]
    assert {(s.target, s.variable) for s in found} == {(t, v) for t in ("x_dot", "y_dot") for v in "xy"}
    assert any("may be an angle" in note for note in result.notes)


@pytest.mark.slow
def test_where_suspicion_is_off_no_state_is_an_angle_and_there_is_no_model(oscillators):
    with pytest.raises(NoModelError):
        identify(study("x", "y", suspect=False), oscillators)


@pytest.mark.parametrize(
    ("rate", "start"),
    [
        pytest.param(lambda s: [s[1], -s[0] + 0.9 * s[1] - 0.9 * s[0] ** 2 * s[1]], [2.2, 0.0], marks=pytest.mark.slow),
        (lambda s: [s[1], s[0] - s[0] ** 3 - 0.18 * s[1]], [-1.8, -1.8]),
        (lambda s: [1.5 * s[0] - s[0] * s[1], -3.0 * s[1] + s[0] * s[1]], [4.0, 2.0]),
    ],
)
def test_polynomials_of_what_may_be_an_angle_stay(rate, start):
    result = identify(study("x", "y"), logged(rate, start, 0.01))
    assert not any(f in t for r in (0, 1) for t in terms(result, r) for f in ("sin", "cos"))


@pytest.mark.parametrize("noise", [0.0, pytest.param(1e-3, marks=pytest.mark.slow)])
def test_a_bead_on_a_hoop_has_a_product_of_sine_and_cosine_and_no_rate_of_its_own(noise):
    log = logged(lambda s: [0.95 * np.cos(s[0]) * np.sin(s[0]) - 0.1 * np.sin(s[0])], [3.1], noise)
    result = identify(study("x"), log)
    assert terms(result, 0) == {"cos(x)*sin(x)", "sin(x)"}
    assert result.model.parameters == ()


def test_who_calls_one_state_an_angle_has_said_of_the_others_that_they_are_none(monkeypatch):
    signals = SimpleNamespace(
        inputs=(),
        states=("x", "q", "x_dot", "q_dot"),
        joined=lambda: np.linspace(1.0, 6.0, 400)[None],
        row=lambda _: 0,
    )
    filtered = SimpleNamespace(signals=signals, inputs=(), sample=SimpleNamespace(complete=True))
    asked = []
    monkeypatch.setattr("odescope.pipeline.angular.with_basis", lambda work, *_: work)
    monkeypatch.setattr("odescope.pipeline.angular.regressed_with", lambda *of: asked.append(of))
    for angle in (True, False):
        own = {"x": Measured(order=2), "q": Measured(order=2, angle=angle)}
        signals.coordinates = Study(data=Data(time="t"), coordinates=own).measured()
        work = SimpleNamespace(study=Study(data=Data(time="t"), coordinates=own))
        assert with_angles(work, filtered, None, None, True) == (None, ())
        assert len(asked) == (0 if angle else 1)
