"""What searches do not see: parts of records that are there."""

from dataclasses import replace

import numpy as np
import pytest
from small_systems import SPRING, SPRING_STEP, drive, shots, spring_run

from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.held_out import free_run_errors, held_out
from odescope.likelihood.search import search
from odescope.likelihood.search_space import SearchSpace

NOISE, SPREAD = 2e-4, np.array([1e-4, 5e-4])


@pytest.fixture(scope="module")
def space():
    data = shots(spring_run(SPRING.theta), drive(), SPRING_STEP, NOISE, np.random.default_rng(1), SPREAD)
    return SearchSpace(Evaluator(data, 2), SPRING.mechanisms, SPRING.frame)


@pytest.mark.parametrize("last", [1, 3, 4])
def test_a_record_of_a_few_averages_beside_others_is_not_held_out(space, last):
    count = len(space.segments.filtered)
    both = space.on(replace(space.segments, runs=((0, count - last), (count - last, count))))
    parts = held_out(both.segments)
    assert all(low < high for low, high in parts)
    assert all(high <= count - last for _, high in parts)
    errors = free_run_errors(both, SPRING.theta)
    assert np.all((errors > 0.0) & (errors < 0.01))


def test_joined_segments_of_a_record_have_one_initial_state(space):
    found = search(space, SPRING.theta)
    assert np.isfinite(found.width)
    taken = len(space.segments.runs) * found.fit.x0.shape[1] + len(found.fit.free)
    assert found.scale == pytest.approx(found.fit.data_cost / (space.segments.samples - taken), rel=1e-12)
