"""Searches that have nothing to begin from, and what they hand on to process noise."""

import numpy as np
from process_cases import LINEAR, PRESENT, spring, white_kicks
from small_systems import SPRING, SPRING_STEP, drive, shots, spring_run

from odescope.events import Monitor
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import from_nothing, joined, searches
from odescope.parallel.workers import Threads

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


def test_what_follows_a_record_in_short_segments_alone_is_where_process_noise_begins():
    kicks = white_kicks(np.random.default_rng(3), np.array([1e-6, 0.015]), (1500,))
    it = spring(3, 1500, 0.002, kicks=kicks, believed=SPREAD)
    begun = [LINEAR * np.array([1.0, 0.5, 0, 0, 0.5, 0, 0, 0, 0, 0]), LINEAR]
    ends = searches(it.on(it.segments.cut_anew(25)), begun, None, Monitor(), Threads())
    assert not any(map(joined, ends))
    for (loose,) in (end.loose for end in ends):
        assert np.flatnonzero(loose).tolist() == PRESENT.tolist()
        assert np.abs(loose - LINEAR).max() < 0.2
