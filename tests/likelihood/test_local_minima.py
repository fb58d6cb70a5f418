"""A joined trajectory that hangs above the lowest minimum of its cost is opened and joined again."""

from dataclasses import replace

import numpy as np
import pytest
from small_systems import SPRING, SPRING_STEP, drive, shots, spring_run

from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.local_minima import joined_again
from odescope.likelihood.search import fitted_again, search
from odescope.likelihood.search_space import SearchSpace


@pytest.fixture(scope="module")
def spring():
    spread = np.array([1e-3, 5e-3])
    data = shots(spring_run(SPRING.theta), drive(), SPRING_STEP, 2e-3, np.random.default_rng(1), spread)
    space = SearchSpace(Evaluator(data, 2), SPRING.mechanisms, SPRING.frame)
    return space, search(space, SPRING.theta)


def test_what_is_at_the_lowest_minimum_stays_as_it_is(spring):
    space, best = spring
    assert joined_again(space, best) == (space, best)


def test_what_hangs_above_it_comes_down_with_the_same_terms(spring):
    space, best = spring
    width = space.segments.spread * best.width
    off = best.fit.theta.copy()
    off[best.fit.free] *= 1.0 + 0.02 * np.arange(len(best.fit.free))
    hung = space.again(replace(best.fit, theta=off), best.fit.x0, width, iterations=0)
    assert hung.cost > best.fit.cost + 10.0
    _, end = joined_again(space, fitted_again(space, best, hung))
    assert end.fit.present.tolist() == best.fit.present.tolist()
    assert end.fit.cost == pytest.approx(best.fit.cost, abs=0.1)
    assert end.price == pytest.approx(best.price, rel=1e-6)
