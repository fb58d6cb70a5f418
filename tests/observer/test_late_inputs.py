"""Inputs that act late: readings from before the first of them was recorded say nothing of the states."""

import numpy as np
import pytest
from built_models import build

from odescope.model.simulation import simulate
from odescope.observer.estimate import estimate_states
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record
from odescope.validation.validate import STEP, validate

PERIOD, NOISE = 0.01, 1e-3


def log_that_begins_late(damping, delay, begin=511, samples=800, seed=3):
    """A model, a record that begins while the machine runs under an input that acts late, and the true states."""
    rng = np.random.default_rng(seed)
    model = build(
        [Coordinate("x", order=2, unit="m")],
        [Input("u", hold="zero", delay=delay)],
        [("x_ddot", "1", 1.0), (None, "x", 4.0), (None, "x_dot", damping), (None, "u", -1.0)],
    )
    t, u = PERIOD * np.arange(begin + samples), np.repeat(rng.uniform(-2.0, 2.0, (begin + samples) // 20 + 1), 20)
    u = u[: len(t)]
    states = simulate(model, t, {"u": u}, [0.3, 0.0]).states
    read = states[:, 0] + NOISE * rng.standard_normal(len(t))
    return model, Record(t[begin:], np.column_stack([read, u])[begin:], ("x", "u")), states[begin:]


@pytest.mark.parametrize("smooth", [False, True], ids=["filter", "smoother"])
@pytest.mark.parametrize("damping", [0.3, 20.0])
def test_what_acted_before_the_log_began_spoils_no_state(damping, smooth):
    """A machine of much damping forgets its start within the delay, but not the input that was not recorded."""
    model, record, truth = log_that_begins_late(damping, delay=0.4)
    found = estimate_states(model, record, {"x": NOISE}, {}, smooth)
    (run,) = found.runs
    assert np.all(np.isnan(run.innovations[:40]))
    assert np.all(np.isfinite(run.innovations[41:]))
    off = (run.states - truth) / run.std
    assert np.abs(off[:41]).max() < 2.0
    assert np.abs(off[41:]).max() < 4.5
    assert np.all(np.abs(run.states - truth)[run.settling :, 0] < 3.0 * NOISE)
    assert 41 < run.settling < 300
    assert found.consistency.squared == pytest.approx(1.0, abs=0.15)


def test_one_step_predictions_begin_where_the_inputs_are_known():
    model, record, _ = log_that_begins_late(damping=0.3, delay=0.4)
    (row,) = [row for row in validate(model, record, {"x": NOISE}).rows if row.prediction == STEP]
    assert row.rmse == pytest.approx(NOISE, rel=0.2)
