"""Rates that go with what there is of one amount for each unit of another, by default settings."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import Data, Driven, Measured, Study, identify

pytestmark = pytest.mark.slow

STEP, SAMPLES = 0.1, 1200


def chemostat(s, u):
    growth = 0.4 * s[0] * s[1] / (0.8 * s[0] + s[1])
    return [growth - u[0] * s[0], u[0] * (u[1] - s[1]) - 2.0 * growth]


def predators(s, u):
    eaten = 0.9 * s[0] * s[1] / (2.0 * s[0] + s[1])
    return [0.6 * eaten - u[0] * s[0], s[1] * (u[1] - 0.3 * s[1]) - eaten]


# Inputs lie between the two pairs of numbers; the last is what divides.
RATES = [(chemostat, (0.05, 2.0), (0.3, 5.0), 0.8), (predators, (0.1, 0.4), (0.6, 1.6), 2.0)]


@pytest.mark.parametrize(("rate", "low", "high", "true"), RATES, ids=["chemostat", "predators"])
@pytest.mark.parametrize("seed", range(3))
def test_a_rate_by_a_ratio_is_found(rate, low, high, true, seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(low, high, (SAMPLES // 60, 2)), 60, axis=0)
    states = [np.array([1.0, 1.5])]
    for now in u[:-1]:
        run = solve_ivp(lambda _, s, now=now: rate(s, now), (0.0, STEP), states[-1], rtol=1e-9, atol=1e-11)
        states.append(run.y[:, -1])
    read = np.array(states)
    read = read + 0.005 * read.std(axis=0) * rng.standard_normal(read.shape)
    log = {"t": STEP * np.arange(SAMPLES), "x": read[:, 0], "s": read[:, 1], "u": u[:, 0], "v": u[:, 1]}
    inputs = {"u": Driven(hold="zero"), "v": Driven(hold="zero")}
    study = Study(data=Data(time="t"), coordinates={"x": Measured(), "s": Measured()}, inputs=inputs)
    model = identify(study, log).model
    (ratio,) = (p for p in model.parameters if p.name.startswith("ratio_"))
    either = (ratio.value - true) / ratio.std_error, (ratio.value - 1.0 / true) / ratio.std_error
    assert min(map(abs, either)) < 4.0
    assert [len([t for t in r.terms if t.factor is None]) for r in model.relations] == [2, 3]
