"""Rates that nobody names: of a competitor, of Teissier, of warmth that speeds up growth, of a brake one way."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

MULTIPLIED = pytest.mark.xfail(strict=True, reason="a cubic polynomial, two variables in all their products, is exact")
UNEVEN = pytest.mark.xfail(strict=True, reason="a fraction of 13 terms, five of which the warmth divides")
UNSQUARED = pytest.mark.xfail(strict=True, reason="a fraction of ten terms in which no square of the speed divides")


def held(rng, steps, each, low, high):
    return np.repeat(rng.uniform(low, high, steps), each)


def recorded(rate, begin, inputs, step, noise, seed):
    """A log of states from `begin` under held inputs, with noise in each."""
    rng, state, rows = np.random.default_rng(seed + 100), np.array(begin, dtype=float), [begin]
    for now in np.array([*inputs.values()])[:, :-1].T:
        state = solve_ivp(lambda _, s, u=now: rate(s, *u), (0.0, step), state, rtol=1e-8, atol=1e-10).y[:, -1]
        rows.append(state)
    states = np.array(rows)
    states += noise * np.ptp(states, axis=0) * rng.standard_normal(states.shape)
    names = ("x", "y")[: states.shape[1]]
    return {"t": step * np.arange(len(states)), **dict(zip(names, states.T, strict=True)), **inputs}


def found(log, names, inputs):
    coordinates = {name: Measured() for name in names}
    return identify(
        Study(data=Data(time="t"), coordinates=coordinates, inputs={n: Driven() for n in inputs}), log
    ).model


def terms(relation):
    return {t.text: t.coefficient for t in relation.terms[1:]}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=MULTIPLIED), 2])
def test_what_a_competitor_inhibits_is_found_although_rows_are_lost(seed):
    rng = np.random.default_rng(seed)
    inputs = {"f": held(rng, 40, 50, 0.2, 1.5), "g": held(rng, 25, 80, 0.0, 1.6)}

    def rate(s, f, g):
        return [f - 2.31 * s[0] / (0.83 + 1.456 * s[1] + s[0]) - 0.09 * s[0], g - 0.71 * s[1]]

    log = recorded(rate, [0.5, 0.5], inputs, 0.05, 0.004, seed)
    kept = np.sort(rng.permutation(len(log["t"]))[: int(0.97 * len(log["t"]))])
    model = found({name: column[kept] for name, column in log.items()}, ("x", "y"), inputs)
    assert sum(len(r.terms) for r in model.relations) <= 12  # its own seven, or multiplied out
    unseen = {"f": held(rng, 10, 50, 0.2, 1.5), "g": held(rng, 5, 100, 0.0, 1.6)}
    there = recorded(rate, [0.5, 0.5], unseen, 0.05, 0.0, seed)
    run = model.simulate(there["t"], unseen, {"x": 0.5, "y": 0.5})
    for name in ("x", "y"):
        np.testing.assert_allclose(run.column(name), there[name], atol=0.01 * np.ptp(there[name]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_growth_that_fills_up_exponentially_is_one_function_in_both_balances(seed):
    rng = np.random.default_rng(seed)
    inputs = {"d": held(rng, 40, 40, 0.05, 0.5), "f": held(rng, 25, 64, 1.0, 8.0)}

    def rate(s, d, f):
        growth = 0.6 * (1.0 - np.exp(-s[1] / 1.5)) * s[0]
        return [growth - d * s[0], d * (f - s[1]) - 2.0 * growth]

    model = found(recorded(rate, [0.5, 2.0], inputs, 0.1, 0.005, seed), ("x", "y"), inputs)
    (constant,) = model.parameters
    assert (constant.name, constant.value) == ("filled_y", pytest.approx(1.5, rel=0.02))
    assert [len(r.terms) for r in model.relations] == [3, 4]


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, 1, pytest.param(2, marks=pytest.mark.xfail(strict=True, reason="13 terms before"))]
)
def test_warmth_speeds_up_growth_and_what_limits_it(seed):
    rng = np.random.default_rng(seed)
    inputs = {"w": held(rng, 30, 40, 5.0, 32.0), "d": held(rng, 40, 30, 0.0, 0.8)}

    def rate(s, w, d):
        return [0.25 * np.exp(0.07 * w) * s[0] * (1.0 - s[0] / 5.0) - d * s[0]]

    model = found(recorded(rate, [1.0], inputs, 0.1, 0.005, seed), ("x",), inputs)
    (constant,) = model.parameters
    assert (constant.name, constant.value) == ("rise_w", pytest.approx(1.0 / 0.07, rel=0.02))
    (relation,) = model.relations
    assert sorted(terms(relation).values()) == pytest.approx([-0.25, 0.05, 1.0], rel=0.03)


@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=[pytest.mark.slow, UNSQUARED]), pytest.param(2, marks=pytest.mark.slow)]
)
def test_what_turns_one_way_is_braked_most_at_a_speed(seed):
    rng = np.random.default_rng(seed)
    inputs = {"u": held(rng, 40, 30, 0.5, 4.0), "b": held(rng, 24, 50, 0.1, 0.6)}

    def rate(s, u, b):
        return [2.0 * u - 0.1 * s[0] - 4.0 * b * s[0] / (1.0 + s[0] ** 2 / 36.0)]

    model = found(recorded(rate, [0.0], inputs, 0.02, 0.004, seed), ("x",), inputs)
    (constant,) = model.parameters
    assert (constant.name, constant.value) == ("critical_x", pytest.approx(6.0, rel=0.02))
    assert len(model.relations[0].terms) == 4
