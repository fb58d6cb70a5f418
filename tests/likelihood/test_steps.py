"""Dry friction that is made narrower in a search and at its end, on a joint that sticks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.library.constants import Constant
from odescope.library.mechanism import Mechanism, candidate
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.program import Frame
from odescope.likelihood.sampled_inputs import SampledInputs
from odescope.likelihood.search import WIDTHS, fitted_again, search
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments
from odescope.likelihood.steps import with_finer_steps, with_narrow_friction
from odescope.recordings.coordinate import Coordinate

# q_ddot = -40 q - 2 q_dot - 6 tanh(q_dot/w) + u, which sticks wherever it turns slowly.
COORDINATES = (Coordinate("q", 2),)
PERIOD, COUNT, NOISE, TRUE_WIDTH, WIDE = 0.01, 1000, 5e-4, 2e-4, 0.003
TERMS = (("q_ddot", "1", 1.0), (None, "q", 40.0), (None, "q_dot", 2.0), (None, "tanh(q_dot/w)", 6.0), (None, "u", -1.0))


def recorded(width):
    """Return noisy averages and true states under an input that is linear between samples."""
    t = PERIOD * np.arange(COUNT)
    u = 16.0 * np.sin(2.1 * t) + 9.0 * np.sin(5.3 * t + 1.0)

    def rate(now, x):
        return x[1], np.interp(now, t, u) - 40.0 * x[0] - 2.0 * x[1] - 6.0 * np.tanh(x[1] / width)

    states = solve_ivp(
        rate, (0.0, t[-1]), (0.0, 0.0), "LSODA", t, rtol=1e-8, atol=1e-11, max_step=PERIOD
    ).y.T  # fmt: skip
    noisy = states[:, :1] + NOISE * np.random.default_rng(0).standard_normal((COUNT, 1))
    return noisy, states, u[:, None]


def space(friction=True, true_width=TRUE_WIDTH, width=WIDE):
    noisy, states, u = recorded(true_width)
    whole = np.zeros(COUNT, dtype=np.int64)
    driven = SampledInputs(u, ("linear",), np.arange(COUNT), whole, whole + COUNT - 1, 1, PERIOD)
    edges = np.linspace(0, COUNT, COUNT // 25 + 1).astype(np.int64)
    joined = np.append(np.ones(len(edges) - 2, dtype=np.bool_), False)
    segments = Segments(
        noisy, driven.nodes([0.0]), states, edges[:-1], np.diff(edges), joined, np.array([NOISE]),
        np.array([NOISE, 10.0 * NOISE]), PERIOD, 1, ((0, COUNT),), None, driven,
    )  # fmt: skip
    scope = Scope.of(["q", "q_dot", "u", "w"])
    terms = [(f, t) for f, t, _ in TERMS if friction or "tanh" not in t]
    plain = [candidate(0, Product(f, parse_term(t, scope)), "q_ddot") for f, t in terms]
    setting = [Mechanism("constant", "width of q_dot", "w", (), 0.0)] if friction else []
    frame = Frame.of(
        COORDINATES, ["u"], {"w": Constant("w", width, 3000.0 * width, width, optional=True)} if friction else {}
    )
    return SearchSpace(Evaluator(segments, 8), (*plain, *setting), frame)


@pytest.fixture(scope="module")
def found():
    it = space()
    outcome = search(it, np.array([*(c for *_, c in TERMS), 0.0]))
    assert outcome.width == WIDTHS[-1]
    return it, outcome


def worst(outcome):
    """Return the worst error of a coefficient, in standard errors."""
    fit = outcome.fit
    truth = np.array([c for *_, c in TERMS])
    free = [k for k in fit.free if k < len(truth)]
    variances = fit.variances[np.searchsorted(fit.free, free)]
    return float(np.abs((fit.theta[free] - truth[free]) / np.sqrt(variances)).max())


@pytest.mark.slow
def test_coefficients_of_a_joint_that_sticks_are_right_once_its_friction_is_narrow(found):
    it, searched = found
    assert worst(searched) < 3.0
    fit = it.begin(np.array([*(c for *_, c in TERMS), 0.0]), it.segments.spread * np.inf)
    for width in WIDTHS[1:]:
        fit = it.again(fit, fit.x0, it.segments.spread * width)
    wide = replace(searched, fit=fit)
    assert np.count_nonzero(fit.theta) == len(TERMS)
    assert worst(wide) > 4.0
    narrow_space, narrow = with_narrow_friction(it, wide)
    assert narrow_space.frame.constants["w"].nominal < it.frame.constants["w"].nominal
    assert narrow.fit.cost < wide.fit.cost
    assert worst(narrow) < 0.5 * worst(wide)


def test_a_width_that_the_record_asks_for_stays(found):
    it, wide = found
    theta = wide.fit.theta.copy()
    theta[-1] = 0.5
    present = np.arange(len(theta))
    fitted = it.fit(theta, present, wide.fit.x0, it.segments.spread * wide.width, iterations=0)
    assert it.fixed_constants(wide.fit) == ["w"]
    assert it.fixed_constants(fitted) == []


def test_what_the_budget_ended_is_no_reason_to_begin_again_and_is_finished_where_it_stands(found):
    it, outcome = found
    bare = np.setdiff1d(outcome.fit.present, [2])  # without viscous friction
    lacking = it.fit(outcome.fit.theta * (np.arange(6) != 2), bare, outcome.fit.x0, it.segments.spread * outcome.width)
    ended = fitted_again(it, replace(outcome, finished=False), lacking)
    assert replace(outcome, finished=False).clear
    _, end = with_finer_steps(it, ended)
    assert end.finished
    assert 2 in end.fit.present
    assert with_finer_steps(it, replace(ended, finished=True))[1].fit.present.tolist() == bare.tolist()


def test_a_model_without_dry_friction_is_left_as_it_is():
    it = space(friction=False)
    outcome = search(it, np.array([c for _, t, c in TERMS if "tanh" not in t]))
    assert with_narrow_friction(it, outcome) == (it, outcome)


def test_a_width_between_that_is_found_at_the_end_has_its_price():
    true_width = 0.1
    it = space(true_width=true_width, width=1.3 * true_width)
    start = np.array([*(c for *_, c in TERMS), 0.0])
    fit = it.begin(start, it.segments.spread * np.inf)
    for width in WIDTHS[1:]:
        fit = it.again(fit, fit.x0, it.segments.spread * width)
    before = fitted_again(it, replace(search(it, start, WIDTHS[:1]), width=WIDTHS[-1]), fit)
    ended, after = with_narrow_friction(it, before)
    k = len(TERMS)
    assert k in after.fit.free
    assert k not in before.fit.free
    assert after.penalised < before.penalised
    np.testing.assert_array_equal(after.penalties, ended.penalty[after.fit.free])
    assert after.clear
    found = ended.frame.constants["w"].at(float(after.fit.theta[k]))
    assert found == pytest.approx(true_width, rel=0.05)
