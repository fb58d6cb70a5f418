"""What goes with the square of a gap, and what falls again with a speed: by default settings."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study


def held_at(rng, steps, each, low, high):
    return np.repeat(rng.uniform(low, high, steps), each)


def recorded(rate, command, step, noise, seed):
    """A log of a position from rest under a held command."""
    rng, state, rows = np.random.default_rng(seed + 100), np.array([0.0, 0.0]), [[0.0, 0.0]]
    for u in command[:-1]:
        state = solve_ivp(lambda _, s, u=u: rate(s, u), (0.0, step), state, rtol=1e-8, atol=1e-10).y[:, -1]
        rows.append(state)
    x = np.array(rows)[:, 0]
    return {"t": step * np.arange(len(x)), "x": x + noise * x.std() * rng.standard_normal(len(x)), "u": command}


def plate(seed):
    """Plates that a voltage pulls together, 3 apart: the voltage wavers between its steps."""
    rng, count = np.random.default_rng(seed), 2000
    waver = sum(np.sin(0.1 * 2.0 * np.pi * f * np.arange(count) + p) for f, p in rng.uniform(0.03, 0.2, (6, 2)))
    voltage = held_at(rng, 25, count // 25, 0.2, 1.35) + 0.1 * waver

    def rate(s, u):
        return [s[1], -s[0] - 0.15 * s[1] + 1.2 * u**2 / (3.0 - s[0]) ** 2]

    return recorded(rate, voltage, 0.1, 0.002, seed)


def brake(seed):
    """A disc on a spring whose eddy currents brake most at 12 rad/s."""

    def rate(s, u):
        return [s[1], 40.0 * u - 90.0 * s[0] - 16.0 * s[1] / (1.0 + (s[1] / 12.0) ** 2)]

    return recorded(rate, held_at(np.random.default_rng(seed), 40, 50, -7.0, 7.0), 0.01, 0.005, seed)


def found(log):
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    result = identify(study, log)
    constants = {p.name: p for p in result.model.parameters}
    (relation,) = result.model.relations
    (bare,) = (t.coefficient for t in relation.terms if t.text == "x_ddot")
    return {t.text: (-t.coefficient / bare, t.std_error) for t in relation.terms if t.text != "x_ddot"}, constants


def check(log, of_plain_terms, of_function, of_constant):
    terms, constants = found(log)
    (constant,) = constants.values()
    assert abs(constant.value - of_constant) < 4.0 * constant.std_error < 0.01 * of_constant
    expected = {**of_plain_terms, constant.terms[0]: of_function}
    assert set(terms) == set(expected)
    for text, truth in expected.items():
        value, error = terms[text]
        assert abs(value - truth) < 4.0 * error < 0.01 * abs(truth)


@pytest.mark.parametrize("seed", [2, *(pytest.param(s, marks=pytest.mark.slow) for s in (0, 1, 3))])
def test_plates_pull_with_the_square_of_their_gap(seed):
    check(plate(seed), {"x": -1.0, "x_dot": -0.15}, 1.2, 3.0)


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 4))])
def test_eddy_currents_brake_less_at_high_speed(seed):
    check(brake(seed), {"x": -90.0, "u": 40.0}, -16.0 * 144.0, 12.0)
