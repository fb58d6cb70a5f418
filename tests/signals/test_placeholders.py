"""A number that a log holds where nothing was read does not count; values that a signal has by itself do."""

import numpy as np
import pytest
from test_gate import NOISE, X, motion

from odescope.model.gate import gated_scores
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals
from odescope.signals.filling import filled
from odescope.signals.gated import reasons_of
from odescope.signals.placeholders import placeholder, without_placeholders


def records_of(t, *columns):
    return Records.of(Record(t, x[:, None], ("x",)) for x in columns)


@pytest.mark.parametrize("share", [0.01, 0.2, 0.6])
@pytest.mark.parametrize("value", [0.0, -999.0, 0.3])
def test_what_stands_for_no_reading_does_not_count_and_the_motion_is_found(value, share):
    rng = np.random.default_rng(1)
    t, x = motion()
    lost = rng.random(len(t)) < share
    recorded = np.where(lost, value, x + NOISE * rng.standard_normal(len(t)))
    before = records_of(t, recorded, x)
    assert placeholder([run.column("x") for run in before]) == value
    after = filled(Records.of(without_placeholders(run, {"x": value}) for run in before), X, Spectral())
    gone = after.runs[0].counted("x") == 0.0
    np.testing.assert_array_equal(gone, lost)
    signals = estimate_signals(Records(after.runs[:1]), X, (), Spectral(), decimate=False)
    begin = round(signals.start[0] / (t[1] - t[0]))
    found = signals.columns[0][0]
    assert np.sqrt(np.mean((found - x[begin : begin + len(found)]) ** 2)) < NOISE
    (score,) = gated_scores(before, reasons_of(before, after, X, {"x": value}))["x"]
    assert (score.reason, score.samples) == ("placeholder", int(lost.sum()))


def own_values():
    rng = np.random.default_rng(2)
    t, x = motion()
    noisy = x + NOISE * rng.standard_normal(len(t))
    return {
        "clean": x,
        "noisy": noisy,
        "encoder": 0.01 * np.round(noisy / 0.01),
        "coarse encoder": 0.3 * np.round(noisy / 0.3),
        "switch": np.sign(x),
        "at rest": np.where((t > 5.0) & (t < 12.0), 0.5, noisy),
        "rests often": np.where(np.sin(t) > 0.5, 0.0, noisy * np.clip(0.5 - np.sin(t), 0.0, 0.2)),
        "end of the range": np.minimum(noisy, 0.9),
        "few": np.where(np.arange(len(t)) % 1600 == 7, 0.0, noisy),
    }


@pytest.mark.parametrize("name", own_values())
def test_values_that_a_signal_has_by_itself_count(name):
    assert placeholder([own_values()[name]]) is None
