"""Which rows of a regular clock were lost, against logs whose rows are numbered by hand."""

import numpy as np
import pytest

from odescope.recordings.lost_rows import sample_numbers

COUNT, PERIOD = 3000, 0.005


def log(seed, clock, sampling, lost, drift=0.0):
    """Return stamps in seconds and the true number of each row.

    Samples are taken up to `sampling` periods beside a regular time, and stamps read with a normal error of `clock`.
    """
    rng = np.random.default_rng(seed)
    taken = np.arange(COUNT) + rng.uniform(-sampling, sampling, COUNT) + drift * np.sin(np.arange(COUNT) / 300.0)
    stamps = taken + np.clip(clock * rng.standard_normal(COUNT), -0.45, 0.45)
    kept = np.flatnonzero(rng.random(COUNT) >= lost)
    order = np.argsort(stamps[kept], kind="stable")
    return PERIOD * (stamps[kept][order] - stamps[kept[0]]), kept[order]


def wrong(found, true):
    """Return which rows have another number than theirs, but for where counting begins."""
    off = (found - found[0]) - (true - true[0])
    return off != np.median(off)


@pytest.mark.parametrize(
    ("clock", "sampling", "lost", "most"),
    [
        (1e-4, 0.0, 0.05, 0.0),
        (1e-4, 0.0, 0.3, 0.0),
        (0.1, 0.1, 0.05, 0.001),
        (0.1, 0.1, 0.3, 0.01),
        (0.15, 0.15, 0.05, 0.002),
        (0.15, 0.15, 0.3, 0.02),
        (0.2, 0.3, 0.002, 0.02),
        (0.2, 0.3, 0.05, 0.03),
    ],
)
def test_rows_keep_their_numbers_whatever_the_jitter(clock, sampling, lost, most):
    """Beside which of two neighbours a row is lost, jitter may hide; all later rows are counted right."""
    for seed in range(6):
        t, true = log(seed, clock, sampling, lost)
        found = sample_numbers(t)
        assert np.mean(wrong(found, true)) <= most
        assert abs(found[-1] - found[100] - (true[-1] - true[100])) <= 1


@pytest.mark.parametrize("drift", [0.3, 3.0])
def test_a_clock_that_drifts_is_followed(drift):
    t, true = log(0, 0.1, 0.1, 0.05, drift)
    assert np.mean(wrong(sample_numbers(t), true)) < 0.003


def test_no_row_is_lost_where_one_alone_comes_late():
    rng = np.random.default_rng(3)
    taken = np.arange(COUNT) + 0.02 * rng.standard_normal(COUNT)
    late = rng.choice(np.arange(20, COUNT - 20, 10), 40, replace=False)
    taken[late] += rng.uniform(0.3, 0.9, 40)
    taken[late[:10]] += 5.0
    stamps = np.maximum.accumulate(taken)  # what comes while one is late is read with it
    np.testing.assert_array_equal(sample_numbers(PERIOD * stamps), np.arange(COUNT))


def test_a_pause_of_no_whole_number_of_periods_moves_the_phase_alone():
    t = np.concatenate([np.arange(1000.0), 1007.4 + np.arange(1000.0)]) + 0.01 * np.random.default_rng(4).normal(
        size=2000
    )
    steps = np.diff(sample_numbers(PERIOD * t))
    assert steps[999] in (8, 9)  # 8.4 periods
    assert np.all(np.delete(steps, 999) == 1)
