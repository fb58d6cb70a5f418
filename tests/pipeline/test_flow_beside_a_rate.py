"""A flow that carries an amount away beside a rate of that amount, which powers of it imitate."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

T = np.arange(0.0, 400.0, 0.5)


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 5))])
def test_a_saturation_is_found_beside_a_flow_times_its_amount(seed):
    rng = np.random.default_rng(seed)
    flow, feed = (rng.uniform(*span, 20).repeat(40) for span in ((0.02, 0.2), (0.1, 0.9)))
    half, rate = rng.uniform(0.3, 0.7), rng.uniform(0.03, 0.06)

    x = [0.3]
    for k in range(len(T) - 1):  # inputs keep their values from one sample to the next

        def balance(_, y, k=k):
            return flow[k] * (feed[k] - y) - rate * y / (half + y)

        x.append(float(solve_ivp(balance, (0.0, 0.5), x[-1:], rtol=1e-9, atol=1e-12).y[0, -1]))
    measured = np.array(x) + 0.005 * np.std(x) * rng.standard_normal(len(T))
    log = {"t": T, "x": measured, "flow": flow, "feed": feed}
    inputs = {name: Driven(hold="zero") for name in ("flow", "feed")}
    model = identify(Study(data=Data(time="t"), coordinates={"x": Measured(order=1)}, inputs=inputs), log).model
    law = {t.text: -t.coefficient for t in model.relations[0].terms[1:]}
    (constant,) = model.parameters
    saturated = next(text for text in law if "**-1" in text)
    assert law == pytest.approx({"feed*flow": 1.0, "flow*x": -1.0, saturated: -rate}, rel=0.05)
    assert constant.name == "half_x"
    assert abs(constant.value - half) < 4.0 * constant.std_error
