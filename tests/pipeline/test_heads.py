"""Roots of what a level or a pressure is above or below something that was not recorded: the height of an outlet."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

NOISE = 0.005
T = np.arange(0.0, 100.0, 0.125)
HELD = 64  # samples that an input keeps its value


def recorded(rate, starts, seed, least=0.4, most=1.1):
    """Return logs of x' = rate(x, u), where u keeps each value for 8 s, at half a per cent of noise."""
    rng, logs = np.random.default_rng(seed), []
    for start in starts:
        u = np.repeat(rng.uniform(least, most, len(T) // HELD + 1), HELD)[: len(T)]
        x = [np.array(start)]
        for k in range(0, len(T) - 1, HELD):
            t = T[k : k + HELD + 1]
            solved = solve_ivp(lambda _, x, now=u[k]: rate(x, now), (t[0], t[-1]), x[-1], t_eval=t[1:], rtol=1e-9)
            x.extend(solved.y.T)
        x = np.array(x) + NOISE * np.std(x, axis=0) * rng.standard_normal((len(T), len(start)))
        logs.append({"t": T, "u": u, **dict(zip("xy", x.T, strict=False))})
    return logs


def found(logs):
    """Return the terms of every relation that is found by default, and the constants within them."""
    names = [name for name in "xy" if name in logs[0]]
    study = Study(
        data=Data(time="t"), coordinates={name: Measured() for name in names}, inputs={"u": Driven(hold="zero")}
    )
    model = identify(study, logs).model
    return [{t.text for t in r.terms} for r in model.shown_relations], {p.name: p for p in model.parameters}


def tank(x, u):
    return [0.5 * u - 0.4 * np.sqrt(x[0] + 0.3)]


def held(constants, truth):
    """Say whether constants are those, within four standard errors."""
    return constants.keys() == truth.keys() and all(
        abs(constants[name].value - value) < 4.0 * constants[name].std_error for name, value in truth.items()
    )


@pytest.mark.parametrize("seeds", [1, pytest.param(8, marks=pytest.mark.slow)])
def test_a_tank_whose_outlet_is_below_its_level_zero(seeds):
    results = [found(recorded(tank, [[1.0], [0.3]], seed)) for seed in range(seeds)]
    right = sum(terms == [{"x_dot", "u", "sqrt(head_x + x)"}] and held(c, {"head_x": 0.3}) for terms, c in results)
    assert right >= 0.9 * seeds


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_tanks_that_run_empty(seed):
    """A root of the level's size alone drains an empty tank below its bottom: the law lost to four other terms."""

    def cascade(x, u):
        over, under = np.sqrt(np.maximum(x, 0.0))
        return [max(u, 0.0) - 0.5 * over, 0.5 * over - 0.4 * under]

    (log,) = recorded(cascade, [[1.0, 1.0]], seed, least=-0.5, most=0.7)
    log["u"] = np.maximum(log["u"], 0.0)
    over, under = "sign(x)*sqrt(abs(x))", "sign(y)*sqrt(abs(y))"
    assert found([log]) == ([{"x_dot", "u", over}, {"y_dot", over, under}], {})


@pytest.mark.slow
def test_a_pressure_that_is_fed_through_a_valve_from_a_supply_that_was_not_recorded():
    logs = [recorded(lambda x, u: [0.8 * u * np.sqrt(6.0 - x[0]) - 0.5 * x[0]], [[1.0], [4.0]], s) for s in range(8)]
    results = [found(log) for log in logs]
    right = [terms == [{"x_dot", "x", "u*sqrt(supply_x - x)"}] and held(c, {"supply_x": 6.0}) for terms, c in results]
    assert sum(right) >= 7


@pytest.mark.slow
def test_two_tanks_one_into_the_other_with_outlets_below_their_zeros():
    def rate(x, u):
        first, second = 0.4 * np.sqrt(x[0] + 0.2), 0.35 * np.sqrt(x[1] + 0.1)
        return [0.5 * u - first, first - second]

    results = [found(recorded(rate, [[1.0, 0.5], [0.3, 0.9]], seed)) for seed in range(6)]
    law = [{"x_dot", "u", "sqrt(head_x + x)"}, {"y_dot", "sqrt(head_x + x)", "sqrt(head_y + y)"}]
    assert sum(terms == law and held(c, {"head_x": 0.2, "head_y": 0.1}) for terms, c in results) >= 4
