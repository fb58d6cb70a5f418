"""Bursts in records: what is left of these without, and the noise there."""

from dataclasses import replace

import numpy as np
import pytest

from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.bursts import without_bursts
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals

PERIOD, NOISE = 0.1, 0.02
T = PERIOD * np.arange(4000)
AT = (60.0, 150.0, 290.0)  # seconds of the bursts


def recorded(seed, height):
    """Slow waves, with bursts of a few samples, and white noise."""
    x = np.sin(0.2 * T) + sum(height * np.exp(-(((T - at) / 0.15) ** 2)) for at in AT)
    noise = NOISE * np.random.default_rng(seed).standard_normal((2, len(T)))
    return Records.of(Record(T, (np.array([x, np.cos(0.13 * T)]) + noise).T, ("x", "y")))


def signals_of(records):
    return estimate_signals(records, [Coordinate(name, 1) for name in records.names], (), Spectral())


def between(records):
    return without_bursts(signals_of(records), records, signals_of)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_between_bursts_is_kept_with_the_noise_there(seed):
    records = recorded(seed, 20.0)
    assert signals_of(records).channels[0].noise > 3.0 * NOISE  # in a spectrum bursts look like noise
    kept, pieces = between(records)
    assert [c.noise for c in kept.channels] == pytest.approx([NOISE, NOISE], rel=0.1)
    assert len(kept.columns) == len(pieces) == len(AT) + 1
    assert pieces.samples > 0.9 * records.samples
    for at in AT:
        assert not any(run.t[0] <= at <= run.t[-1] for run in pieces)


def test_pieces_hold_the_samples_of_the_record_at_their_times():
    records = recorded(0, 20.0)
    _, pieces = between(records)
    for run in pieces:
        there = np.searchsorted(T, run.t - 1e-9)
        np.testing.assert_array_equal(run.t, T[there])
        np.testing.assert_array_equal(run.values, records.runs[0].values[there])
        assert np.all(np.diff(there) == 1)


def test_a_record_of_less_noise_beside_another_hides_no_burst():
    quiet = recorded(1, 0.0).runs[0]
    quiet = replace(quiet, values=np.array([np.sin(0.2 * T), np.cos(0.13 * T)]).T)
    quiet = replace(quiet, values=quiet.values + 0.001 * np.random.default_rng(5).standard_normal(quiet.values.shape))
    _, pieces = between(Records.of([recorded(0, 20.0).runs[0], quiet]))
    assert len(pieces) == len(AT) + 2
    assert len(pieces.runs[-1]) > 0.95 * len(T)


@pytest.mark.parametrize("height", [0.0, 0.01])
def test_a_record_without_bursts_has_none(height):
    assert between(recorded(1, height)) is None


def test_noise_that_goes_with_the_signal_is_no_burst():
    rng = np.random.default_rng(2)
    x = 2.0 + np.sin(0.2 * T)
    records = Records.of(Record(T, (x * (1.0 + 0.05 * rng.standard_normal(len(T))))[:, None], ("x",)))
    assert between(records) is None


def test_what_bursts_all_the_time_has_no_exceptions():
    records = recorded(3, 0.0)
    x = records.runs[0].values.copy()
    x[:, 0] += 20.0 * (np.mod(T, 10.0) < 0.4)
    assert between(Records.of(replace(records.runs[0], values=x))) is None
