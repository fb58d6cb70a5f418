"""The state at the first sample, from what was measured alone."""

import numpy as np
import pytest
from simulation_cases import X, build, free

from odescope.model.initial_state import initial_state
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record

TIME = 0.01 * np.arange(1500)
POSITION = build(
    [Coordinate("x", order=2)],
    [],
    [("x_ddot", "1", 1.0), (None, "x", 9.0), (None, "x_dot", 0.3)],
)
STARTS = [("x_dot", np.array([2.0]), build([X], [], [("x_dot", "1", 1.0), (None, "x", 0.5)]))]
STARTS += [("x_ddot", np.array([0.7, -1.5]), POSITION)]


@pytest.mark.parametrize(("target", "truth", "model"), STARTS, ids=lambda value: value if type(value) is str else "")
def test_values_that_nobody_measured_do_not_count(target, truth, model):
    rng = np.random.default_rng(3)
    clean = free(model, TIME, truth).column("x")
    measured = clean + 1e-3 * rng.standard_normal(len(TIME))
    lost = rng.random(len(TIME)) < 0.3
    lost[20:45] = True
    lost[0] = False
    measured[lost] = measured[lost] + 0.5  # whatever stands there
    counts = np.where(lost, 0.0, 1.0)[:, None]
    found = initial_state(model, Record(TIME, measured[:, None], ("x",), counts=counts))
    assert found == pytest.approx(truth, abs=5e-3)
    assert np.abs(initial_state(model, Record(TIME, measured[:, None], ("x",))) - truth).max() > 5e-2


def test_a_mean_of_several_samples_counts_as_much():
    model, truth = POSITION, np.array([0.7, -1.5])
    clean, rng = free(model, TIME, truth).column("x"), np.random.default_rng(4)
    counts = np.where(np.arange(len(TIME)) % 2 == 0, 1.0, 100.0)
    off = []
    for _ in range(8):
        x = (clean + 0.05 * rng.standard_normal(len(TIME)) / np.sqrt(counts))[:, None]
        runs = (Record(TIME, x, ("x",), counts=c) for c in (counts[:, None], None))
        off.append([np.abs(initial_state(model, run) - truth).max() for run in runs])
    known, unknown = np.mean(off, axis=0)
    assert known < unknown


@pytest.mark.parametrize("level", [0.0, 0.3])
def test_a_joint_that_reads_constant_leaves_the_others_their_fit(level):
    """Beside it the other's velocity is that of the equations, not that of a filter at the edge of a record."""
    plant = build(
        [Coordinate("x", order=2), Coordinate("y", order=2)],
        [],
        [("x_ddot", "1", 1.0), (None, "x", 40.0), (None, "x_dot", 0.5)],
        [("y_ddot", "1", 1.0), (None, "sign(y_dot)", 3.0), (None, "x", 0.01)],
    )
    truth = np.array([0.3, level, 2.0, 0.0])
    clean, rng = free(plant, TIME[:1000], truth), np.random.default_rng(0)
    read = np.column_stack([clean.column("x") + 0.05 * rng.standard_normal(1000), np.full(1000, level)])
    found = initial_state(plant, Record(TIME[:1000], read, ("x", "y")))
    assert found == pytest.approx(truth, abs=0.05)
    assert found[1] == pytest.approx(level, abs=1e-12)
    assert found[3] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_a_count_that_grows_from_next_to_nothing_does_not_begin_below_nothing(seed):
    """From a start below 0 it would fall without end; the noise of large counts says nothing of the first."""
    t, truth = 0.5 * np.arange(240), 30.0
    growth = build([X], [], [("x_dot", "1", 1.0), (None, "x", -0.2), (None, "x**2", 0.2 / 50_000.0)])
    clean = free(growth, t, np.array([truth])).column("x")
    noise = 0.02 * clean * np.random.default_rng(seed).standard_normal(len(t))
    (found,) = initial_state(growth, Record(t, (clean + noise)[:, None], ("x",)))
    assert found == pytest.approx(truth, rel=0.1)
