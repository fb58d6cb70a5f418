from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2
from small_systems import (
    SPRING,
    SPRING_PRESENT,
    SPRING_STEP,
    SPRING_TERMS,
    drive,
    in_bare_gauge,
    shots,
    spring_run,
)

from odescope.library.mechanism import candidate
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.fit import fit
from odescope.likelihood.fit_without import fit_without
from odescope.likelihood.search import WhiteResiduals
from odescope.likelihood.search_space import SearchSpace

NOISE = 0.02
SPREAD = np.array([0.01, 0.05])
TIGHT, LOOSE = 1e-3 * SPREAD, np.inf * SPREAD
X_SQUARED = 5


@pytest.fixture(scope="module")
def states():
    return spring_run()


def evaluator(states, seed, noise=NOISE):
    data = shots(states, drive(), SPRING_STEP, noise, np.random.default_rng(seed), SPREAD)
    return Evaluator(data, substeps=2)


def space(states, seed):
    return SearchSpace(
        evaluator(states, seed),
        SPRING.mechanisms,
        SPRING.frame,
    )


def fitted(it, theta=SPRING.theta, present=SPRING_PRESENT, gap=TIGHT):
    found = it.fit(theta, present, it.segments.initial, gap)
    assert found is not None
    assert found.converged
    return found


def whole_record(states, seed, present):
    """Return estimate, standard errors and cost of the fit of one long shot by SciPy."""
    measured = evaluator(states, seed).segments.measured[:, 0]
    free = np.array(present)

    def error(z):
        theta = SPRING.theta.copy()
        theta[free] = z[2:]
        return (chopped(theta, z[:2])[:, 0] - measured) / NOISE

    found = least_squares(error, [0.5, 0.0, *SPRING.theta[free]], "3-point", method="lm", x_scale="jac")
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    return found.x[2:], np.sqrt(np.diag(covariance))[2:], 2 * found.cost


def chopped(theta, x0, parts=4):
    """Integrate the spring by fixed steps of a fourth of a sample, an order-4 rule that is not the kernel's."""
    # Kutta's 3/8 rule.
    nodes = drive()[:-1, :, 0]
    x, v = x0
    rows, h = [(x, v)], SPRING_STEP / parts
    _, k, c, cube, b, *_ = theta
    for first, middle, last in nodes:
        for part in range(parts):

            def acceleration(x, v, s):
                u = first * (1 - s) * (1 - 2 * s) + middle * 4 * s * (1 - s) + last * s * (2 * s - 1)  # noqa: B023
                return -(k * x + c * v + cube * x * x * x + b * u)

            s = part / parts
            a1 = acceleration(x, v, s)
            v1 = v
            x2, v2 = x + h / 3 * v1, v + h / 3 * a1
            a2 = acceleration(x2, v2, s + 1 / (3 * parts))
            x3, v3 = x + h * (v2 - v1 / 3), v + h * (a2 - a1 / 3)
            a3 = acceleration(x3, v3, s + 2 / (3 * parts))
            x4, v4 = x + h * (v1 - v2 + v3), v + h * (a1 - a2 + a3)
            a4 = acceleration(x4, v4, s + 1 / parts)
            x, v = x + h / 8 * (v1 + 3 * v2 + 3 * v3 + v4), v + h / 8 * (a1 + 3 * a2 + 3 * a3 + a4)
        rows.append((x, v))
    return np.array(rows)


def test_a_tight_fit_is_the_maximum_likelihood_of_the_whole_record(states):
    it = space(states, 0)
    found = fitted(it)
    bare = in_bare_gauge(it, found)
    estimate, errors, cost = whole_record(states, 0, SPRING_TERMS)
    assert np.abs((bare.theta[SPRING_TERMS] - estimate) / errors).max() < 0.02
    np.testing.assert_allclose(bare.errors[SPRING_TERMS], errors, rtol=0.01)
    assert found.cost == pytest.approx(cost, abs=0.05)


def test_a_poor_start_ends_where_a_good_one_does(states):
    it = space(states, 1)
    theta = SPRING.theta * 1.0
    theta[SPRING_TERMS] *= [0.7, 1.5, 0.5, 1.3]
    good, poor = (fitted(it, start, gap=LOOSE) for start in (SPRING.theta, theta))
    one, other = in_bare_gauge(it, good), in_bare_gauge(it, poor)
    np.testing.assert_allclose(other.theta, one.theta, atol=0.05 * one.errors.max())
    assert poor.cost == pytest.approx(good.cost, abs=0.05)


