"""Inputs that step by a clock of their own: when, beside clocks that are known."""

import numpy as np
import pytest

from odescope.recordings.clocks import times_by_clock


def shown(times):
    """Return the last sample before each step (S,), of times in samples: a step at a sample shows there."""
    return np.ceil(times - 1e-9).astype(np.int64) - 1


@pytest.mark.parametrize("every", [2.2, 0.37, 1.0, 0.47, 5.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_clock_that_begins_with_the_log_is_found_though_ticks_lack(every, seed):
    rng = np.random.default_rng(seed)
    ticks = np.arange(1, 60)[rng.random(59) < 0.7]
    times = ticks * every / 0.03
    found = times_by_clock(shown(times), 0.03)
    assert found is not None
    np.testing.assert_allclose(found, times, atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_a_clock_of_any_period_and_beginning_is_found_to_within_what_samples_show(seed):
    rng = np.random.default_rng(seed)
    every = rng.uniform(9.0, 60.0)
    times = every * (rng.random() + np.arange(40))
    found = times_by_clock(shown(times), 0.01)
    assert found is not None
    assert np.array_equal(shown(found), shown(times))
    assert np.abs(found - times).max() < 0.25


@pytest.mark.parametrize("seed", range(20))
def test_steps_at_any_times_and_steps_at_samples_are_of_no_clock_between_samples(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 60))
    assert times_by_clock(shown(np.cumsum(30.0 * rng.uniform(0.7, 1.3, count))), 0.1) is None
    assert times_by_clock(np.cumsum(17 * rng.integers(1, 4, count)), 0.1) is None
    assert times_by_clock(np.cumsum(rng.integers(8, 30, count)), 0.1) is None


def test_a_few_steps_are_of_no_clock():
    assert times_by_clock(shown(8.3 * np.arange(1, 6)), 0.1) is None
    assert times_by_clock(np.zeros(0, dtype=np.int64), 0.1) is None
