"""What hangs from a drive that takes no notice of it: no energy of the whole tells how heavy it is."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

T = 0.05 * np.arange(1600)


def trolley(seed):
    """A load on a rope under a trolley whose speed a drive controls: noise of 1 % of the standard deviations."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.05, 0.8, 8), rng.uniform(0.0, 2.0 * np.pi, 8)

    def u(t):
        return np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=-1)

    def rate(t, z):
        _, q, v, w = z
        a = 3.0 * u(t) - 2.0 * v
        return [v, w, a, -8.0 * np.sin(q) - 0.8 * np.cos(q) * a - 0.3 * w]

    x = solve_ivp(rate, (0.0, T[-1]), [0.0, 0.2, 0.0, 0.0], t_eval=T, rtol=1e-9, atol=1e-10).y[:2]
    x += 0.01 * x.std(axis=1, keepdims=True) * rng.standard_normal(x.shape)
    coordinates = {"x": Measured(order=2, cyclic=True), "q": Measured(order=2, angle=True)}
    return Study(data=Data(time="t"), coordinates=coordinates, inputs={"u": Driven()}), {
        "t": T,
        "x": x[0],
        "q": x[1],
        "u": u(T),
    }


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_load_that_gives_nothing_back_follows_its_trolley(seed):
    result = identify(*trolley(seed))
    cart, load = result.model.relations
    truth = {"x_ddot": 1.0, "x_dot": 2.0, "u": -3.0}
    assert {t.product.text: t.coefficient for t in cart.terms} == pytest.approx(truth, rel=0.02)
    truth = {"q_ddot": 1.0, "sin(q)": 8.0, "x_ddot*cos(q)": 0.8, "q_dot": 0.3}
    assert {t.product.text: t.coefficient for t in load.terms} == pytest.approx(truth, rel=0.02)
