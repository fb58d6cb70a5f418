"""Functions of an input that stand beside a state of order 1: propellers, rectifiers, sails, electrodes, enzymes."""

import numpy as np
import pytest

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

STEP, FINER, HELD = 0.05, 4, 24
T = STEP * np.arange(2400)


def recorded(rate, seed, start, *ends, noise=0.004):
    """Return a log of x' = rate(x, *inputs), by Runge and Kutta, under inputs that are held for 1.2 s at a time."""
    rng, h = np.random.default_rng(seed), STEP / FINER
    inputs = np.array([np.repeat(rng.uniform(*e, len(T) // HELD), HELD) for e in ends])
    x, rows = np.array(start, dtype=float), []
    for u in inputs.T:
        rows.append(x)
        for _ in range(FINER):
            a = np.array(rate(x, *u))
            b = np.array(rate(x + 0.5 * h * a, *u))
            c = np.array(rate(x + 0.5 * h * b, *u))
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + np.array(rate(x + h * c, *u)))
    clean = np.array(rows).T
    noisy = clean + noise * clean.std(axis=1, keepdims=True) * rng.standard_normal(clean.shape)
    return {"t": T, **dict(zip("xy", noisy, strict=False)), **dict(zip("uw", inputs, strict=False))}


def model_of(log):
    held = Driven(hold="zero", delay=0.0)
    states, inputs = ({n: kind for n in names if n in log} for names, kind in (("xy", Measured()), ("uw", held)))
    return identify(Study(data=Data(time="t"), coordinates=states, inputs=inputs), log).model


def boat(x, u):
    return [0.021 * u * abs(u) - 0.014 * abs(u) * x[0] - 0.052 * x[0] * abs(x[0])]


def rectifier(x, u):
    return [6.3 * max(u - x[0], 0.0) - 0.7 * x[0]]


def sail(x, u):
    return [0.034 * (u - x[0]) * abs(u - x[0]) - 0.11 * x[0]]


LAWS = {
    "boat": (boat, (-12.0, 18.0), {"u*abs(u)": 0.021, "x*abs(u)": -0.014, "x*abs(x)": -0.052}),
    "rectifier": (rectifier, (-2.0, 3.0), {"x": -3.85, "u": 3.15, "abs(u - x)": 3.15}),
    "sail": (sail, (-8.0, 12.0), {"x": -0.11, "(u - x)**1*abs(u - x)": 0.034}),
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 4))])
def test_functions_of_an_input_and_a_speed_are_found(name, seed):
    rate, ends, law = LAWS[name]
    (relation,) = model_of(recorded(rate, seed, [0.4], ends)).relations
    found = {t.text.replace("-x + u", "u - x"): t for t in relation.terms[1:]}
    assert set(found) == set(law)
    for text, value in law.items():
        assert abs(-found[text].coefficient - value) < 4.0 * found[text].std_error


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 4))])
def test_an_electrode_has_an_exponential_each_way(seed):
    """Butler and Volmer's law: the two have scales of their own, and their constants cancel at rest."""

    def rate(x, u):
        return [1.2 * u - 0.25 * (np.exp(x[0] / 0.31) - np.exp(-x[0] / 0.47))]

    model = model_of(recorded(rate, seed, [0.0], (-1.4, 1.6)))
    assert {t.product.expanded.text for t in model.relations[0].terms[1:]} == {
        "u", "exp(rise_x**-1*x)", "exp(-fall_x**-1*x)"
    }  # fmt: skip
    for constant, value in zip(sorted(model.parameters, key=lambda p: p.value), (0.31, 0.47), strict=True):
        assert abs(constant.value - value) < 4.0 * constant.std_error


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 4))])
def test_a_rate_that_a_competitor_limits_is_found(seed):
    def rate(x, u, w):
        return [u - 2.3 * x[0] / (0.83 + 1.46 * x[1] + x[0]) - 0.09 * x[0], w - 0.71 * x[1]]

    model = model_of(recorded(rate, seed, [0.5, 0.4], (0.1, 1.6), (0.1, 1.4)))
    found = {p.name: p for p in model.parameters}
    for name, value in {"below_x": 1.0 / 0.83, "below_y": 1.46 / 0.83}.items():
        assert abs(found[name].value - value) < 4.0 * found[name].std_error
    assert [len(r.terms) for r in model.relations] == [4, 3]
