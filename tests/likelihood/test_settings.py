"""Offsets of sensors, delays of inputs and constants within functions: parameters beside the coefficients."""

from dataclasses import replace

import numpy as np
import pytest
from small_systems import SPRING_STEP

from odescope.library.constants import Constant
from odescope.library.mechanism import Mechanism, candidate
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.program import Frame, Program
from odescope.likelihood.sampled_inputs import SampledInputs
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments
from odescope.likelihood.settings import settings_of
from odescope.recordings.coordinate import Coordinate

# phi_ddot = -8 sin(phi) - 0.2 phi_dot - 1.5 tanh(phi_dot/w) + 2 u, u late and phi read with an offset.
COORDINATES = (Coordinate("phi", 2, angle=True),)
FRAME = Frame.of(COORDINATES, ["u"], {"w": Constant("w", 0.15, 150.0, 0.15, optional=True)})
TERMS = (("phi_ddot", "1", 1.0), (None, "sin(phi)", 8.0), (None, "phi_dot", 0.2), (None, "tanh(phi_dot/w)", 1.5))
SETTINGS = (("offset", "phi"), ("delay", "u"), ("constant", "w"))


def mechanisms(settings=SETTINGS):
    scope = Scope.of(["phi", "phi_dot", "u", "w"])
    terms = [*TERMS, (None, "u", -2.0)]
    plain = [candidate(0, Product(f, parse_term(t, scope)), "phi_ddot") for f, t, _ in terms]
    return (*plain, *(Mechanism(kind, place, place, (), 0.0) for kind, place in settings))


COEFFICIENTS = np.array([*(c for *_, c in TERMS), -2.0])


def held_segments(hold, count=60, seed=3):
    """Return three segments of noise under a random input."""
    rng = np.random.default_rng(seed)
    samples = rng.standard_normal((count, 1))
    whole = np.zeros(count, dtype=np.int64)
    driven = SampledInputs(samples, (hold,), np.arange(count), whole, whole + count - 1, 1, SPRING_STEP)
    start, size = np.array([0, 20, 40]), np.array([20, 20, 20])
    return Segments(
        rng.standard_normal((count, 1)), driven.nodes([0.0]), np.zeros((count, 2)), start, size, np.zeros(3, bool),
        np.array([0.2]), np.ones(2), SPRING_STEP, 1, ((0, count),), None, driven,
    )  # fmt: skip


@pytest.mark.parametrize("hold", ["linear", "zero"])
def test_derivatives_with_respect_to_offset_delay_and_constant_are_those_of_difference_quotients(hold):
    evaluator, program = Evaluator(held_segments(hold), substeps=4), Program.of(mechanisms(), FRAME)
    theta = np.array([*COEFFICIENTS, 0.13, 0.37 * SPRING_STEP, 0.4])
    starts = np.array([[0.3, 0.5], [-1.0, 2.0], [2.0, -1.0]])
    free = np.arange(1, len(theta))
    found = evaluator.integrate(program, theta, free, starts)
    for place, k in enumerate(free):
        step = 1e-5 * np.eye(len(theta))[k] * (SPRING_STEP if k == 6 else 1.0)
        more, less = (evaluator.integrate(program, theta + s, free, starts) for s in (step, -step))
        size = 2.0 * step.sum()
        slope = (more.cost - less.cost) / size
        np.testing.assert_allclose(2.0 * found.gradient[:, 2 + place], slope, rtol=2e-4, atol=1e-3)
        np.testing.assert_allclose(
            found.jacobian[:, :, 2 + place], (more.last - less.last) / size, rtol=2e-4, atol=1e-5
        )


def test_an_average_that_counts_half_has_half_the_cost_and_one_that_is_missing_none():
    data, program = held_segments("linear"), Program.of(mechanisms(()), FRAME)
    starts, rng = np.array([[0.3, 0.5], [-1.0, 2.0], [2.0, -1.0]]), np.random.default_rng(1)
    share = rng.choice([0.0, 0.5, 1.0, 2.0], size=(60, 1))
    free = np.arange(1, 5)
    weighed = Evaluator(replace(data, weight=np.sqrt(share))).integrate(program, COEFFICIENTS, free, starts)
    one_by_one = np.zeros((3, 6))
    cost = np.zeros(3)
    for k in range(60):
        only = np.zeros((60, 1))
        only[k] = 1.0
        single = Evaluator(replace(data, weight=only)).integrate(program, COEFFICIENTS, free, starts)
        cost, one_by_one = cost + share[k] * single.cost, one_by_one + share[k] * single.gradient
    np.testing.assert_allclose(weighed.cost, cost, rtol=1e-12)
    np.testing.assert_allclose(weighed.gradient, one_by_one, rtol=1e-9, atol=1e-9)
    assert replace(data, weight=np.sqrt(share)).samples == np.count_nonzero(share)


