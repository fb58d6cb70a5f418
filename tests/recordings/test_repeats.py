"""Values that a sensor did not measure anew, and those that are the same by their resolution or at rest."""

import numpy as np
import pytest

from odescope.recordings.gaps import RawRun
from odescope.recordings.repeats import stale
from odescope.recordings.uniform import uniform

T = 0.01 * np.arange(3000)
MOTION = np.sin(T) + 0.5 * np.sin(2.3 * T + 1.0)


def noisy(seed, size=0.003):
    return MOTION + size * np.random.default_rng(seed).standard_normal(len(T))


def repeated(values, seed, late, share=0.02):
    """Return values of which some repeat the last one before them or, taken backwards, after them; and which."""
    rng, order = np.random.default_rng(seed), slice(None, None, 1 if late else -1)
    fresh = np.ones(len(values), dtype=bool)
    fresh[rng.choice(np.arange(1, len(values) - 1), round(share * len(values)), replace=False)] = False
    last = np.maximum.accumulate(np.where(fresh[order], np.arange(len(values)), 0))
    return values[order][last][order], ~fresh


@pytest.mark.parametrize("late", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_rows_that_hold_the_value_of_another_are_told_from_those_that_measured_it(seed, late):
    values, wrong = repeated(noisy(seed), seed, late)
    assert stale(values)[wrong].mean() > 0.95
    assert not stale(values)[~wrong].any()


@pytest.mark.parametrize("digits", [2, 3, 4])
def test_what_is_the_same_by_its_resolution_stays(digits):
    assert not stale(np.round(noisy(4), digits)).any()
    assert not stale(np.round(MOTION, digits)).any()


def test_what_rests_and_creeps_stays():
    stopping = np.maximum(1.0 - T, 0.0) ** 2
    assert not stale(stopping).any()
    assert not stale(np.round(stopping, 3)).any()
    assert not stale(np.repeat(noisy(5)[::10], 10)).any()


def test_on_even_times_a_repeated_value_repeats_its_neighbour_still():
    values, wrong = repeated(noisy(6), 6, True)
    t = T + 0.003 * np.random.default_rng(7).uniform(-1.0, 1.0, len(T))
    record, points = uniform(RawRun(t, values[:, None], ("x",), (None,), "", np.arange(len(t)), ("x",)))
    found = stale(record.column("x"))[points]
    assert found[wrong].mean() > 0.9
    assert found[~wrong].mean() < 0.001
