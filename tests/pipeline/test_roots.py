"""Tanks that are wider at the top: quotients that hold a root, by default settings."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

OUT, STAY, EVERY = 0.5, 10.0, 0.1


def tank(section, seed):
    """A log of a level under an inflow in steps, with .5 % of noise."""
    rng, steps = np.random.default_rng(seed), 16
    inflow = rng.uniform(0.2, 1.1, steps)
    level, parts = rng.uniform(1.0, 2.0, 1), []
    for q in inflow:
        run = solve_ivp(
            lambda _, h, q=q: (q - OUT * np.sqrt(h)) / section(h), (0.0, STAY), level,
            t_eval=np.arange(round(STAY / EVERY)) * EVERY, rtol=1e-9, atol=1e-11, dense_output=True,
        )  # fmt: skip
        parts.append(run.y[0])
        level = run.sol(STAY)
    h = np.concatenate(parts)
    h += 0.005 * h.std() * rng.standard_normal(len(h))
    return {"t": np.arange(len(h)) * EVERY, "h": h, "q": np.repeat(inflow, round(STAY / EVERY))}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("section", "wide"),
    [
        pytest.param(lambda h: 0.6 * h**2, {"h_dot*h**2": 0.6}, id="cone"),
        pytest.param(lambda h: 1.8 * h - 0.4 * h**2, {"h_dot*h": 1.8, "h_dot*h**2": -0.4}, id="sphere"),
    ],
)
def test_the_level_of_a_tank_that_is_wider_at_the_top_has_its_law(section, wide):
    study = Study(data=Data(time="t"), coordinates={"h": Measured()}, inputs={"q": Driven()})
    result = identify(study, [tank(section, seed) for seed in (0, 1)])
    (relation,) = result.model.relations
    found = {t.text.replace("h**exponent_h", "sqrt(h)"): t.coefficient for t in relation.terms}
    assert found.keys() == {*wide, "q", "sqrt(h)"}
    for text, size in (wide | {"sqrt(h)": OUT}).items():
        assert -found[text] / found["q"] == pytest.approx(size, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_cone_that_is_all_but_emptied_has_its_law(seed):
    """Five powers of 1/h may follow it as well."""
    log = tank(lambda h: 0.6 * h**2, seed)
    assert log["h"].min() < 0.35 * log["h"].max()
    study = Study(data=Data(time="t"), coordinates={"h": Measured()}, inputs={"q": Driven()})
    (relation,) = identify(study, log).model.relations
    assert {t.text for t in relation.terms} == {"h_dot*h**2", "q", "sqrt(h)"}
