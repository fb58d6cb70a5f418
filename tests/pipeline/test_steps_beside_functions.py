"""Laws with functions under an input that steps between samples: models under other times of its steps compare."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

TIMES = pytest.mark.xfail(
    strict=True, reason="times of steps that a fraction asked for: x/(c + x) is as good under them"
)
SEEDS = [0, pytest.param(1, marks=[pytest.mark.slow, TIMES]), pytest.param(2, marks=pytest.mark.slow)]


def recording(seed, start, rate, end, samples, period, noise):
    """Return a log of x under an input that steps every `period`, which no sample falls on."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, end, samples)
    doses = rng.uniform(0.0, 1.0, int(end / period) + 2)

    x, now, state = np.empty(samples), 0.0, start
    for k in range(int(np.ceil(end / period))):
        after = min((k + 1) * period, end)
        inside = (t >= now) & (t <= after)
        at = np.unique(np.r_[t[inside], after])
        solved = solve_ivp(lambda _, z, k=k: rate(z, doses[k]), (now, after), [state], t_eval=at, rtol=1e-10).y[0]
        x[inside], now, state = solved[: inside.sum()], after, solved[-1]
    return {"t": t, "x": x + noise * x.std() * rng.standard_normal(samples), "u": doses[(t / period).astype(int)]}


@pytest.mark.parametrize("seed", SEEDS)
def test_a_tumour_grows_by_gompertz_law_between_doses(seed):
    logs = [
        recording(10 * seed + k, start, lambda z, u: 0.09 * z * np.log(2400.0 / z) - 0.16 * u * z, 60.0, 600, 7.3, 0.01)
        for k, start in enumerate((150.0, 900.0, 400.0))
    ]
    study = Study(data=Data(time="t"), coordinates={"x": Measured()}, inputs={"u": Driven()})
    (relation,) = identify(study, logs).model.relations
    found = {t.text: t for t in relation.terms[1:]}
    assert set(found) == {"x", "u*x", "x*log(x)"}
    for text, value in {"x": -0.09 * np.log(2400.0), "u*x": 0.16, "x*log(x)": 0.09}.items():
        assert abs(found[text].coefficient - value) < 4.0 * found[text].std_error
