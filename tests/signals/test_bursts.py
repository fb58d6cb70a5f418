"""Bursts in records: what is left of these without, and the noise there."""

from dataclasses import replace

import numpy as np
import pytest

from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.bursts import SHORTEST, without_bursts
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals

PERIOD, NOISE = 0.1, 0.02
T = PERIOD * np.arange(4000)
AT = (60.0, 150.0, 290.0)  # seconds of the bursts


def recorded(seed, height, period=PERIOD, count=4000):
    """Slow waves, with bursts of a few samples, and white noise."""
    t = period * np.arange(count)
    x = np.sin(0.2 * t) + sum(height * np.exp(-((t - at) / 0.15) ** 2) for at in AT)
    y = np.cos(0.13 * t)
    noise = NOISE * np.random.default_rng(seed).standard_normal((2, count))
    return Records.of(Record(t, (np.array([x, y]) + noise).T, ("x", "y")))


def signals_of(records):
    return estimate_signals(records, (Coordinate("x", 1), Coordinate("y", 1)), (), Spectral())


@pytest.mark.parametrize("seed", range(5))
def test_what_is_between_bursts_is_kept_with_the_noise_there(seed):
    records = recorded(seed, 20.0)
    signals = signals_of(records)
    assert signals.channels[0].noise > 3.0 * NOISE  # the filter takes bursts for noise
    kept, pieces = without_bursts(signals, records)
    assert kept.channels[0].noise == pytest.approx(NOISE, rel=0.15)
    assert kept.channels[1] == signals.channels[1]
    assert len(kept.columns) == len(kept.start) == len(pieces) == len(AT) + 1
    assert kept.samples > 0.8 * signals.samples
    for at in AT:
        assert not any(run.t[0] <= at <= run.t[-1] for run in pieces)


def test_pieces_hold_the_samples_and_signals_of_the_record_at_their_times():
    records = recorded(0, 20.0)
    signals = signals_of(records)
    kept, pieces = without_bursts(signals, records)
    stride = round(signals.period / PERIOD)
    for run, start, columns in zip(pieces, kept.start, kept.columns, strict=True):
        assert run.t[0] == pytest.approx(start)
        assert len(run) in range((columns.shape[1] - 1) * stride + 1, columns.shape[1] * stride + 1)
        assert columns.shape[1] >= SHORTEST
        there = np.searchsorted(T, run.t - 1e-9)
        np.testing.assert_array_equal(run.values, records.runs[0].values[there])
        before = round((start - signals.start[0]) / signals.period)
        np.testing.assert_array_equal(columns, signals.columns[0][:, before : before + columns.shape[1]])


@pytest.mark.parametrize("height", [0.0, 0.01])
def test_a_record_without_bursts_has_none(height):
    records = recorded(1, height)
    assert without_bursts(signals_of(records), records) is None


def test_noise_that_goes_with_the_signal_is_no_burst():
    rng = np.random.default_rng(2)
    x = 2.0 + np.sin(0.2 * T)
    records = Records.of(Record(T, (x * (1.0 + 0.05 * rng.standard_normal(len(T))))[:, None], ("x",)))
    assert without_bursts(estimate_signals(records, (Coordinate("x", 1),), (), Spectral()), records) is None


def test_what_bursts_all_the_time_has_no_exceptions():
    records = recorded(3, 0.0)
    x = records.runs[0].values.copy()
    x[:, 0] += 20.0 * (np.mod(T, 10.0) < 0.4)
    every = Records.of(replace(records.runs[0], values=x))
    assert without_bursts(signals_of(every), every) is None
