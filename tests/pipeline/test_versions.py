"""Inputs that were recorded more than once: the column that drove the record is found."""

import numpy as np
import pytest

from odescope import Candidates, Data, Driven, InputError, Measured, NoModelError, Study, from_json, identify, to_json
from odescope.events import Note
from odescope.pipeline.versions import versions_of

PERIOD = 0.02
LIBRARY = Candidates(basis=("x", "x_dot", "u"), degree=2)


def log(seed):
    """Return a spring driven by what an actuator makes of its command: a lag, and a limit."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 40.0, PERIOD)
    command = 2.0 * np.sin(0.9 * t + rng.uniform(0, 6)) + 1.5 * np.sin(2.3 * t + rng.uniform(0, 6))
    force, state, states = 0.0, np.array([0.3, 0.0]), []
    forces = []
    for u in command:
        states.append(state.copy())
        forces.append(force)
        slope = (np.clip(u, -2.0, 2.0) - force) / 0.3
        for _ in range(10):
            h = PERIOD / 10
            middle = state + 0.5 * h * np.array([state[1], -4.0 * state[0] - 0.3 * state[1] + force + 0.5 * h * slope])
            force_middle = force + 0.5 * h * slope
            state = state + h * np.array([middle[1], -4.0 * middle[0] - 0.3 * middle[1] + force_middle])
            force += h * slope
    x = np.array(states)[:, 0]
    noise = 0.01 * x.std()
    return {"t": t, "x": x + noise * rng.standard_normal(len(t)), "command": command, "measured": np.array(forces)}


def study(**columns):
    return Study(
        coordinates={"x": Measured(order=2)},
        inputs={name: Driven(column=column) for name, column in columns.items()},
        library=LIBRARY,
        data=Data(time="t"),
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_column_that_drove_the_record_is_taken(seed):
    told = []
    data = log(seed)
    found = identify(study(u=("command", "measured")), data, watch=told.append)
    alone = identify(study(u="measured"), data)
    assert found.model.equations == alone.model.equations
    assert [t.term.text for t in found.model.relations[0].terms[1:]] == ["x", "x_dot", "u"]
    assert dict(found.study.layout().columns)["u"] == "measured"
    assert from_json(to_json(found.model)).scores.versions == found.model.scores.versions
    assert [(v.columns, v.chosen) for v in found.model.scores.versions] == [
        ({"u": "command"}, False),
        ({"u": "measured"}, True),
    ]
    said = next(e.text for e in told if isinstance(e, Note) and "preferred" in e.text)
    assert said.startswith("u from the column 'measured' was preferred, free-run error ")
    assert "'command'" in said


@pytest.mark.slow
def test_a_column_without_a_model_is_no_end_and_only_where_all_fail_is_there_none():
    data = log(0)
    rng = np.random.default_rng(1)
    data["nothing"] = rng.standard_normal(len(data["t"]))
    found = identify(study(u=("nothing", "measured")), data)
    assert dict(found.study.layout().columns)["u"] == "measured"
    data["x"] = np.cumsum(np.cumsum(rng.standard_normal(len(data["t"]))))
    events = []
    for columns in ("nothing", ("nothing", "measured")):
        told = []
        with pytest.raises(NoModelError):
            identify(study(u=columns), data, watch=told.append)
        events.append([type(e).__name__ for e in told].count("NothingFound"))
    assert events == [1, 1]


def test_the_same_column_twice_or_none_is_refused():
    for wrong in ((), ("a", "a")):
        with pytest.raises(InputError, match="several different ones"):
            Driven(column=wrong)


def test_a_column_that_lacks_is_named():
    with pytest.raises(InputError, match="missing_one"):
        identify(study(u=("measured", "missing_one")), log(0))


def test_columns_of_several_inputs_go_together():
    both = study(u=("command", "measured"), v=("v1", "v2"))
    assert [[i.column for i in v.inputs.values()] for v in versions_of(both)] == [["command", "v1"], ["measured", "v2"]]
    assert versions_of(study(u="measured")) == (study(u="measured"),)
    with pytest.raises(InputError, match="u in 2, v in 3"):
        versions_of(study(u=("command", "measured"), v=("a", "b", "c"), w="d"))
