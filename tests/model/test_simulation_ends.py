"""How a free run ends before its time, and what is refused."""

import numpy as np
import pytest
from built_models import build
from simulation_cases import DECAY, X, Y, free, lagrange

from odescope.errors import InputError
from odescope.model.driven_record import DrivenRecord
from odescope.model.simulation import follow, simulate
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record


def test_a_blow_up_ends_the_run_where_it_happens():
    # x' = x^2 from 1: x = 1 / (1 - t).
    model = build([X], [], [("x_dot", "1", 1.0), (None, "x**2", -1.0)])
    t = np.linspace(0.0, 3.0, 301)
    found = free(model, t, [1.0])
    assert "grew without bound" in found.ended
    assert found.ended.endswith(f"after {found.t[-1] - found.t[0]:.6g} s")
    assert 0.98 < found.t[-1] <= 1.0 + 1e-9
    early = found.t < 0.95
    assert found.states[early, 0] == pytest.approx(1.0 / (1.0 - found.t[early]), rel=1e-5)
    assert found.states.shape == (len(found.t), 1)


@pytest.mark.parametrize("start", [0.5, 1.0, 1.3, 2.0])
@pytest.mark.parametrize("period", [0.01, 0.013, 0.3])
def test_a_pole_ends_the_run_before_it(start, period):
    # x x' = -1: x = sqrt(start^2 - 2 t), until t = start^2 / 2.
    model = build([X], [], [("x_dot", "x", 1.0), (None, "1", 1.0)])
    t = period * np.arange(1000)
    found = free(model, t, [start])
    assert found.ended is not None
    pole = start**2 / 2.0
    assert pole - 1.001 * period <= found.t[-1] <= pole * (1.0 + 1e-6)
    early = found.t < pole - 0.02
    assert found.states[early, 0] == pytest.approx(np.sqrt(start**2 - 2.0 * found.t[early]), rel=1e-5)


def test_a_start_on_a_pole_ends_at_once():
    model = build([X], [], [("x_dot", "x", 1.0), (None, "1", 1.0)])
    found = free(model, np.linspace(0.0, 1.0, 11), [0.0])
    assert found.t.tolist() == [0.0]
    assert found.states.tolist() == [[0.0]]
    assert "met a pole" in found.ended


def test_leaving_the_domain_of_a_function_ends_the_run():
    # x' = -1 - log(x) / 1e3: log has no value below zero, which the state reaches shortly after t = 1.
    model = build([X], [], [("x_dot", "1", 1.0), (None, "1", 1.0), (None, "log(x)", 0.001)])
    found = free(model, np.linspace(0.0, 3.0, 61), [1.0])
    assert "met a pole" in found.ended
    assert found.t[-1] == pytest.approx(1.0, abs=0.051)


def test_stiffness_ends_the_run_and_says_so():
    stiff = build([X], [], [("x_dot", "1", 1.0), (None, "x", 1e7), (None, "1", -1.0)])
    found = free(stiff, np.linspace(0.0, 1.0, 101), [1.0])
    assert "too stiff to follow after 0 s" in found.ended
    assert "give more of these in between" in found.ended
    assert len(found.t) == 1
    t = np.linspace(0.0, 1.0, 101)
    record = Record(t, np.ones((101, 1)), ("x",), (None,))  # whose times nobody gave
    followed = follow(stiff, t, DrivenRecord.of(stiff, record).driven, np.ones(1))
    assert followed.ended == "the equations became too stiff, or moved too fast, to be followed after 0 s"
    mild = build([X], [], [("x_dot", "1", 1.0), (None, "x", 1e4), (None, "1", -1.0)])
    assert free(mild, np.linspace(0.0, 1.0, 101), [1.0]).states[-1, 0] == pytest.approx(1e-4, rel=1e-3)


def test_relations_that_contradict_each_other_end_the_run():
    model = build(
        [X, Y],
        [],
        [("x_dot", "1", 1.0), ("y_dot", "1", 2.0), (None, "1", 1.0)],
        [("x_dot", "1", 2.0), ("y_dot", "1", 4.0), (None, "1", 1.0)],
    )
    assert len(free(model, np.linspace(0.0, 1.0, 5), [0.0, 0.0]).t) == 1


@pytest.mark.parametrize(
    ("t", "inputs", "initial", "message"),
    [
        (
            [0.0, 0.1, 0.2],
            np.zeros((2, 1)),
            np.zeros(4),
            r"array of shape \(3, 1\), a column each for u; an array of",
        ),
        ([0.0, 0.1, 0.2], np.zeros((3, 1)), np.zeros(3), r"array of shape \(4,\); an array of shape \(3,\) came"),
        ([0.0, 0.1, 0.2], np.array([[0.0], [np.nan], [0.0]]), np.zeros(4), "must be finite"),
        ([0.0, 0.1, 0.2], np.zeros((3, 1)), np.array([0.0, np.inf, 0.0, 0.0]), "must be finite"),
        ([0.0, np.nan, 0.2], np.zeros((3, 1)), np.zeros(4), "must be finite"),
        ([0.0, 0.2, 0.1], np.zeros((3, 1)), np.zeros(4), "must ascend"),
        ([0.0, 0.1, 0.1], np.zeros((3, 1)), np.zeros(4), "must ascend"),
        ([], np.zeros((0, 1)), np.zeros(4), "at least one"),
    ],
)
def test_what_does_not_fit_the_model_is_refused(t, inputs, initial, message):
    with pytest.raises(InputError, match=message):
        simulate(lagrange("linear"), np.array(t), inputs, initial)


def test_one_sample_is_the_start():
    found = free(DECAY, np.array([3.0]), [0.7])
    assert (found.t.tolist(), found.states.tolist(), found.ended) == ([3.0], [[0.7]], None)


@pytest.mark.parametrize("t", [[0.0, 30.0], [0.0, 0.1, 30.0], [0.0, 300.0], [0.0, 1e-6, 2e-6, 40.0, 80.0]])
def test_fast_motion_is_followed_between_times_far_apart(t):
    """Three hertz for half a minute and more, to the end of a record of few samples."""
    x = Coordinate("x", order=2)
    model = build([x], [], [("x_ddot", "1", 1.0), (None, "x", (6.0 * np.pi) ** 2)])
    found = free(model, np.array(t), [1.0, 0.0])
    assert found.ended is None
    assert found.states[:, 0] == pytest.approx(np.cos(6.0 * np.pi * np.array(t)), abs=1e-3)
