"""Searches that have nothing to begin from, starts that are worth one, and what is handed on to process noise."""

from dataclasses import replace

import numpy as np
import pytest
from process_cases import LINEAR, PRESENT, spring, white_kicks
from small_systems import SPRING, SPRING_STEP, drive, shots, spring_run

from odescope.events import Monitor
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.search import WIDTHS, search
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import from_nothing, joined, searches, worth_it
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


@pytest.mark.parametrize(("kick", "searched"), [(0.0, 1), (0.003, 1), (0.02, 2)])
def test_an_end_that_lacks_nothing_but_noise_of_the_process_is_the_last(kick, searched):
    """The law comes first, then a start without its damping. Without kicks it is clear, under hard ones not joined."""
    kicks = white_kicks(np.random.default_rng(3), np.array([1e-6, kick]), (2000,)) if kick else np.zeros((2000, 2))
    it = spring(3, 2000, 0.002, kicks=kicks, believed=SPREAD)
    undamped = np.where(np.arange(len(LINEAR)) == 2, 0.0, LINEAR)
    ends = searches(it.on(it.segments.cut_anew(25)), [LINEAR, undamped], None, Monitor(), Threads())
    assert len(ends) == searched
    assert joined(ends[0]) == (searched == 1)
    assert ends[0].clear == (kick == 0.0)
