import ast
import builtins
import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hand_models import MODELS, relation
from scipy.integrate import solve_ivp

from odescope.export.about import about
from odescope.export.languages.python import to_python
from odescope.export.model_file import to_json
from odescope.library.parse import Scope
from odescope.model.model import Model
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate


def module(model):
    """Run the exported source where there is nothing but the import of numpy."""

    def only_numpy(name, *arguments):
        assert name == "numpy"
        return builtins.__import__(name, *arguments)

    namespace = {"__builtins__": {"__import__": only_numpy, "callable": callable, "enumerate": enumerate}}
    exec(compile(to_python(model), "exported", "exec"), namespace)  # noqa: S102 (our own output, which is the point)
    return namespace


def points(model, count=20):
    rng = np.random.default_rng(1)
    return rng.uniform(0.2, 1.5, (count, len(model.states))), rng.uniform(0.2, 1.5, (count, len(model.inputs)))


@pytest.mark.parametrize("name", MODELS)
def test_the_module_agrees_with_the_explicit_text_of_the_model_file(name):
    model = MODELS[name]
    exported = module(model)
    explicit = json.loads(to_json(model))["explicit"]
    functions = {f: getattr(np, f) for f in ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sign", "tanh")}
    for state, inputs in zip(*points(model), strict=True):
        names = functions | dict(zip(model.variables, (*state, *inputs), strict=True))
        targets = {t: eval(text, {"__builtins__": {}}, names) for t, text in explicit.items()}  # noqa: S307
        rates = {}
        for c in model.coordinates:
            for k in range(c.order):
                following = c.derivative(k + 1)
                rates[c.derivative(k)] = targets[following] if k + 1 == c.order else names[following]
        found = exported["derivative"](0.0, state, inputs)
        assert np.allclose(found, [rates[s] for s in model.states], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", MODELS)
def test_the_module_integrates_to_the_free_run(name):
    model = MODELS[name]
    exported = module(model)
    states, inputs = points(model, 1)
    t = np.linspace(0.0, 0.3, 31)
    run = simulate(model, t, np.tile(inputs, (31, 1)), states[0])
    oracle = solve_ivp(
        lambda time, y: exported["derivative"](time, y, inputs[0]), (0, 0.3), states[0], t_eval=t, rtol=1e-9, atol=1e-11
    )
    assert run.ended is None
    assert np.allclose(run.states, oracle.y.T, rtol=1e-6, atol=1e-7)
    assert np.abs(run.states[-1] - run.states[0]).max() > 0.01


@pytest.mark.parametrize("delays", [(0.0, 0.0), (0.05, -0.02), (0.123, 0.0)])
def test_recorded_inputs_act_as_late_as_the_model_says(delays):
    model = MODELS["rational"]
    inputs = tuple(msgspec.structs.replace(i, delay=d) for i, d in zip(model.inputs, delays, strict=True))
    model = replace(model, inputs=inputs)
    derivative = module(model)["derivative"]
    t = 0.01 * np.arange(61)
    recorded = np.column_stack([np.sin(7.0 * t), np.where(t < 0.3, 0.5, 1.0)])
    kinks = np.unique(np.round(np.concatenate([t, *(t + d for d in delays)]), 12))

    def at(time):
        held = recorded[max(np.searchsorted(t, time + 1e-9, side="right") - 1, 0), 1]
        return np.interp(time, t, recorded[:, 0]), held

    start = np.array([0.2, 0.4, 0.6, 0.8])
    run, now = simulate(model, t, recorded, start), start
    for begin, end in zip(kinks[(kinks >= 0.0) & (kinks < 0.6)], kinks[(kinks > 0.0) & (kinks <= 0.6)], strict=True):
        # Short of the kink, where a held input is still what it was.
        short = begin + (end - begin) * (1.0 - 1e-9)
        now = solve_ivp(lambda s, y: derivative(s, y, at), (begin, short), now, rtol=1e-9, atol=1e-11).y[:, -1]
    assert np.allclose(run.states[-1], now, rtol=1e-6, atol=1e-7)
    early = simulate(replace(model, inputs=MODELS["rational"].inputs), t, recorded, start).states[-1]
    assert np.allclose(early, now, rtol=1e-6, atol=1e-7) == (delays == (0.0, 0.0))


def test_values_are_taken_as_they_act_whatever_the_delay():
    model = MODELS["rational"]
    late = replace(model, inputs=tuple(msgspec.structs.replace(i, delay=0.5) for i in model.inputs))
    state, inputs = (1.0, 2.0, 1.0, 3.0), (1.0, 2.0)
    assert np.array_equal(
        module(late)["derivative"](0.0, state, inputs), module(model)["derivative"](0.0, state, inputs)
    )


@pytest.mark.parametrize("name", MODELS)
def test_the_module_names_states_and_inputs_and_imports_numpy_alone(name):
    model = MODELS[name]
    exported = module(model)
    assert exported["STATES"] == model.states
    assert exported["INPUTS"] == tuple(i.name for i in model.inputs)
    assert exported["DELAYS"] == tuple(i.delay for i in model.inputs)
    assert exported["HOLDS"] == tuple(i.hold for i in model.inputs)
    tree = ast.parse(to_python(model))
    imported = [a.name for n in ast.walk(tree) if isinstance(n, ast.Import | ast.ImportFrom) for a in n.names]
    assert imported == ["numpy"]
    own = [n.name for n in tree.body if isinstance(n, ast.FunctionDef)]
    assert [name for name in own if not name.startswith("_")] == ["derivative"]


def test_the_module_goes_through_standstill_as_the_free_run_does():
    # x'' = cos(t) - .8 sign(x'): sticks and slides, within a domain that sets how sharp the sign is.
    scope = Scope.of(["x", "f", "x_dot", "f_dot"])
    model = Model(
        (Coordinate("x", 2), Coordinate("f", 2)),
        (),
        (
            relation(scope, ("x_ddot", "1", 1.0), (None, "f", -1.0), (None, "sign(x_dot)", 0.8)),
            relation(scope, ("f_ddot", "1", 1.0), (None, "f", 1.0)),
        ),
        domain={"x_dot": (-0.2, 0.3)},
    )
    t, start = np.linspace(0.0, 20.0, 201), np.array([0.0, 0.0, 1.0, 0.0])
    run = simulate(model, t, np.empty((201, 0)), start)
    exported = module(model)
    assert "tanh" in exported["__doc__"]
    found = solve_ivp(exported["derivative"], (0.0, 20.0), start, "LSODA", t_eval=t, rtol=1e-8, atol=1e-10)
    assert found.nfev < 20_000
    assert np.allclose(found.y[0], run.column("x"), atol=3e-4)
    assert np.mean(run.column("x_dot") == 0.0) > 0.3
    # Sharp beyond any speed but those next to none; without a domain as it was.
    assert exported["derivative"](0.0, [0.0, 1.0, 0.01, 0.0])[2] == 1.0 - 0.8
    assert ".sign(x_dot)" in to_python(replace(model, domain={}))
    assert "tanh" not in to_python(replace(model, domain={}))


def test_whole_numbers_are_as_good_as_floats():
    model = MODELS["rational"]
    derivative = module(model)["derivative"]
    whole = derivative(0, np.array([1, 2, 1, 3]), (1, 2))
    assert np.array_equal(whole, derivative(0.0, np.array([1.0, 2.0, 1.0, 3.0]), [1.0, 2.0]))
    assert np.array_equal(whole, derivative(0, (1, 2, 1, 3), (1, 2)))


def test_every_digit_is_there():
    source = to_python(MODELS["rational"])
    for value in (0.1 + 0.2, 1 / 3, 1e-17, 5.55):
        assert repr(value) in source


def test_the_head_says_what_states_are_in_and_where_the_model_holds():
    model = MODELS["rational"]
    assert to_python(model).startswith("\n".join(('"""Equations of motion, written by odescope.', *about(model)[1:])))
    assert "x [m]" in to_python(model).partition("import numpy")[0]
