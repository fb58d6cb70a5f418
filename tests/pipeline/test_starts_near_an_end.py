"""States that stay at an end from which they run away when it turns, by default settings."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import Data, Driven, Measured, Study, identify

STEP, SAMPLES = 0.01, 2500


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_a_memristor_that_has_filled_has_its_law(seed):
    rng = np.random.default_rng(seed)
    t, turn = STEP * np.arange(SAMPLES), rng.uniform(-0.6, 0.0, 3)
    window = rng.uniform(1.3, 1.5)

    def volts(t):
        slow, fast, faster = (np.sin(w * t + p) for w, p in zip((0.85, 5.8, 7.6), turn, strict=True))
        return 0.75 * slow + 0.4 * fast + 0.35 * faster

    def filling(t, w):
        return 2.0 * volts(t) * w * (1.0 - w) / (1.6 - window * w)

    # For seconds on end it is full but for less than a millionth.
    w = solve_ivp(filling, (0.0, t[-1]), [0.4], t_eval=t, rtol=1e-9, atol=1e-12).y[0]
    log = {"t": t, "w": w + 0.004 * rng.standard_normal(SAMPLES), "v": volts(t)}
    study = Study(data=Data(time="t"), coordinates={"w": Measured()}, inputs={"v": Driven()})
    (relation,) = identify(study, log).model.relations
    terms = {term.text: term for term in relation.terms if term.text != "w_dot"}
    assert set(terms) == {"w_dot*w", "v*w", "v*w**2"}
    for text, value in (("w_dot*w", -window / 1.6), ("v*w", -1.25), ("v*w**2", 1.25)):
        assert abs(terms[text].coefficient - value) < 4.0 * terms[text].std_error
