"""What falls with a power of a distance or a volume that nobody named, by default settings."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import Data, Driven, Measured, Study, identify

STEP, SAMPLES = 0.01, 3000


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_piston_rests_on_gas_that_is_pressed_together(seed):
    rng = np.random.default_rng(seed)
    power, t = rng.uniform(1.1, 1.7), STEP * np.arange(SAMPLES)
    tones, turns = rng.uniform(1.0, 14.0, 5), rng.uniform(0.0, 2.0 * np.pi, 5)

    def push(t):
        return sum(np.sin(w * t + p) for w, p in zip(tones, turns, strict=True))

    def piston(t, s):
        return [s[1], 40.0 * ((0.5 / s[0]) ** power - 1.0) - 1.2 * s[1] + 2.0 * push(t)]

    x = solve_ivp(piston, (0.0, t[-1]), [0.5, 0.0], t_eval=t, rtol=1e-9, atol=1e-11).y[0]
    log = {"t": t, "x": x + 0.005 * x.std() * rng.standard_normal(SAMPLES), "u": push(t)}
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    model = identify(study, log).model
    (relation,), (found,) = model.relations, model.parameters
    assert abs(found.value - power) < 4.0 * found.std_error
    assert len([term for term in relation.terms if term.factor is None]) == 4