def recorded(noise, seed):
    """Return segments of a pendulum whose sensor, input and friction are off, and its true settings."""
    data = held_segments("linear", 1500, seed)
    smooth = np.convolve(data.driven.samples[:, 0], np.hanning(25), "same")[:, None]
    driven = replace(data.driven, samples=smooth)
    truth = np.array([*COEFFICIENTS, 0.13, 0.37 * SPRING_STEP, 0.4])
    whole = replace(
        data, driven=driven, inputs=driven.nodes([0.0]), start=np.zeros(1, np.int64), count=np.array([1500]),
        joined=np.zeros(1, bool), noise=np.array([noise]),
    )  # fmt: skip
    program, x, rows = Program.of(mechanisms(), FRAME), np.array([[0.4, 0.0]]), []
    for k in range(1500):
        rows.append(x[0])
        one = replace(whole, start=np.array([k]), count=np.ones(1, np.int64))
        x = Evaluator(one, substeps=8).integrate(program, truth, np.zeros(0, np.int64), x).last
    states = np.array(rows)
    rng = np.random.default_rng(seed + 100)
    measured = states[:, :1] + 0.13 + noise * rng.standard_normal((1500, 1))
    start = np.arange(0, 1500, 25)
    return replace(
        whole, measured=measured, filtered=states, start=start, count=np.full(60, 25), joined=start < 1475,
        spread=np.array([noise, 5 * noise]),
    )  # fmt: skip


@pytest.mark.slow
def test_settings_are_found_with_errors_that_hold():
    off = []
    for seed in range(12):
        data = recorded(0.01, seed)
        space = SearchSpace(Evaluator(data, substeps=2), mechanisms(), FRAME)
        start = np.array([*(0.9 * COEFFICIENTS), 0.0, 0.0, 0.0])
        start[0] = 1.0
        loose = space.fit(start, np.arange(8), data.initial, data.spread)
        found = space.again(loose, loose.x0, 1e-3 * data.spread)
        assert found.converged
        truth = np.array([*COEFFICIENTS, 0.13, 0.37 * SPRING_STEP, 0.4])
        scale = found.theta[0]
        error = found.theta[5:] - truth[5:]
        held = np.isin(found.held, [5, 6, 7])
        assert not held.any()
        off.append(error / np.sqrt(found.variances[-3:]))
        assert found.theta[1] / scale == pytest.approx(8.0, rel=0.02)
    off = np.array(off)
    assert np.mean(np.abs(off) < 2.0) > 0.85
    assert np.abs(off).max() < 4.5


def test_what_nothing_in_the_model_depends_on_leaves_with_the_last_term_that_did():
    data = recorded(0.01, 0)
    space = SearchSpace(Evaluator(data), mechanisms(), FRAME)
    theta = np.array([*COEFFICIENTS, 0.13, 0.01, 0.4])
    found = space.fit(theta, np.arange(8), data.initial, data.spread)
    theta = found.theta.copy()
    theta[3] = 0.0  # the friction whose width w is
    without = space.fit(theta, np.array([0, 1, 2, 4, 5, 6, 7]), found.x0, data.spread)
    assert without is not None
    assert without.present.tolist() == [0, 1, 2, 4, 5, 6]


def test_a_term_with_a_width_that_the_record_does_not_ask_for_is_written_with_a_sign():
    """Beside Stribeck's speed: what a model writes has to name no constant that it does not have."""
    scope = Scope.of(["phi_dot", "s", "w"])
    curve = candidate(0, Product(None, parse_term("exp(-phi_dot**2/s**2)*tanh(phi_dot/w)", scope)), "phi_ddot")
    constants = {**FRAME.constants, "s": Constant("s", 0.1, 10.0, 1.0)}
    present = (curve, Mechanism("constant", "s", "s", (), 0.0))
    (found,) = settings_of(present, np.array([2.0, np.log(0.5)]), 1e-12 * np.eye(2), constants, {}).parameters
    assert (found.name, found.value) == ("s", pytest.approx(0.5))
    assert found.written == ("exp(-phi_dot**2/s**2)*sign(phi_dot)",)
    assert found.terms == ("exp(-4.0*phi_dot**2)*sign(phi_dot)",)
