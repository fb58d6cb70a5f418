"""Inputs that a controller sets between the samples of a log, at the ticks of its own clock, by default settings."""

import numpy as np
import pytest
from scipy.linalg import expm

from odescope import Data, Driven, Measured, Study, identify

STEP, SAMPLES, FINER = 0.15, 1000, 3


def room(seed, acts="at once"):
    """Return a log of a room with a heater that is set at samples, and a fan that is set every 5 s.

    What is set acts at once, or from the next sample on.
    """
    rng = np.random.default_rng(seed)
    t = STEP / FINER * np.arange(FINER * SAMPLES)
    heat = rng.uniform(0.0, 2.0, 60)[(t / 3.0 + 1e-9).astype(int)]
    fan = rng.uniform(0.0, 1.0, 60)[(t / 5.0 + 1e-9).astype(int)]
    if acts != "at once":
        fan = np.repeat(fan[::FINER], FINER)
    outside = 22.0 + 3.0 * np.sin(0.11 * t + rng.uniform(0.0, 6.0)) + 2.0 * np.sin(0.047 * t)
    warm = np.empty(len(t))
    warm[0] = 24.0
    for k in range(len(t) - 1):
        rate = 0.21 + 0.35 * fan[k]
        end = outside[k] + 1.9 * heat[k] / rate
        warm[k + 1] = end + (warm[k] - end) * np.exp(-rate * STEP / FINER)
    read = warm + 0.01 * warm.std() * rng.standard_normal(len(t))
    log = {"t": t, "T": np.round(read, 1), "r": heat, "f": fan, "Ta": outside}
    return {name: values[::FINER] for name, values in log.items()}


@pytest.mark.parametrize("acts", ["at once", "at samples"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 6))])
def test_a_fan_that_is_set_between_samples_beside_a_heater_that_is_not(seed, acts):
    study = Study(
        data=Data(time="t"), coordinates={"T": Measured()}, inputs={"r": Driven(), "f": Driven(), "Ta": Driven()}
    )
    (relation,) = identify(study, room(seed, acts)).model.relations
    terms = {term.text: term for term in relation.terms if term.text != "T_dot"}
    law = {"r": -1.9, "T": 0.21, "Ta": -0.21, "T*f": 0.35, "Ta*f": -0.35}
    assert set(terms) == set(law)
    for text, value in law.items():
        assert abs(terms[text].coefficient - value) < 4.0 * terms[text].std_error


def spring(seed, hold, acts="at once"):
    """Return a log of a spring that is pushed by the square of a voltage, which is another every so many seconds.

    What is set acts at once, or from the next sample on.
    """
    rng = np.random.default_rng(seed)
    period, samples = 0.03, 1500
    volts, slope = rng.uniform(0.0, 1.0, int(period * samples / hold) + 2), np.array([[0.0, 1.0], [-4.0, -0.5]])
    state, now, states = np.array([0.2, 0.0]), 0.0, []
    for end in period * np.arange(samples):
        while now < end - 1e-12:
            tick = int(now / hold + 1e-9)
            there = min(hold * (tick + 1), end) if acts == "at once" else end
            rest = np.array([0.75 * volts[tick] ** 2, 0.0])
            state = rest + expm(slope * (there - now)) @ (state - rest)
            now = there
        states.append(state[0])
    t = period * np.arange(samples)
    x = np.array(states) + 5e-4 * rng.standard_normal(samples)
    return {"t": t, "x": x, "u": volts[(t / hold + 1e-9).astype(int)]}


@pytest.mark.parametrize("acts", ["at once", "at samples"])
@pytest.mark.parametrize("hold", [2.2, pytest.param(0.95, marks=pytest.mark.slow)])
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 4))])
def test_the_square_of_what_steps_within_a_sample_has_the_right_mean(hold, seed, acts):
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    found = identify(study, spring(seed, hold, acts))
    (relation,) = found.model.relations
    terms = {term.text: term for term in relation.terms if term.text != "x_ddot"}
    law = {"x": 4.0, "x_dot": 0.5, "u**2": -3.0}
    assert set(terms) == set(law)
    for text, value in law.items():
        assert abs(terms[text].coefficient - value) < 4.0 * terms[text].std_error
    assert found.model.scores.likelihood.residual_variance < 1.2
