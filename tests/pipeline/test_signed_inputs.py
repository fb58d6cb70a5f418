"""What is of order 1 under an input with both signs: a boat's propeller, a rectifier, a sail, an electrode."""

import numpy as np
import pytest

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

STEP, FINER, HELD = 0.05, 4, 24
T = STEP * np.arange(2400)


def recorded(rate, seed, start, least, most):
    """Return a log of x' = rate(x, u), by Runge and Kutta, under an input that is held for 1.2 s at a time."""
    rng, h = np.random.default_rng(seed), STEP / FINER
    u = np.repeat(rng.uniform(least, most, len(T) // HELD), HELD)
    x, clean = start, []
    for now in u:
        clean.append(x)
        for _ in range(FINER):
            a = rate(x, now)
            b = rate(x + 0.5 * h * a, now)
            c = rate(x + 0.5 * h * b, now)
            x += h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(x + h * c, now))
    return {"t": T, "x": clean + 0.004 * np.std(clean) * rng.standard_normal(len(T)), "u": u}


def model_of(log):
    held = Driven(hold="zero", delay=0.0)
    return identify(Study(data=Data(time="t"), coordinates={"x": Measured()}, inputs={"u": held}), log).model


def boat(x, u):
    return 0.021 * u * abs(u) - 0.014 * abs(u) * x - 0.052 * x * abs(x)


def rectifier(x, u):
    return 6.3 * max(u - x, 0.0) - 0.7 * x


def sail(x, u):
    return 0.034 * (u - x) * abs(u - x) - 0.11 * x


LAWS = {
    "boat": (boat, (-12.0, 18.0), {"u*abs(u)": 0.021, "x*abs(u)": -0.014, "x*abs(x)": -0.052}),
    "rectifier": (rectifier, (-2.0, 3.0), {"x": -3.85, "u": 3.15, "abs(u - x)": 3.15}),
    "sail": (sail, (-8.0, 12.0), {"x": -0.11, "(u - x)**1*abs(u - x)": 0.034}),
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 4))])
def test_functions_of_an_input_and_a_speed_are_found(name, seed):
    rate, ends, law = LAWS[name]
    (relation,) = model_of(recorded(rate, seed, 0.4, *ends)).relations
    found = {t.text.replace("-x + u", "u - x"): t for t in relation.terms[1:]}
    assert set(found) == set(law)
    for text, value in law.items():
        assert abs(-found[text].coefficient - value) < 4.0 * found[text].std_error


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 4))])
def test_an_electrode_has_an_exponential_each_way(seed):
    """Butler and Volmer's law: the two have scales of their own, and their constants cancel at rest."""

    def rate(x, u):
        return 1.2 * u - 0.25 * (np.exp(x / 0.31) - np.exp(-x / 0.47))

    model = model_of(recorded(rate, seed, 0.0, -1.4, 1.6))
    written = {text for p in model.parameters for text in p.written}
    assert written == {"exp(x/rise_x)", "exp(-x/fall_x)"}
    assert len(model.relations[0].terms) == 4
    for constant, value in zip(sorted(model.parameters, key=lambda p: p.value), (0.31, 0.47), strict=True):
        assert abs(constant.value - value) < 4.0 * constant.std_error
