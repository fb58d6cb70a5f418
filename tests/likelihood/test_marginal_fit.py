"""Coefficients of the least marginal cost, against SciPy and over seeds of a spring that is pushed at every sample."""

import numpy as np
import pytest
from process_cases import LINEAR, PRESENT, STEP, cut, fitted, kicked, space, spring
from scipy.optimize import minimize
from small_systems import SPRING, drive

from odescope.likelihood.fit import fit
from odescope.likelihood.marginal_fit import determinant_slopes, marginal_fit

SIGMA, PUSH = 0.02, np.array([1e-4, 0.4])
STIFF = np.where(np.arange(len(LINEAR)) == 1, 60.0, LINEAR)  # two fifths of a radian a sample


def pushed(seed, count=400):
    """Return the space of a stiff spring that process noise pushes at every sample, each a segment."""
    rng = np.random.default_rng(seed)
    kicks = PUSH * rng.standard_normal((count, 2))
    states = kicked(SPRING, STIFF, drive(count), kicks, [0.0, 0.0])
    measured = states[:, :1] + SIGMA * rng.standard_normal((count, 1))
    return space(SPRING, cut(states, measured, drive(count), SIGMA, PUSH, (count,), length=1))


def marginal(it, theta):
    """Return the marginal cost of the present coefficients, the most likely states found for them."""
    program, every = it.program(PRESENT), np.arange(len(PRESENT))
    there = fit(it.evaluator, program, theta[PRESENT], every, it.segments.initial, it.segments.spread)
    at = it.evaluator.expand(program, there.theta, np.zeros(0, dtype=np.int64), there.x0, it.segments.spread)
    return at.cost + at.log_det


def moved(found, change):
    theta = found.theta.copy()
    theta[found.free] += change
    return theta


@pytest.mark.parametrize("it", [spring(1, count=200), pushed(1, count=200)], ids=["segments of five", "single samples"])
def test_the_determinant_changes_with_the_states_along(it):
    found = fitted(it, STIFF if it.segments.count[0] == 1 else LINEAR)
    program, theta = it.program(found.present), found.theta[found.present]
    free = np.searchsorted(found.present, found.free)
    here = it.evaluator.expand(program, theta, free, found.x0, it.segments.spread)
    slopes = determinant_slopes(it, program, theta, free, found.x0, here)
    for p, k in enumerate(found.free):
        step = 1e-4 * max(abs(found.theta[k]), 1.0)
        sides = [marginal(it, moved(found, np.where(found.free == k, s * step, 0.0))) for s in (1.0, -1.0)]
        # Of the whole cost: that of the fit itself is flat here.
        assert slopes[p] == pytest.approx(0.25 * (sides[0] - sides[1]) / step, rel=0.02, abs=1e-3)


def test_it_is_where_scipy_finds_the_least_marginal_cost():
    it = pushed(0)
    found = fitted(it, STIFF)
    scale = np.sqrt(found.variances)
    best = minimize(
        lambda z: marginal(it, moved(found, z * scale)), np.ones(len(scale)), method="Nelder-Mead",
        options={"xatol": 2e-3, "fatol": 1e-3},
    )  # fmt: skip
    there = marginal_fit(it, found)
    assert marginal(it, there.theta) < marginal(it, found.theta) - 1.0
    np.testing.assert_allclose((there.theta - found.theta)[found.free] / scale, best.x, atol=0.02)


def test_over_seeds_it_is_the_truth_where_the_fit_of_coefficients_and_states_together_is_not():
    off = []
    for seed in range(12):
        it = pushed(seed)
        found = fitted(it, STIFF)
        there = marginal_fit(it, found)
        errors = np.sqrt(np.maximum(there.variances, found.variances))
        off.append([(f.theta - STIFF)[f.free] / errors for f in (found, there)])
    together, marginally = np.mean(off, axis=0) * np.sqrt(len(off))
    assert np.abs(together).max() > 5.0
    assert np.abs(marginally).max() < 2.5


def test_a_model_without_free_coefficients_stays_as_it_is():
    it = pushed(0, count=50)
    found = it.fit(STIFF, np.array([0]), it.segments.initial, it.segments.spread)
    assert marginal_fit(it, found) is found
    assert it.segments.step == STEP