@pytest.mark.parametrize("wrong", [0.5, 0.7, 1.2, 1.5])
def test_narrow_gaps_do_not_keep_a_poor_start_from_its_end(states, wrong):
    it = space(states, 0)
    good, theta = fitted(it), SPRING.theta.copy()
    theta[SPRING_TERMS] *= wrong
    # Steps judged before the joints have closed crawl: from 0.7 and 1.2 they stop at twice this cost.
    assert fitted(it, theta).cost == pytest.approx(good.cost, abs=1e-3)


def test_the_gap_of_a_tight_fit_is_small(states):
    it = space(states, 2)
    found = fitted(it)
    loose = fitted(it, gap=LOOSE)
    assert loose.cost == loose.data_cost < found.data_cost
    last = it.evaluator.integrate(SPRING.program, found.theta, found.free, found.x0).last
    assert np.all(np.abs(last[:-1] - found.x0[1:]) < 0.2 * SPREAD)


def test_standard_errors_are_the_scatter_over_seeds(states):
    spaces = [space(states, seed) for seed in range(100, 180)]
    runs = [fitted(it) for it in spaces]
    bare = [in_bare_gauge(it, found) for it, found in zip(spaces, runs, strict=True)]
    errors = np.array([b.theta - SPRING.theta for b in bare])[:, SPRING_TERMS]
    each = np.array([b.errors for b in bare])[:, SPRING_TERMS]
    stated = np.sqrt(np.mean(each**2, axis=0))
    np.testing.assert_allclose(np.sqrt(np.mean(errors**2, axis=0)), stated, rtol=0.25)
    inside = np.mean(np.abs(errors) < 1.96 * each)
    assert 0.91 < inside < 0.985
    freedom = 600 - 2 - len(SPRING_TERMS)
    assert np.mean([r.data_cost for r in runs]) == pytest.approx(freedom, rel=0.02)


@pytest.mark.parametrize("gap", [TIGHT, LOOSE], ids=["tight", "loose"])
def test_scores_of_absent_terms_are_chi_squared_with_one_degree_of_freedom(states, gap):
    absent = np.array([5, 6, 7, 8, 9])
    scores = []
    for seed in range(150):
        it = space(states, seed)
        scores.append(WhiteResiduals(it, gap).scores(fitted(it, gap=gap)))
    scores = np.array(scores)
    assert np.all(scores[:, SPRING_PRESENT] == 0.0)
    # The mean of 150 has standard deviation 0.115, a share of 5 % one of 1.8 %.
    np.testing.assert_allclose(scores[:, absent].mean(axis=0), 1.0, atol=0.4)
    assert scores[:, absent].mean() == pytest.approx(1.0, abs=0.2)
    assert np.mean(scores[:, absent] > chi2.ppf(0.95, 1)) == pytest.approx(0.05, abs=0.025)
    assert np.mean(scores[:, absent] < chi2.ppf(0.5, 1)) == pytest.approx(0.5, abs=0.07)


@pytest.mark.parametrize("size", [0.03, -0.06])
def test_score_fall_of_the_cost_and_wald_agree_for_a_weak_term(size):
    theta = SPRING.theta.copy()
    theta[X_SQUARED] = size
    it = space(spring_run(theta), 4)
    without = fitted(it)
    score = WhiteResiduals(it, TIGHT).scores(without)[X_SQUARED]
    with_it = fitted(it, without.theta, np.array([*SPRING_PRESENT, X_SQUARED]))
    bare = in_bare_gauge(it, with_it)
    wald = bare.theta[X_SQUARED] ** 2 / bare.covariance[X_SQUARED, X_SQUARED]
    fall = without.cost - with_it.cost
    assert fall > 15.0
    assert score == pytest.approx(fall, rel=0.05)
    assert wald == pytest.approx(fall, rel=0.05)
    assert abs(bare.theta[X_SQUARED] - size) < 4 * bare.errors[X_SQUARED]


def test_a_start_that_cannot_be_integrated_gives_none(states):
    it = space(states, 5)
    theta = SPRING.theta.copy()
    theta[3] = -1e6
    assert it.fit(theta, SPRING_PRESENT, it.segments.initial, LOOSE) is None
    start = it.segments.initial.copy()
    start[3, 0] = 0.5
    theta[3], theta[8] = 0.8, -4.0  # 1 + theta x^2 is zero there
    assert it.fit(theta, np.array([*SPRING_PRESENT, 8]), start, LOOSE) is None


def with_terms(it, *texts):
    mechanisms = (*SPRING.mechanisms, *(candidate(0, SPRING.product(-1, t), "x_ddot") for t in texts))
    return replace(it, mechanisms=mechanisms), np.append(SPRING.theta, np.zeros(len(texts)))


