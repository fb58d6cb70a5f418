"""What each sample is that the gate takes out: what was done to it tells what it should be called."""

import numpy as np
from test_gate import X, motion

from odescope.model.gate import gated_scores
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.gated import REASONS, gated_records, reasons_of
from odescope.signals.outliers import gate_outliers


def test_samples_are_called_what_was_done_to_them():
    rng = np.random.default_rng(7)
    t, x = motion()
    x = np.minimum(x + 1e-4 * rng.standard_normal(len(t)), 1.1)
    struck = rng.permutation(np.flatnonzero(np.abs(np.gradient(x)) > 0.02)[2::5])
    late, repeated, far = np.split(struck[:120], 3)
    measured = x.copy()
    measured[late] = 0.5 * (x[late - 1] + x[late])
    measured[repeated] = x[repeated - 1]
    measured[far] += rng.choice([-1.0, 1.0], len(far)) * rng.uniform(0.3, 0.6, len(far))
    measured = np.minimum(measured, 1.1)
    before = Records.of(Record(t, measured[:, None], ("x",)))
    after = gate_outliers(before, X, Spectral())
    reasons = reasons_of(before, after, X, {})
    (reason,), scores = reasons["x"], gated_scores(before, reasons)["x"]
    for k, where in ((1, np.flatnonzero(x == 1.1)), (2, repeated), (3, late), (4, far)):
        assert np.mean(reason[where] == k) > 0.9, REASONS[k - 1]
    assert np.array_equal(reason > 0, after.runs[0].counted("x") == 0.0)
    done = REASONS[:4]
    assert {s.reason: s.samples for s in scores} == {r: int(np.sum(reason == k)) for k, r in enumerate(done, 1)}


def test_a_coordinate_that_was_never_measured_leaves_the_others_to_be_gated():
    t, x = motion()
    far = [200, 201, 640]
    x = x + 0.01 * np.random.default_rng(3).standard_normal(len(t))
    x[far] += 0.8
    counts = np.column_stack([np.ones(len(t)), np.zeros(len(t))])
    run = Record(t, np.column_stack([x, np.zeros(len(t))]), ("x", "lost"), counts=counts)
    after, reasons = gated_records(Records.of(run), [*X, Coordinate("lost", order=2)], Spectral())
    assert np.flatnonzero(after.runs[0].counted("x") == 0.0).tolist() == far
    assert not reasons["lost"][0].any()
