"""Positions behind an anti-aliasing filter: their noise ends far below half the sampling rate, and is white noise."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, lfilter, sosfilt

from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study


def log(rates, states, start, samples, seed, sensor):
    """Twenty seconds under forces that run on lines between random nodes, .6 s apart; 1 % of noise."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, 20.0, samples)
    force = np.interp(t, 0.6 * np.arange(36), rng.uniform(-90.0, 90.0, 36))

    def of(now, x):
        return rates(x, np.interp(now, t, force))

    x = solve_ivp(of, (0.0, 20.0), start, t_eval=t, method="LSODA", rtol=1e-8, atol=1e-10, max_step=0.01).y
    rows = zip(states, x[: len(states)], strict=True)
    read = {name: sensor(row + 0.01 * row.std() * rng.standard_normal(samples)) for name, row in rows}
    return {"t": t, "u": force, **read}


def behind_a_filter(readings):
    return sosfilt(butter(2, 0.2, output="sos"), readings - readings[0]) + readings[0]


def smoothed(readings):
    return lfilter([0.3], [1.0, -0.7], readings - readings[0]) + readings[0]


def terms(model):
    return [{t.text.split("(")[0] for t in r.terms if not t.product.bare} for r in model.relations]


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 8))])
@pytest.mark.parametrize("sensor", [behind_a_filter, smoothed])
def test_a_stage_slides_with_friction_whatever_filters_its_position(sensor, seed):
    def stage(x, u):
        return [x[1], (u - 14.0 * x[1] - 20.0 * np.tanh(x[1] / 0.002)) / 95.0]

    logs = [log(stage, "x", [0.0, 0.0], 4000, 10 * seed + k, sensor) for k in range(2)]
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    result = identify(study, logs)
    assert result.refinement.process is None
    assert terms(result.model) in ([{"u", "x_dot", "tanh"}], [{"u", "x_dot", "sign"}])
    force = next(-t.coefficient for t in result.model.relations[0].terms if t.text == "u")
    assert 1.0 / force == pytest.approx(95.0, rel=0.01)
    assert any("as behind a filter" in note for note in result.notes)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_two_masses_on_a_spring_are_two_masses_behind_a_filter(seed):
    def masses(x, u):
        pull = 40.0 * (x[0] - x[1])
        return [x[2], x[3], -pull - 0.3 * x[2] + u / 18.0, (pull - 0.2 * x[3]) / 0.6]

    logs = [log(masses, "ab", [0.1 * k, 0.0, 0.0, 0.0], 2000, 10 * seed + k, behind_a_filter) for k in range(2)]
    coordinates = {"a": Measured(order=2), "b": Measured(order=2)}
    result = identify(Study(data=Data(time="t"), coordinates=coordinates, inputs={"u": Driven()}), logs)
    assert result.refinement.process is None
    first, second = terms(result.model)
    # Damping is within its error in one of the four, and left out there.
    assert first - {"a_dot"} == {"a", "b", "u"}
    assert second - {"b_dot"} == {"a", "b"}
