"""Inputs that were recorded with noise: what they do to the states is noise of the process, and no terms are."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

PLACE, ANGLE = Measured(), Measured(angle=True)


def log(rates, states, inputs, start, seconds, samples, seed, share=0.02):
    """States with .3 % of noise and inputs, lines between samples, with a share of theirs."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, seconds, samples)
    nodes = {name: rng.uniform(low, high, int(seconds / hold) + 2) for name, (low, high, hold) in inputs.items()}
    acts = {
        name: np.interp(t, hold * np.arange(len(nodes[name])), nodes[name]) for name, (_, _, hold) in inputs.items()
    }

    def of(now, x):
        return rates(x, *(np.interp(now, t, act) for act in acts.values()))

    x = solve_ivp(of, (0.0, seconds), start, t_eval=t, rtol=1e-8, atol=1e-10, max_step=seconds / samples).y

    def read(values, noise):
        return values + noise * values.std() * rng.standard_normal(len(values))

    read_states = {name: read(column, 0.003) for name, column in zip(states, x, strict=True)}
    return {"t": t, **read_states, **{name: read(act, share) for name, act in acts.items()}}


def found(coordinates, inputs, logs):
    study = Study(data=Data(time="t"), coordinates=coordinates, inputs={name: Driven() for name in inputs})
    result = identify(study, logs)
    laws = ({t.text: -t.coefficient for t in r.terms if not t.product.bare} for r in result.model.relations)
    return result.refinement, dict(zip((f"{name}_dot" for name in coordinates), laws, strict=True))


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 8))])
def test_a_tank_whose_inflow_is_noisy_empties_by_the_root_of_its_level(seed):
    inputs = {"q": (0.2, 1.2, 12.0)}
    logs = [
        log(lambda x, q: [(q - 0.4 * np.sqrt(x[0])) / 2.0], "h", inputs, [2.0], 300.0, 900, 10 * seed + k)
        for k in range(2)
    ]
    refinement, law = found({"h": PLACE}, inputs, logs)
    assert refinement.process is not None
    assert set(law["h_dot"]) == {"q", "sqrt(h)"}
    assert law["h_dot"]["sqrt(h)"] == pytest.approx(-0.2, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_two_wheels_turn_a_cart_whatever_their_speeds_are_recorded_with(seed):
    def wheels(x, left, right):
        return [0.025 * (left + right) * f(x[2]) for f in (np.cos, np.sin)] + [(right - left) / 6.0]

    inputs = {"l": (0.0, 10.0, 1.5), "r": (0.0, 10.0, 1.5)}
    logs = [log(wheels, "xyc", inputs, [0.0, 0.0, 0.0], 25.0, 1500, 10 * seed + k) for k in range(2)]
    refinement, law = found({"x": PLACE, "y": PLACE, "c": ANGLE}, inputs, logs)
    assert refinement.process is not None
    assert {target: set(terms) for target, terms in law.items()} == {
        "x_dot": {"l*cos(c)", "r*cos(c)"},
        "y_dot": {"l*sin(c)", "r*sin(c)"},
        "c_dot": {"l", "r"},
    }


@pytest.mark.slow
@pytest.mark.xfail(reason="under noise of the process d*v and d**3 imitate v*tan(d)")
@pytest.mark.parametrize("seed", [0, 2, 4])
def test_a_car_turns_by_the_tangent_of_its_wheels(seed):
    def car(x, v, d):
        return [v * np.cos(x[2]), v * np.sin(x[2]), v / 2.6 * np.tan(d)]

    inputs = {"v": (2.0, 8.0, 2.0), "d": (-0.7, 0.7, 1.0)}
    logs = [log(car, "xyc", inputs, [0.0, 0.0, 0.0], 120.0, 1200, seed + k) for k in range(2)]
    refinement, law = found({"x": PLACE, "y": PLACE, "c": ANGLE}, inputs, logs)
    assert refinement.process is not None
    assert {target: set(terms) for target, terms in law.items()} == {
        "x_dot": {"v*cos(c)"},
        "y_dot": {"v*sin(c)"},
        "c_dot": {"v*tan(d)"},
    }
