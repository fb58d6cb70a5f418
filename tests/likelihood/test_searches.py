"""Searches that have nothing to begin from."""

import numpy as np
from small_systems import SPRING, SPRING_STEP, drive, shots, spring_run

from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import from_nothing, joined

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
