"""Growth that falls off again by a function: what is multiplied by its own variable."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

STUDY = Study(data=Data(time="t"), coordinates={"X": Measured()}, inputs={"I": Driven(), "D": Driven()})


def algae(seed):
    """Return a log of Steele's X' = 0.0174 I exp(-I/250) X - D X - 0.1 X, under clouds, over 24 days."""
    rng, t = np.random.default_rng(seed), 0.02 * np.arange(1200)
    clouds = np.interp(t, np.arange(0.0, 24.5, 0.1), rng.uniform(0.4, 1.0, 245))
    light = 700.0 * np.maximum(0.0, np.sin(2.0 * np.pi * (t - 0.25))) * clouds
    fed = np.repeat(rng.uniform(0.05, 0.6, 48), 25)

    def rate(now, X):
        here = np.interp(now, t, light)
        return X * (0.0174 * here * np.exp(-here / 250.0) - fed[min(int(now / 0.02 + 1e-9), len(t) - 1)] - 0.1)

    X = solve_ivp(rate, (0.0, t[-1]), [0.5], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]
    return {"t": t, "X": X * (1.0 + 0.015 * rng.standard_normal(len(t))), "I": light, "D": fed}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_too_much_light_has_its_exponential(seed):
    model = identify(STUDY, algae(seed)).model
    (relation,), (rise,) = model.relations, model.parameters
    assert len(relation.terms) == 4
    assert {"X_dot", "X", "D*X"} <= {t.text for t in relation.terms}
    assert abs(rise.value - 250.0) < 4.0 * rise.std_error
