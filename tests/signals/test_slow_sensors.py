"""Values that a slow sensor repeats do not count; those that an encoder repeats do."""

import numpy as np
import pytest
from test_gate import X, motion

from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals
from odescope.signals.filling import filled
from odescope.signals.slow_sensors import without_repeats


def counted(t, x):
    records = without_repeats(Records.of(Record(t, x[:, None], ("x",))), X)
    return records.runs[0].counted("x") > 0.0, records


@pytest.mark.parametrize("rows", [2.0, 5.0, 10.0 / 3.0])
@pytest.mark.parametrize("step", [0.0, 0.002])
def test_the_first_row_of_each_value_counts_and_the_motion_is_found(rows, step):
    rng = np.random.default_rng(1)
    t, x = motion()
    first = np.unique(np.ceil(rows * np.arange(int(len(t) / rows))).astype(int))
    noisy = x + 0.002 * rng.standard_normal(len(t))
    noisy = step * np.round(noisy / step) if step else noisy
    held = noisy[first[np.searchsorted(first, np.arange(len(t)), side="right") - 1]]
    there, records = counted(t, held)
    assert np.mean(np.isin(np.flatnonzero(there), first)) == 1.0
    assert there.sum() > 0.85 * len(first)  # by chance two values in turn are the same
    filtered = filled(records, X, Spectral())
    signals = estimate_signals(filtered, X, (), Spectral(), decimate=False)
    begin = round(signals.start[0] / (t[1] - t[0]))
    found = signals.columns[0][0]
    inner = slice(20, -20)  # behind the last new value there is nothing to go by
    assert np.sqrt(np.mean((found - x[begin : begin + len(found)])[inner] ** 2)) < 0.002


@pytest.mark.parametrize("step", [2 * np.pi / 200, 0.3])
def test_an_encoder_that_moves_slowly_keeps_all_its_rows(step):
    t, x = motion()
    assert counted(t, step * np.round(x / step))[0].all()
    assert counted(t, step * np.round(2.0 * t / step))[0].all()  # a regular rhythm, but steps of one size


def test_a_value_that_a_row_holds_once_more_does_not_count():
    t, x = motion()
    measured = x + 0.002 * np.random.default_rng(2).standard_normal(len(t))
    measured[10::10] = measured[9:-1:10]
    there = counted(t, measured)[0]
    assert there[np.arange(len(t)) % 10 != 0].all()
    assert there[10::10].mean() < 0.05  # in rows where its neighbours are the same to the last digits it does
