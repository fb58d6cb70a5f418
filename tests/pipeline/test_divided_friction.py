"""Dry friction beside what a rope's stiffness divides: the whole law times the length that hangs."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

T, LENGTH = 0.01 * np.arange(3000), 3.0
STUDY = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})


def hung(seed):
    """Return a log of x'' = u - 20 x/(3 - x) - .8 sign(x') - .3 x', positions with noise of .1 %."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.1, 1.0, 10), rng.uniform(0.0, 2.0 * np.pi, 10)

    def force(t):
        return 4.0 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=-1)

    def rate(t, z):
        return [z[1], force(t) - 20.0 * z[0] / (LENGTH - z[0]) - 0.8 * np.tanh(z[1] / 0.002) - 0.3 * z[1]]

    x = solve_ivp(rate, (0.0, T[-1]), [0.0, 0.0], t_eval=T, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]
    return {"t": T, "x": x + 1e-3 * x.std() * rng.standard_normal(len(T)), "u": force(T)}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_friction_is_found_beside_what_is_divided(seed):
    relation = identify(STUDY, hung(seed)).model.relations[0]
    found = {t.product.text: t.coefficient for t in relation.terms}
    assert set(found) == {"x_ddot", "x_ddot*x", "u", "u*x", "x", "x_dot", "x*x_dot", "sign(x_dot)", "x*sign(x_dot)"}
    size = found["x_ddot"]
    expected = {"x_ddot*x": -1 / 3, "u": -1.0, "x": 20 / 3, "sign(x_dot)": 0.8, "x*sign(x_dot)": -0.8 / 3}
    assert {k: found[k] / size for k in expected} == pytest.approx(expected, rel=0.03)