def test_terms_that_no_data_tell_apart_have_large_variances(states):
    it, theta = with_terms(space(states, 0), "sin(x)**2", "cos(x)**2")
    twins = [7, 10, 11]  # 1 = sin^2 + cos^2
    apart = fitted(it, theta, np.array([*SPRING_PRESENT, 7, 10]))
    found = it.fit(theta, np.array([*SPRING_PRESENT, *twins]), it.segments.initial, TIGHT)
    assert found is not None
    variances = [in_bare_gauge(it, f).errors ** 2 for f in (found, apart)]
    # The sum of the three is known and no one of them is.
    assert np.all(variances[0][twins] > 1e3 * variances[1][twins].max())
    np.testing.assert_allclose(variances[0][SPRING_TERMS], variances[1][SPRING_TERMS], rtol=1e-3)
    assert np.all(in_bare_gauge(it, found).theta[twins] ** 2 / variances[0][twins] < 1.0)


def test_a_term_whose_sensitivities_overflow_is_refused_and_hides_no_other(states):
    it, theta = with_terms(space(states, 0), "exp(300*x)")
    assert it.fit(theta, np.array([*SPRING_PRESENT, 10]), it.segments.initial, TIGHT) is None
    lacks = np.array([0, 1, 2, 4])
    found = it.fit(theta, lacks, it.segments.initial, LOOSE)
    scores = WhiteResiduals(it, LOOSE).scores(found)
    assert np.argmax(scores) == 3
    assert scores[10] == 0.0


def test_fits_repeat_to_the_last_bit(states):
    one, two = (fitted(space(states, 6)) for _ in range(2))
    assert np.array_equal(one.theta, two.theta)
    assert np.array_equal(one.x0, two.x0)
    assert one.cost == two.cost


def test_a_fit_that_will_hardly_come_below_a_limit_ends_and_one_that_does_is_the_same(states):
    theta, present = SPRING.theta.copy(), np.setdiff1d(SPRING_PRESENT, [1])
    theta[1] = 0.0  # a spring without its force, in tight segments: 15 steps go down a curved valley

    def fitted_below(limit):
        it = space(states, 0)
        found = it.fit(theta, present, it.segments.initial, TIGHT, limit=limit)
        assert found is not None
        return found, it.evaluator.budget.spent

    (end, spent), (near, enough), (far, little) = (fitted_below(limit) for limit in (np.inf, 1.6e5, 1e4))
    assert end.cost < 1.6e5
    assert far.cost > 1e4
    assert (near.cost, enough) == (end.cost, spent)
    assert little < 0.5 * spent


def test_no_free_coefficient_leaves_the_initial_states_alone_to_fit(states):
    it = evaluator(states, 7)
    start = it.segments.initial + 0.05
    found = fit(it, SPRING.program, SPRING.theta, np.arange(len(SPRING.theta)), start, TIGHT)
    assert found is not None
    assert found.converged
    assert np.array_equal(found.theta, SPRING.theta)
    assert found.data_cost == pytest.approx(600 - 2, abs=4 * np.sqrt(2 * 600))
    np.testing.assert_allclose(found.x0, it.segments.initial, atol=5 * NOISE)


def test_where_two_hold_each_other_up_one_can_be_left_out_all_the_same(states):
    """Without it the other alone pulls with all that it held against: nothing can be integrated from there."""
    it, theta = with_terms(space(states, 0), "x**3*cos(0.001*x)")
    cube, alike = 3, 10
    alone = fitted(it, theta)
    theta[[cube, alike]] += np.array([-1e5, 1e5])
    found = it.fit(theta, np.array([*SPRING_PRESENT, alike]), it.segments.initial, TIGHT, iterations=3)
    for k, other in ((cube, alike), (alike, cube)):
        zeroed = found.theta.copy()
        zeroed[k] = 0.0
        left = found.present[found.present != k]
        assert it.fit(zeroed, left, found.x0, TIGHT, found.strength) is None
        foreseen = found.foreseen_without(k)
        assert foreseen[k] == 0.0
        assert abs(foreseen[other]) < 1e-3 * abs(found.theta[other])
        without = fit_without(it, found, k, TIGHT)
        assert without.cost == pytest.approx(alone.cost, abs=1.0)
        assert without.present.tolist() == left.tolist()


def test_what_is_foreseen_without_a_weak_term_is_where_the_fit_without_it_ends(states):
    it, theta = with_terms(space(states, 4), "sin(x)")
    sine = 10
    found = fitted(it, theta, np.array([*SPRING_PRESENT, sine]))
    foreseen = found.foreseen_without(sine)
    without = fitted(it, foreseen, SPRING_PRESENT)
    moved, told = (
        t[SPRING_TERMS] / t[found.held] - without.theta[SPRING_TERMS] / without.theta[found.held]
        for t in (found.theta, foreseen)
    )
    errors = np.sqrt(without.variances[np.isin(without.free, SPRING_TERMS)])
    assert np.abs(moved / errors).max() > 3.0
    assert np.abs(told / errors).max() < 0.1
