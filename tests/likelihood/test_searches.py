"""Searches that have nothing to begin from, and starts that are worth a search."""

from dataclasses import replace

import numpy as np
from small_systems import SPRING, SPRING_STEP, drive, shots, spring_run

from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.search import WIDTHS, search
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import from_nothing, joined, worth_it

NOISE, SPREAD = 2e-3, np.array([1e-3, 5e-3])


def test_a_search_from_bare_targets_finds_the_law():
    data = shots(spring_run(SPRING.theta), drive(), SPRING_STEP, NOISE, np.random.default_rng(1), SPREAD)
    space = SearchSpace(Evaluator(data, 2), SPRING.mechanisms, SPRING.frame)
    found = from_nothing(space)
    assert found is not None
    assert joined(found)
    assert found.fit.present.tolist() == np.flatnonzero(SPRING.theta).tolist()
    off = np.abs(found.fit.theta - SPRING.theta)[found.fit.free]
    assert np.all(off < 4.0 * np.sqrt(found.fit.variances))


def clear_end(space, theta):
    """Return the end of a search from here as it is where the noise was taken for twice what it is."""
    found = search(space, theta)
    assert found is not None
    return replace(found, scale=0.2, width=WIDTHS[-1])


def test_after_a_clear_end_only_shorter_starts_are_searched_from_and_only_where_the_noise_is_less_than_thought():
    data = shots(spring_run(SPRING.theta), drive(), SPRING_STEP, NOISE, np.random.default_rng(1), SPREAD)
    space = SearchSpace(Evaluator(data, 2), SPRING.mechanisms, SPRING.frame)
    found = clear_end(space, SPRING.theta)
    short, long = np.zeros(len(SPRING.theta)), np.ones(len(SPRING.theta))
    short[np.flatnonzero(SPRING.theta)[:2]] = 1.0
    assert [s is short for s in worth_it(space, found, [long, short])] == [True]
    assert worth_it(space, replace(found, scale=0.9), [long, short]) == []
