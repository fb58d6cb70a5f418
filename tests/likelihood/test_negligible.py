"""Terms that are next to nothing go where their case is thin, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from small_systems import SPRING, SPRING_STEP, drive, shots, spring_run

from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.negligible import contributions, one_less, without_negligible
from odescope.likelihood.search import search
from odescope.likelihood.search_space import SearchSpace

NOISE, SPREAD = 2e-4, np.array([1e-4, 5e-4])
SQUARE = 5  # x^2


def space(theta, quieter=1.0):
    rng = np.random.default_rng(1)
    data = shots(spring_run(theta), drive(), SPRING_STEP, NOISE / quieter, rng, SPREAD / quieter)
    return SearchSpace(Evaluator(data, 2), SPRING.mechanisms, SPRING.frame)


def ended(square, quieter=1.0):
    """Return the space of a spring with so much of x^2, and the end of a search that has x^2 whatever it earns."""
    theta = SPRING.theta.copy()
    theta[SQUARE] = square
    it = space(theta, quieter)
    found = search(it, theta)
    present = np.union1d(found.fit.present, [SQUARE])
    fit = it.fit(found.fit.theta, present, found.fit.x0, it.segments.spread * found.width, found.fit.strength)
    return it, replace(found, fit=fit)


def test_contributions_are_the_sizes_of_the_terms_over_the_largest():
    it = space(SPRING.theta)
    x, v = it.segments.filtered.T
    u = it.segments.inputs[:, 0, 0]
    a = -(4.0 * x + 0.5 * v + 0.8 * x**3 - u)
    sizes = [np.sqrt(np.mean(term**2)) for term in (a, 4.0 * x, 0.5 * v, 0.8 * x**3, u)]
    np.testing.assert_allclose(contributions(it, SPRING.theta)[:5], sizes / np.max(sizes), rtol=0.02)
    assert not contributions(it, SPRING.theta)[5:].any()


def test_parts_that_cancel_are_no_large_term():
    """Two shafts that have turned far are held together by little."""
    it = space(SPRING.theta)
    x, v = it.segments.filtered.T
    (place,) = it.mechanisms[1].parts
    (speed,) = it.mechanisms[2].parts
    both = replace(it.mechanisms[1], parts=(place, replace(place, share=-0.9), speed))
    found = contributions(it.among([it.mechanisms[0], both, *it.mechanisms[2:]]), SPRING.theta)
    sizes = [np.sqrt(np.mean(term**2)) for term in (4.0 * (0.1 * x + v), 0.5 * v)]
    assert found[1] / found[2] == pytest.approx(sizes[0] / sizes[1], rel=1e-6)


def test_where_one_recording_ends_and_another_begins_nothing_moves():
    it = space(SPRING.theta)
    whole, count = it.segments, len(it.segments.filtered)
    jumped = whole.filtered + np.where(np.arange(count) < count // 2, 0.0, 5.0)[:, None]
    halves = replace(whole, filtered=jumped, runs=((0, count // 2), (count // 2, count)))
    acceleration = np.gradient(whole.filtered[:, 1], whole.step)
    cube = 0.8 * np.sqrt(np.mean(jumped[:, 0] ** 6))
    size = contributions(it.on(halves), SPRING.theta)[0]
    assert size == pytest.approx(np.sqrt(np.mean(acceleration**2)) / cube, rel=0.02)


def test_a_term_that_nothing_asks_for_goes():
    it, outcome = ended(0.0)
    assert SQUARE in outcome.fit.present
    lean = without_negligible(it, outcome)
    assert lean.fit.present.tolist() == [0, 1, 2, 3, 4]
    assert lean.trail[-1].action == "drop"
    assert lean.price < it.price(outcome.fit)


@pytest.mark.parametrize("square", [3e-3, 0.05])
def test_a_term_with_a_case_stays_however_small(square):
    """The smaller one makes less than a thousandth, and stands at many standard errors."""
    it, outcome = ended(square)
    assert contributions(it, outcome.fit.theta)[SQUARE] < 0.03
    lean = without_negligible(it, outcome)
    assert SQUARE in lean.fit.present
    assert lean.fit.theta[SQUARE] / lean.fit.theta[0] == pytest.approx(square, rel=0.1)


def test_the_statistics_that_are_given_decide_whose_case_is_thin():
    """Under process noise they are those between blocks of the record."""
    it, outcome = ended(0.0)
    here, defect_std = outcome.fit, it.segments.spread * outcome.width
    thin = np.where(here.free == SQUARE, 0.0, np.inf)
    leaner = one_less(it, here, thin, defect_std)
    assert leaner is not None
    assert leaner[1:] == (SQUARE, 0.0)
    assert SQUARE not in leaner[0].present
    assert one_less(it, here, np.full_like(thin, np.inf), defect_std) is None


@pytest.mark.parametrize(("square", "quieter", "stays"), [(1e-5, 20.0, False), (1e-4, 100.0, True), (1e-5, 1e4, True)])
def test_what_no_sensor_resolves_goes_however_sure_it_is_unless_free_runs_show_it(square, quieter, stays):
    it, outcome = ended(square, quieter)
    sure, defect_std = np.full(len(outcome.fit.free), np.inf), it.segments.spread * outcome.width
    assert (contributions(it, outcome.fit.theta)[SQUARE] < 1e-5) == (square == 1e-5)
    leaner = one_less(it, outcome.fit, sure, defect_std)
    assert (leaner is None) == stays
