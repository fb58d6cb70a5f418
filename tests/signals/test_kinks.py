"""Samples where a signal turns fast are no outliers: what follows a step, few samples, recordings that decay."""

import numpy as np
import pytest

from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.gated import gated_records
from odescope.signals.outliers import gate_outliers


def lag(u, share, start):
    """Return a lag of first order behind an input that goes so far in a sample."""
    y = np.full(len(u), start)
    for k in range(1, len(u)):
        y[k] = y[k - 1] + share * (u[k - 1] - y[k - 1])
    return y


@pytest.mark.parametrize("seed", range(6))
def test_what_follows_a_step_in_few_samples_is_no_outlier_and_a_wrong_sample_is(seed):
    rng, count = np.random.default_rng(seed), 2000
    u = np.repeat(rng.uniform(0.7, 2.0, 40), 50)
    y = lag(u, rng.uniform(0.3, 0.6), u[0]) + 0.005 * rng.standard_normal(count)
    wrong = 50 * np.arange(1, 40, 4) + rng.integers(12, 40, 10)  # where it has come to rest
    y[wrong] += rng.choice((-0.2, 0.2), len(wrong))
    run = Record(0.1 * np.arange(count), np.column_stack([y, u]), ("y", "u"))
    (found,) = gate_outliers(Records.of(run), (Coordinate("y", 1),), Spectral())
    assert np.flatnonzero(found.counted("y") == 0.0).tolist() == sorted(wrong.tolist())


@pytest.mark.parametrize("seed", range(6))
def test_a_channel_with_a_cell_now_and_then_has_no_outliers_where_it_turns(seed):
    rng, count = np.random.default_rng(seed), 1200
    u = np.repeat(rng.uniform(0.2, 2.5, 10), 120)
    y = lag(u, 0.12, u[0])
    read = y + 0.04 * rng.standard_normal(count)
    read[600] += 1.0
    counts = np.ones((count, 2))
    counts[np.arange(count) % 4 != 0, 0] = 0.0
    read[counts[:, 0] == 0.0] = 0.0
    run = Record(0.1 * np.arange(count), np.column_stack([read, u]), ("y", "u"), counts=counts)
    _, reasons = gated_records(Records.of(run), (Coordinate("y", 1),), Spectral())
    assert np.flatnonzero(reasons["y"][0]).tolist() == [600]


@pytest.mark.parametrize("seed", range(6))
def test_a_recording_in_which_the_signal_vanishes_has_no_outliers_where_it_is_large(seed):
    rng, t = np.random.default_rng(seed), 0.2 * np.arange(100)
    signals = [3.0 / (1.0 + np.exp(0.9 * t - 3.6)), 8.0 - 2.0 * np.cos(0.7 * t), 8.0 + 1.5 * np.cos(0.5 * t)]
    read = [s * (1.0 + 0.03 * rng.standard_normal(len(t))) for s in signals]
    read[1][50] += 2.0
    runs = Records.of(Record(t, y[:, None], ("y",)) for y in read)
    found = gate_outliers(runs, (Coordinate("y", 1),), Spectral())
    assert [np.flatnonzero(run.counted("y") == 0.0).tolist() for run in found] == [[], [50], []]
