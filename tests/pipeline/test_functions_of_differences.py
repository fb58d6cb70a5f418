"""Functions of two variables that a model imitates: a diode, a drive with backlash, two substrates of one growth."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

SLOW = [pytest.param(seed, marks=pytest.mark.slow) for seed in range(3)]


def waves(seed, size, rates):
    """Return an input: a sum of sines of so many radians a second, with random phases."""
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(rates))
    return lambda t: size * sum(np.sin(w * t + p) for w, p in zip(rates, phases, strict=True)) / len(rates)


def model_of(times, rates_of, start, names, inputs, seed, order=1, noise=0.003):
    """Return the model of a record of states (or of positions, order 2) and inputs, with white noise on the states."""
    solved = solve_ivp(
        rates_of, (times[0], times[-1]), start, t_eval=times, rtol=1e-9, atol=1e-11, max_step=np.diff(times)[0]
    )
    rng = np.random.default_rng(seed + 100)
    seen = [x + noise * x.std() * rng.standard_normal(len(x)) for x in solved.y[: len(names)]]
    study = Study(
        data=Data(time="t"),
        coordinates={n: Measured(order=order) for n in names},
        inputs={n: Driven(hold="linear", delay=0.0) for n in inputs},
    )
    driven = {n: u(times) for n, u in inputs.items()}
    return identify(study, {"t": times, **dict(zip(names, seen, strict=True)), **driven}).model


def check(relation, law, allowed):
    found = {t.text: t for t in relation.terms[1:]}
    assert set(found) == set(law)
    for text, value in law.items():
        assert abs(found[text].coefficient + value) < allowed * abs(value)


@pytest.mark.parametrize("seed", [0, *SLOW[1:]])
def test_a_diode_conducts_with_the_exponential_of_a_difference(seed):
    source = waves(seed, 4.0, (31.0, 53.0))
    model = model_of(
        np.arange(4000) * 2e-4,
        lambda t, v: 0.8 * (np.exp((source(t) - v) / 0.2) - 1.0) - 24.0 * v,
        [1.0],
        ["v"],
        {"vs": source},
        seed,
    )
    (relation,) = model.shown_relations
    (text,) = (t.text for t in relation.terms if "exp(" in t.text)
    check(relation, {"v": -24.0, text: 0.8} | ({"1": -0.8} if len(relation.terms) > 3 else {}), 0.2)
    (constant,) = model.parameters
    assert abs(constant.value - 0.2) < 0.01 * 0.2


@pytest.mark.parametrize("seed", SLOW)
def test_a_drive_with_backlash_pushes_outside_of_it(seed):
    motor, gap = waves(seed, 1.5, (0.7, 1.9, 4.1)), 0.06
    model = model_of(
        np.arange(3000) * 0.01,
        lambda t, s: [s[1], 340.0 * ((d := motor(t) - s[0]) - np.clip(d, -gap, gap)) - 2.3 * s[1]],
        [0.0, 0.0],
        ["y"],
        {"m": motor},
        seed,
        order=2,
        noise=0.001,
    )
    (relation,) = model.shown_relations
    (text,) = (t.text for t in relation.terms if "abs(" in t.text)
    sign = 1.0 if relation.terms[[t.text for t in relation.terms].index(text)].coefficient < 0.0 else -1.0
    check(relation, {"y": -340.0, "y_dot": -2.3, "m": 340.0, text: sign * 170.0}, 0.02)
    (constant,) = model.parameters
    assert abs(constant.value - gap) < 0.01 * gap


@pytest.mark.parametrize("seed", SLOW)
def test_a_growth_that_two_substrates_limit_has_both_saturations(seed):
    feed, air = waves(seed, 1.0, (0.11, 0.31)), waves(seed + 50, 1.0, (0.07, 0.23))

    def rates_of(t, s):
        both = 1.7 * s[0] * s[1] / ((0.8 + s[0]) * (0.4 + s[1]))
        return [0.6 + 0.5 * feed(t) - both - 0.12 * s[0], (2.5 + 1.8 * air(t)) * (2.0 - s[1]) - 1.3 * both]

    model = model_of(
        np.arange(4000) * 0.05,
        rates_of,
        [0.5, 1.0],
        ["S", "O"],
        {"F": lambda t: 0.6 + 0.5 * feed(t), "k": lambda t: 2.5 + 1.8 * air(t)},
        seed,
    )
    rate = "O*S*(O + half_O)**-1*(S + half_S)**-1"
    check(model.shown_relations[0], {"S": -0.12, "F": 1.0, rate: -1.7}, 0.05)
    check(model.shown_relations[1], {"k": 2.0, "O*k": -1.0, rate: -2.21}, 0.05)
    assert {c.name for c in model.parameters} == {"half_S", "half_O"}
