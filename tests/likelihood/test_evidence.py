"""What weigh makes of an information matrix, against least squares written out in numpy."""

import numpy as np
import pytest
from scipy.stats import chi2
from small_systems import SPRING, drive, shots

from odescope.library.mechanism import candidates_of
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.evidence import weigh
from odescope.likelihood.fit import Fit
from odescope.likelihood.search_space import SearchSpace

SLOTS = 7  # of which the first is fixed
HELD = np.array([0])
PRESENT = np.array([1, 3, 6])
ABSENT = np.array([2, 4, 5])
ROWS, BLOCKS = 4000, 80


def space(count=SLOTS):
    data = shots(np.zeros((50, 2)), drive(50), 0.05, 1.0, np.random.default_rng(0), np.ones(2))
    scope = Scope.of(list(SPRING.variables))
    texts = ["1", *(f"x**{k}" for k in range(1, count))]
    products = [Product("x_ddot" if k == 0 else None, parse_term(t, scope)) for k, t in enumerate(texts)]
    return SearchSpace(Evaluator(data), candidates_of([products], ["x_ddot"]), SPRING.frame)


def regression(rng, theta=None, rows=ROWS, correlated=1, twin=None):
    """Return rows of unlike scales, and what they leave with unit noise that holds over so many of them."""
    design = rng.standard_normal((rows, SLOTS - 1)) @ (np.eye(SLOTS - 1) + 0.3 * rng.standard_normal((6, 6)))
    design = np.repeat(design[::correlated], correlated, axis=0) * 10.0 ** np.arange(-3, 3)
    if twin is not None:
        design[:, twin[0]] = design[:, twin[1]]
    noise = np.repeat(rng.standard_normal(rows // correlated), correlated)
    return design, noise if theta is None else design @ theta + noise


def judged(design, y, blocks, present=PRESENT):
    """Return weigh's evidence of a least-squares fit to rows."""
    fitted = np.linalg.lstsq(design[:, present - 1], y, rcond=None)[0]
    theta = np.eye(SLOTS)[0]
    theta[present] = fitted
    residual = y - design[:, present - 1] @ fitted
    gradient = -(design * residual[:, None]).reshape(blocks, -1, SLOTS - 1).sum(axis=1)
    information = design.T @ design
    inside = information[np.ix_(present - 1, present - 1)]
    found = Fit(theta, np.append(0, present), HELD, np.zeros((1, 2)), 0.0, 0.0, inside, True)
    return weigh(space(), found, information, gradient), fitted, information, gradient


def test_without_blocks_everything_is_that_of_least_squares():
    rng = np.random.default_rng(0)
    design, y = regression(rng, np.array([2.0, 0.0, 3e-2, 0.0, 5e-4, 1e-3]))
    evidence, fitted, _, _ = judged(design, y, 1)
    inside = design[:, PRESENT - 1]
    covariance = np.linalg.inv(inside.T @ inside)
    np.testing.assert_allclose(evidence.variances, np.diag(covariance), rtol=1e-8)
    np.testing.assert_allclose(evidence.wald, fitted**2 / np.diag(covariance), rtol=1e-8)
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(evidence.correlation, covariance / np.outer(scale, scale), atol=1e-10)
    before = np.sum((y - inside @ fitted) ** 2)
    for k in ABSENT:
        more = design[:, [*(PRESENT - 1), k - 1]]
        with_it, after, *_ = np.linalg.lstsq(more, y, rcond=None)
        # In a linear model the score is the fall of the cost, and so is the Wald statistic of the added term.
        assert evidence.scores[k] == pytest.approx(before - after[0], rel=1e-6)
        error = np.sqrt(np.linalg.inv(more.T @ more)[-1, -1])
        assert evidence.scores[k] == pytest.approx((with_it[-1] / error) ** 2, rel=1e-6)
        # At its limit a term is so many standard errors away from zero that its statistic is its price.
        assert (evidence.limits[k] / error) ** 2 == pytest.approx(space().penalty[k], rel=1e-6)
    assert not evidence.scores[[0, *PRESENT]].any()
    assert not evidence.limits[[0, *PRESENT]].any()


def test_evidence_does_not_depend_on_the_units_of_the_terms():
    rng = np.random.default_rng(1)
    design, y = regression(rng, np.array([2.0, 0.0, 3e-2, 0.0, 5e-4, 1e-3]), correlated=20)
    units = 10.0 ** rng.uniform(-6, 6, SLOTS - 1)
    one, two = judged(design, y, BLOCKS)[0], judged(design * units, y, BLOCKS)[0]
    np.testing.assert_allclose(two.scores, one.scores, rtol=1e-6)
    np.testing.assert_allclose(two.wald, one.wald, rtol=1e-6)
    np.testing.assert_allclose(two.variances * units[PRESENT - 1] ** 2, one.variances, rtol=1e-6)
    np.testing.assert_allclose(two.limits[1:] * units, one.limits[1:], rtol=1e-6)
    np.testing.assert_allclose(two.correlation, one.correlation, atol=1e-6)


def test_variances_under_correlated_noise_are_those_of_the_scatter():
    truth = np.array([2.0, 0.0, 3e-2, 0.0, 0.0, 1e-3])
    design = regression(np.random.default_rng(2), rows=4 * ROWS, correlated=20)[0]
    errors, stated, plain, scores = [], [], [], []
    for seed in range(200):
        noise = np.repeat(np.random.default_rng(10 + seed).standard_normal(ROWS // 5), 20)
        evidence, fitted, _, _ = judged(design, design @ truth + noise, 2 * BLOCKS)
        errors.append(fitted - truth[PRESENT - 1])
        stated.append(evidence.variances)
        plain.append(np.diag(np.linalg.inv(design[:, PRESENT - 1].T @ design[:, PRESENT - 1])))
        scores.append(evidence.scores[ABSENT])
    scatter, scores = np.mean(np.square(errors), axis=0), np.array(scores)
    # 200 squares of errors: their mean has a standard deviation of a tenth.
    np.testing.assert_allclose(np.mean(stated, axis=0), scatter, rtol=0.3)
    assert np.all(scatter > 10.0 * np.mean(plain, axis=0))
    assert scores.mean() == pytest.approx(1.0, abs=0.15)
    assert np.mean(scores > chi2.ppf(0.95, 1)) == pytest.approx(0.05, abs=0.03)


def test_the_larger_of_both_variances_counts():
    rng = np.random.default_rng(3)
    design, y = regression(rng, np.array([2.0, 0.0, 3e-2, 0.0, 5e-4, 1e-3]))
    plain, _, information, gradient = judged(design, y, 1)
    many, *_ = judged(design, y, BLOCKS)
    assert np.all(many.variances >= plain.variances * (1 - 1e-12))
    assert np.all(many.scores <= plain.scores * (1 + 1e-12))
    assert np.all(many.limits >= plain.limits * (1 - 1e-12))
    assert information.shape == (6, 6)
    assert gradient.shape == (1, 6)


def test_an_absent_twin_of_a_present_term_has_no_score_and_no_finite_limit():
    design, y = regression(np.random.default_rng(4), np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0]), twin=(1, 0))
    for blocks in (1, BLOCKS):
        evidence = judged(design, y, blocks)[0]
        assert evidence.scores[2] == 0.0
        assert np.isinf(evidence.limits[2])
        assert np.all(np.isfinite(evidence.limits[[4, 5]]))


def test_present_twins_have_large_variances():
    design, y = regression(np.random.default_rng(5), np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0]), twin=(1, 0))
    alone = judged(design, y, 1, np.array([1, 3, 6]))[0]
    twins, _, information, _ = judged(design, y, 1, np.array([1, 2, 3, 6]))
    fit = Fit(
        np.zeros(SLOTS), np.array([0, 1, 2, 3, 6]), HELD, np.zeros((1, 2)), 0.0, 0.0,
        information[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])], True,
    )  # fmt: skip
    assert np.all(fit.variances[:2] > 1e3 * alone.variances[0])
    assert np.all(twins.variances[:2] > 1e3 * alone.variances[0])


def test_a_strong_absent_term_scores_as_its_fall_of_the_cost_with_few_blocks_too():
    design, y = regression(np.random.default_rng(6), np.array([2.0, 100.0, 3e-2, 0.0, 5e-4, 1e-3]))
    plain, few = judged(design, y, 1)[0], judged(design, y, 10)[0]
    assert plain.scores[2] > 1000.0
    assert few.scores[2] > 100.0


@pytest.mark.parametrize("close", [1e-2, 1e-4, 1e-6, 1e-9])
def test_correlations_of_near_twins_have_the_right_sign_and_size(close):
    rng = np.random.default_rng(7)
    design, y = regression(rng, np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    design[:, 1] = design[:, 0] + close * np.std(design[:, 0]) * rng.standard_normal(ROWS)
    correlation = judged(design, y, 1, np.array([1, 2, 3, 6]))[0].correlation
    np.testing.assert_allclose(correlation, correlation.T, rtol=1e-12, atol=1e-14)
    assert np.all(np.abs(correlation) < 1.0 + 1e-12)
    if close > 1e-5:  # beyond that the pseudo-inverse takes them for one term
        assert correlation[0, 1] < -0.99
