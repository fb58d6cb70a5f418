"""What a simulation takes, from Python: lists, dicts, dataframes, arrays; and what it says to anything else."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from built_models import build
from simulation_cases import DECAY, lagrange

import odescope
from odescope.errors import InputError
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input

T = np.linspace(0.0, 1.0, 21)
PUSH = np.sin(5.0 * T)
START = {"x": 0.1, "phi": 0.2, "x_dot": -0.3, "phi_dot": 0.4}
CART = lagrange("linear")
EXPECTED = simulate(CART, T, PUSH[:, None], np.array(list(START.values()))).states
FRAME = pd.DataFrame({"t": T, "u": PUSH, "x": 0.0})


@pytest.mark.parametrize(
    "inputs",
    [
        PUSH,
        PUSH.tolist(),
        PUSH[:, None].tolist(),
        {"u": PUSH},
        {"u": PUSH.tolist(), "more": ["is", "left", "alone"]},
        FRAME,
        FRAME["u"],
        FRAME.set_index("t")["u"],
        pa.table({"u": PUSH}),
    ],
    ids=lambda given: type(given).__name__,
)
def test_inputs_by_name_or_in_order(inputs):
    assert np.array_equal(simulate(CART, T, inputs, list(START.values())).states, EXPECTED)


@pytest.mark.parametrize(
    "initial",
    [
        START,
        dict(reversed(START.items())),
        tuple(START.values()),
        pd.Series(START),
        pd.DataFrame([START]),
        {name: np.float32(value) if value == 0.5 else np.array(value) for name, value in START.items()},
    ],
    ids=lambda given: type(given).__name__,
)
def test_states_by_name_or_in_order(initial):
    for t in (T, T.tolist(), pd.Series(T)):
        assert np.array_equal(CART.simulate(t, PUSH, initial).states, EXPECTED)


def test_the_time_itself_need_not_be_given():
    x, t = Coordinate("x"), Input("t", unit="s")
    rows = [("x_dot", "1", 1.0), (None, "x", 2.0), (None, "t", -3.0)]
    late, moved = T + 5.0, Input("t", unit="degC")
    exact = 0.2 * np.exp(-2.0 * T) + 1.5 * (late - 0.5 - (5.0 - 0.5) * np.exp(-2.0 * T))
    for given in (None, {}, {"t": late}, late):
        states = simulate(build([x], [t], rows), late, given, [0.2]).states
        assert states[:, 0] == pytest.approx(exact, rel=1e-6)
    driven = build([x], [Input("u"), t], [*rows, (None, "u", -1.0)])
    both = simulate(driven, late, {"u": PUSH, "t": late}, [0.2]).states
    assert np.array_equal(simulate(driven, late, {"u": PUSH}, [0.2]).states, both)
    with pytest.raises(InputError, match=r"'t' is missing"):
        simulate(build([x], [moved], rows), late, {}, [0.2])


def test_one_number_is_an_input_that_is_held():
    held = simulate(CART, T, {"u": 0.5}, START)
    assert np.array_equal(held.states, simulate(CART, T, np.full(len(T), 0.5), START).states)


def test_no_inputs_are_nothing_or_none():
    runs = [simulate(DECAY, T, none, [1.0]).states for none in (None, {}, np.empty((len(T), 0)))]
    assert all(np.array_equal(run, runs[0]) for run in runs)
    assert simulate(DECAY, T, None, {"x": 1.0}).column("x")[-1] == pytest.approx(np.exp(-1.0))
    with pytest.raises(InputError, match="no state 'y'; there are: x"):
        simulate(DECAY, T, None, [1.0]).column("y")


@pytest.mark.parametrize(
    ("t", "inputs", "initial", "message"),
    [
        ("0 to 1", PUSH, START, r"t must be sample times in seconds, a list or array of shape \(N,\); a str came"),
        (T[:, None], PUSH, START, r"an array of shape \(21, 1\) came"),
        (
            T,
            None,
            START,
            r"inputs must be {\"u\": \[...\]} or an array of shape \(21, 1\), a column each for u; None came",
        ),
        (T, {"v": PUSH}, START, "'u' is missing, there are: v"),
        (T, {"force": PUSH}, START, "'u' is missing, there are: force"),
        (T, {"u": PUSH[1:]}, START, r"of 'u' came an array of shape \(20,\)"),
        (T, {"u": "high"}, START, "of 'u' came a str"),
        (T, PUSH[1:], START, r"an array of shape \(20, 1\) came|an array of shape \(20,\) came"),
        (T, [[1.0], [2.0, 3.0]], START, "a list came"),
        (T, PUSH, {"x": 0.1, "phi": 0.2}, "'x_dot' is missing: velocities count as states, too"),
        (T, PUSH, START | {"x_dto": 1.0}, "'x_dto' is no state, did you mean 'x_dot'"),
        (T, PUSH, START | {"x": [1.0, 2.0]}, r"of 'x' came an array of shape \(2,\)"),
        (
            T,
            PUSH,
            None,
            r"initial must be the states at t\[0\], {\"x\": ..., .* or a list or array of shape \(4,\); None",
        ),
        (T, PUSH, 3.0, r"an array of shape \(\) came"),
        (T, PUSH, START | {"x": np.nan}, "initial states must be finite"),
    ],
)
def test_what_does_not_fit_is_told_what_would(t, inputs, initial, message):
    with pytest.raises(InputError, match=message):
        simulate(CART, t, inputs, initial)


def test_a_model_without_inputs_says_so():
    with pytest.raises(InputError, match="or None: the model has no inputs; an array"):
        simulate(DECAY, T, PUSH, [1.0])
    model = build([Coordinate("x")], [Input(n) for n in "abcde"], [("x_dot", "1", 1.0), (None, "a", 1.0)])
    with pytest.raises(InputError, match=r'"d": \[...\], ...}'):
        simulate(model, T, None, [1.0])


def test_what_is_no_model_is_told_so():
    class Found:
        model = CART

    for given, message in (
        ("model.json", "must be odescope.Model; a str came$"),
        (Found(), "a Found came: pass its .model"),
    ):
        with pytest.raises(InputError, match=message):
            odescope.simulate(given, T, PUSH, START)
        with pytest.raises(InputError, match=message):
            odescope.validate(given, FRAME)
        with pytest.raises(InputError, match=message):
            odescope.write_model(given, "model.json")
