"""Evidence under process noise: gradients, intervals and scores against what they should be, over many draws."""

import math
from dataclasses import replace

import numpy as np
import pytest
from process_cases import (
    LENGTH,
    LINEAR,
    PRESENT,
    STEP,
    TERMS,
    fitted,
    spring,
)
from scipy.stats import chi2
from small_systems import SPRING, in_bare_gauge

from odescope.library.mechanism import Mechanism
from odescope.likelihood import process_noise as module
from odescope.likelihood.evidence import weigh
from odescope.likelihood.process_noise import robust_evidence, white

ABSENT = np.array([3, 5, 6, 7, 8, 9])


@pytest.fixture
def weighed(monkeypatch):
    """What robust_evidence passes on: the arguments of its last call of weigh."""
    last = []

    def spy(*arguments):
        last[:] = arguments
        return weigh(*arguments)

    monkeypatch.setattr(module, "weigh", spy)
    return last


def test_gradients_of_blocks_sum_to_that_of_the_marginal_fit(weighed):
    it = spring(0)
    theta = LINEAR * np.where(np.arange(len(LINEAR)) == 2, 0.0, 1.0)
    found = fitted(it, theta, np.array([0, 1, 4]))  # lacks friction: a gradient that is not zero
    assert robust_evidence(it, found) is not None
    _, _, information, blocks = weighed
    free = it.free(found)
    expansion = it.evaluator.expand(SPRING.program, found.theta, free, found.x0, it.segments.spread)
    scale = np.sqrt(np.diag(information))
    np.testing.assert_allclose(blocks.sum(axis=0) / scale, expansion.gradient / scale, atol=0.01)
    assert abs(expansion.gradient / scale)[free == 2] > 10.0


def test_with_white_gaps_blocks_scatter_as_the_model_says(weighed):
    ratios, squares = [], 0.0
    for seed in range(30):
        it = spring(200 + seed)
        found = fitted(it)
        robust = robust_evidence(it, found)
        _, _, information, blocks = weighed
        own = weigh(it, found, information, blocks.sum(axis=0)[None]).variances
        np.testing.assert_allclose(own, found.variances, rtol=1e-3)
        # Information and gradients larger by one factor leave of the two variances that of the blocks.
        alone = weigh(it, found, 1e6 * information, 1e6 * blocks).variances
        np.testing.assert_allclose(robust.variances, np.maximum(own, alone), rtol=1e-9)
        ratios.append(alone / own)
        bare = in_bare_gauge(it, found)
        error = (bare.theta - LINEAR)[TERMS]
        squares += error @ np.linalg.solve(bare.covariance[np.ix_(TERMS, TERMS)], error)
    # Ten blocks that sum to zero, and three coefficients fitted to them: a tenth to a fifth less than the variance.
    mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0) / np.sqrt(30)
    assert np.all(np.abs(mean - 0.85) < 0.05 + 3 * error)
    assert chi2.ppf(1e-3, 90) < squares < chi2.ppf(1 - 1e-3, 90)


def test_what_holds_blocks_to_their_neighbours_is_no_scatter():
    """An offset moves all states at once: at states that stay, blocks of its gradient scatter 75 times as much."""
    offset, ratios = Mechanism("offset", "offset x", "x", (), 0.0), []
    for seed in range(4):
        it = spring(500 + seed, 1000, 0.002, np.array([1e-4, 0.1]))
        wider = replace(it, mechanisms=(*it.mechanisms, offset))
        found = fitted(wider, np.append(LINEAR, 0.1), np.append(PRESENT, len(LINEAR)))
        ratios.append((robust_evidence(wider, found).variances / found.variances)[-1])
    assert np.median(ratios) < 2.0


def slow_force(rng, count, size, correlated):
    force, keep = np.empty(count), math.exp(-STEP / correlated)
    force[0] = rng.standard_normal()
    for k, fresh in enumerate(rng.standard_normal(count - 1)):
        force[k + 1] = keep * force[k] + math.sqrt(1.0 - keep**2) * fresh
    return size * force


def pushed(seed, count=2000):
    """Return a spring under a force that no input knows and that changes slowly."""
    # Small beside the input: a large force moves the states with it, which biases coefficients, whatever their errors.
    force = slow_force(np.random.default_rng(seed), count, 0.25, 0.5)
    kicks = STEP * np.column_stack([0.5 * STEP * force, force])
    gaps = np.add.reduceat(kicks, np.arange(0, count, LENGTH), axis=0)
    return spring(300 + seed, count, 0.005, kicks=kicks, believed=np.maximum(gaps.std(axis=0), 0.002))


def test_white_noise_of_the_process_is_told_from_a_force_that_changes_slowly():
    for seed in range(10, 15):
        for it, told in ((spring(600 + seed, 2000), True), (pushed(seed), False)):
            found = fitted(it)
            assert white(found, robust_evidence(it, found)) is told


def test_with_coloured_gaps_robust_intervals_cover_and_plain_ones_do_not():
    plain, robust, ratio = [], [], []
    for seed in range(25):
        it = pushed(seed)
        found = fitted(it)
        evidence = robust_evidence(it, found)
        bare, checked = in_bare_gauge(it, found), in_bare_gauge(it, found, evidence.covariance)
        error = np.abs(bare.theta - LINEAR)[TERMS]
        plain.append(error < 1.96 * bare.errors[TERMS])
        robust.append(error < 1.96 * checked.errors[TERMS])
        ratio.append(evidence.variances / found.variances)
    assert np.mean(ratio) > 2.0
    assert np.mean(plain) < 0.8
    assert np.mean(robust) > 0.87


def test_scores_of_absent_terms_are_chi_squared_with_one_degree_of_freedom(weighed):
    own, robust = [], []
    for seed in range(40):
        it = spring(400 + seed, 800)
        found = fitted(it)
        evidence = robust_evidence(it, found)
        assert not evidence.scores[PRESENT].any()
        assert not evidence.limits[PRESENT].any()
        _, _, information, blocks = weighed
        robust.append(evidence.scores[ABSENT])
        own.append(weigh(it, found, information, blocks.sum(axis=0)[None]).scores[ABSENT])
    own, robust = np.array(own), np.array(robust)
    # 240 scores: a share of 5 % has standard deviation 1.4 %, their mean one of 0.09, correlation apart.
    assert own.mean() == pytest.approx(1.0, abs=0.3)
    assert np.mean(own > 3.84) == pytest.approx(0.05, abs=0.035)
    assert np.mean(own < 0.455) == pytest.approx(0.5, abs=0.1)
    # The larger of two variances: never above the model's own, at most a few points below.
    assert np.all(robust <= own * (1 + 1e-9))
    assert 0.01 < np.mean(robust > 3.84) < 0.085


def test_a_missing_strong_term_scores_above_its_price_on_a_short_record():
    it = spring(0)
    lacks = fitted(it, LINEAR * np.where(np.arange(len(LINEAR)) == 2, 0.0, 1.0), np.array([0, 1, 4]))
    fall = lacks.cost - fitted(it).cost
    assert fall > 20.0 * it.penalty[2]
    assert robust_evidence(it, lacks).scores[2] > it.penalty[2]
