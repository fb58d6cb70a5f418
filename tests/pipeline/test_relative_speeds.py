"""Friction relative to an input: a block on a belt, a tethered balloon in the wind."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

T = np.arange(0.0, 40.0, 0.02)


def waves(rng, mean, size, highest):
    """Return a sum of sines of time."""
    rates, phases = rng.uniform(0.2, highest, 6), rng.uniform(0.0, 6.3, 6)
    return lambda t: mean + size * np.sin(np.multiply.outer(t, rates) + phases).sum(axis=-1) / 2.0


LAWS = {
    "belt": (lambda x, v, u: -43.0 * x - 0.6 * v + 2.9 * np.tanh((u - v) / 0.12), (0.1, 0.3, 3.0), {"x": -43.0}),
    "wind": (lambda x, v, u: -0.6 * x + 0.056 * (u - v) * abs(u - v), (1.0, 4.0, 1.0), {"x": -0.6}),
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 4))])
def test_friction_goes_with_the_speed_relative_to_an_input(name, seed):
    law, (mean, size, highest), plain = LAWS[name]
    rng = np.random.default_rng(seed)
    source = waves(rng, mean, size, highest)
    rate, span, how = (lambda t, y: [y[1], law(*y, source(t))]), (0.0, T[-1]), {"rtol": 1e-8, "atol": 1e-10}
    x = solve_ivp(rate, span, [0.1, 0.0], t_eval=T, max_step=0.02, **how).y[0]
    log = {"t": T, "x": x + 0.005 * x.std() * rng.standard_normal(len(T)), "u": source(T)}
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    model = identify(study, log).model
    found = {t.text: -t.coefficient for t in model.relations[0].terms[1:]}
    relative = {text: c for text, c in found.items() if "u" in text}
    assert len(relative) == 1
    assert {text: c for text, c in found.items() if text not in relative and text != "x_dot"} == pytest.approx(
        plain, rel=0.02
    )
    assert ("x_dot" in found) == (name == "belt")
    (text,) = relative
    if name == "belt":
        assert "tanh" in text
        assert relative[text] == pytest.approx(2.9, rel=0.02)
        assert model.parameters[0].value == pytest.approx(0.12, rel=0.05)
    else:
        assert text == "(u - x_dot)**1*abs(u - x_dot)"
        assert relative[text] == pytest.approx(0.056, rel=0.02)
