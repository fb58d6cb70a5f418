"""Balances with a step of a weighted sum each: populations of neurons, by default settings."""

from itertools import pairwise

import numpy as np
import pytest
from logs import smooth
from scipy.integrate import solve_ivp

from odescope.likelihood.imitation import Imitated, Samples
from odescope.pipeline.identification import identify
from odescope.pipeline.networks import _Balance, _step
from odescope.study.options import Data, Driven, Measured, Study

T = np.arange(0.0, 60.0, 0.04)


def step(z):
    return 1.0 / (1.0 + np.exp(-z))


def held(rng, every):
    values = rng.uniform(0.0, 2.5, int(T[-1] / every) + 1)
    return values[(T / every).astype(int)]


def populations(seed):
    """Return a log of two populations as Wilson and Cowan (1972), Biophys. J. 12, 1, have them, and the weights."""
    rng = np.random.default_rng(seed)
    p, q = held(rng, 3.0), held(rng, 4.2)
    weights = np.array([[15.0, -13.0, 3.0, 0.0], [14.0, -4.0, 0.0, 2.0]]) * rng.uniform(0.9, 1.1, (2, 4))
    offsets, rates = np.array([5.0, 5.2]) * rng.uniform(0.9, 1.1, 2), np.array([0.9, 0.55])

    state, found = np.array([0.1, 0.05]), [[0.1, 0.05]]
    for k, (begin, end) in enumerate(pairwise(T)):  # an input keeps its value from one sample to the next

        def rate(_, x, driven=weights[:, 2:] @ [p[k], q[k]] - offsets):
            return rates * (step(weights[:, :2] @ x + driven) - x)

        state = solve_ivp(rate, (begin, end), state, rtol=1e-8, atol=1e-10).y[:, -1]
        found.append(state)
    clean = np.array(found).T
    noisy = clean + 0.005 * clean.std(axis=1, keepdims=True) * rng.standard_normal(clean.shape)
    return {"t": T, "E": noisy[0], "I": noisy[1], "P": p, "Q": q}, weights, offsets, rates


STUDY = Study(
    data=Data(time="t"),
    coordinates={"E": Measured(order=1), "I": Measured(order=1)},
    inputs={"P": Driven(), "Q": Driven()},
)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_what_populations_of_neurons_send_to_each_other_is_weighed(seed):
    log, weights, offsets, rates = populations(seed)
    model = identify(STUDY, log).model
    constants = {p.name: p for p in model.parameters}
    truth = {
        **{f"weight_{n}_E": w for n, w in zip("EIP", weights[0, [0, 1, 2]], strict=True)},
        **{f"weight_{n}_I": w for n, w in zip("EIQ", weights[1, [0, 1, 3]], strict=True)},
        "offset_E": offsets[0],
        "offset_I": offsets[1],
    }
    assert constants.keys() == truth.keys()
    for name, value in truth.items():
        assert abs(constants[name].value - value) < 4.0 * constants[name].std_error + 0.002 * abs(value)
    for relation, rate in zip(model.relations, rates, strict=True):
        _, decay, driven = sorted(relation.terms, key=lambda t: ("exp" in t.text, not t.product.bare))
        assert (decay.coefficient, driven.coefficient) == pytest.approx((rate, -rate), rel=0.01)


@pytest.mark.parametrize("own", [0.0, 3.0])
def test_the_weight_of_a_state_is_told_from_its_decay(own):
    rng = np.random.default_rng(3)
    x, u, v = rng.uniform(-1.0, 1.0, (3, 600))
    said = 0.1 - 1.3 * x + 2.0 * step(own * x - 4.0 * u - 0.7) + 1e-3 * rng.standard_normal(600)
    samples = Samples({"x": x, "u": u, "v": v})
    balance = _Balance(0, "x", Imitated(said, np.array([np.ones_like(x), x]), samples), dict.fromkeys("xuv", 0.57))
    found = _step(balance)
    truth = {"weight_u_x": -4.0, "offset_x": 0.7} | ({"weight_x_x": own} if own else {})
    assert found.placed.values == pytest.approx(truth, rel=0.01)


def test_what_lines_say_as_well_is_no_step():
    rng = np.random.default_rng(4)
    x, u = rng.uniform(-1.0, 1.0, (2, 600))
    said = 0.4 - 1.3 * x + 2.0 * u + 0.1 * rng.standard_normal(600)
    samples = Samples({"x": x, "u": u})
    balance = _Balance(0, "x", Imitated(said, np.array([np.ones_like(x), x]), samples), dict.fromkeys("xu", 0.57))
    assert _step(balance) is None


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3))])
def test_a_step_of_one_variable_about_zero_is_a_tanh(seed):
    """A valve that saturates to both sides: a step says the same with an offset and a constant more."""
    rng, period = np.random.default_rng(seed), float(T[1])
    u, x = smooth(rng, len(T), period, 0.5, 1.0), [0.0]
    for now, after in pairwise(u):
        middle = np.tanh(0.5 * (now + after) / 0.6)
        x.append(x[-1] * np.exp(-0.5 * period) + middle / 0.5 * (1.0 - np.exp(-0.5 * period)))
    log = {"t": T, "x": np.array(x) + 0.01 * np.std(x) * rng.standard_normal(len(T)), "u": u}
    model = identify(Study(data=Data(time="t"), coordinates={"x": Measured()}, inputs={"u": Driven()}), log).model
    (scale,) = model.parameters
    assert (scale.name, scale.value) == ("scale_u", pytest.approx(0.6, rel=0.05))
    assert len(model.relations[0].terms) == 3
