"""Rows that were lost just where a command stepped: nobody knows in which of them it did."""

import numpy as np
import pytest
from scipy.linalg import expm

from odescope import Data, Driven, Measured, Study, identify

LOST = [300, 630, 631, 900]  # where the command steps


def valve(seed, regular):
    """Return a log of x' = u - x/2 at half a per cent of noise, four rows lost; u steps about every 30 rows."""
    rng = np.random.default_rng(seed)
    steps = 30 * np.arange(41)
    if not regular:
        steps[1:-1] += np.where(np.isin(steps[1:-1], LOST), 0, rng.integers(-6, 7, 39))
    u, x = np.repeat(rng.uniform(-1.0, 1.0, 40), np.diff(steps)), np.zeros(1200)
    for k in range(len(x) - 1):
        x[k + 1] = 2.0 * u[k] + (x[k] - 2.0 * u[k]) * np.exp(-0.05)
    kept = np.setdiff1d(np.arange(len(x)), LOST)
    return {"t": 0.1 * kept, "x": (x + 0.005 * x.std() * rng.standard_normal(len(x)))[kept], "u": u[kept]}


@pytest.mark.parametrize("seed", [3, *(pytest.param(s, marks=pytest.mark.slow) for s in range(3))])
@pytest.mark.parametrize("regular", [False, True])
def test_steps_that_nobody_saw_are_not_taken_for_late(seed, regular):
    """Held until the next row a command is late at these steps: noise of the process, or four terms more.

    One that steps at every 30 rows is known to do so in a gap, too; at another the record is cut.
    """
    study = Study(data=Data(time="t"), coordinates={"x": Measured()}, inputs={"u": Driven()})
    result = identify(study, valve(seed, regular))
    terms = {t.text: t for t in result.model.relations[0].terms}
    assert set(terms) == {"x_dot", "x", "u"}
    for name, truth in {"x": 0.5, "u": -1.0}.items():
        assert abs(terms[name].coefficient - truth) < 4.0 * terms[name].std_error < 0.002
    assert any(note.startswith("recordings were cut at 3 gaps") for note in result.notes) is not regular
    assert result.refinement.exact


def balanced(seed):
    """Return a log of x'' = 4 x - x'/2 + u, held by a controller with a dither of 1 to 9 Hz; 8 of 2000 rows lost."""
    rng, count, step = np.random.default_rng(seed), 2000, 0.02
    held = expm(step * np.array([[0.0, 1.0, 0.0], [4.0, -0.5, 1.0], [0.0, 0.0, 0.0]]))
    t, states, u = step * np.arange(count), np.zeros((count, 2)), np.zeros(count)
    frequencies, phases = rng.uniform(1.0, 9.0, 8), rng.uniform(0.0, 2.0 * np.pi, 8)
    dither = np.sin(2.0 * np.pi * np.multiply.outer(t, frequencies) + phases).sum(axis=1) + 2.0 * np.sin(0.7 * t)
    for k in range(count):
        u[k] = dither[k] - states[k] @ [14.0, 6.0]
        if k + 1 < count:
            states[k + 1] = held[:2] @ [*states[k], u[k]]
    x = states[:, 0] + 0.002 * states[:, 0].std() * rng.standard_normal(count)
    kept = np.setdiff1d(np.arange(count), rng.choice(np.arange(20, count - 20), 8, replace=False))
    return {"t": t[kept], "x": x[kept], "u": u[kept]}


@pytest.mark.parametrize("seed", [2, *(pytest.param(s, marks=pytest.mark.slow) for s in (0, 1, 3))])
def test_a_fast_command_in_single_lost_rows_is_not_on_a_line(seed):
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    result = identify(study, balanced(seed))
    terms = {t.text: t for t in result.model.relations[0].terms}
    assert set(terms) == {"x_ddot", "x", "x_dot", "u"}
    for name, truth in {"x": -4.0, "x_dot": 0.5, "u": -1.0}.items():
        assert abs(terms[name].coefficient - truth) < 4.0 * terms[name].std_error < 0.03
    assert result.refinement.exact
