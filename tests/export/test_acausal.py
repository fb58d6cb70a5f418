"""Modelica and Julia read back by a small evaluator: no tool of either can be installed where the tests run."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from exported_models import driven_cart, reactor, slider
from hand_models import MODELS
from test_c import dense

from odescope.errors import InputError
from odescope.export.programs.julia import to_julia
from odescope.export.programs.modelica import to_modelica

ALL = {**MODELS, "cart": driven_cart("linear", 0.025), "reactor": reactor(), "slider": slider()}
FUNCTIONS = {f: getattr(np, f) for f in ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sign", "tanh")}


def modelica(model):
    """Return the equations, with der(x) for a derivative and late inputs for those that act."""
    (text,) = to_modelica(model).files.values()
    body = re.fullmatch(r'model plant "[^"]*"\n  /\*.*?\*/\n(.*)equation\n(.*)end plant;\n', text, re.DOTALL)
    declared = re.findall(r"^  (?:input )?Real (\w+)(?:\(start = 0.0, fixed = true\))?;$", body[1], re.MULTILINE)
    assert len(declared) == body[1].count("\n")
    lines = body[2].replace("noEvent", "").splitlines()
    return set(declared), [re.fullmatch(r"  (.*) = (.*);", line).groups() for line in lines]


def julia(model):
    (text,) = to_julia(model).files.values()
    body = re.search(
        r"=#\nmodule plant\n.*^equations = \[\n(.*)\n\]\n\n@named.*\nend\n\Z", text, re.DOTALL | re.MULTILINE
    )
    declared = re.findall(r"(\w+)\(t\)", "\n".join(re.findall(r"^@variables .*$", text, re.MULTILINE)))
    lines = [re.sub(r"\bD\(", "der(", line.rstrip(",")) for line in body[1].splitlines()]
    return set(declared), [re.fullmatch(r"    (.*) ~ (.*)", line).groups() for line in lines]


def spelled(declared, name):
    """Return how a name of a model is written: as it is, or as it is after what the language reserves."""
    return name if name in declared else f"{name}_"


@pytest.mark.parametrize("read", [modelica, julia])
@pytest.mark.parametrize("name", ALL)
def test_the_equations_hold_where_the_relations_do(name, read):
    model, rng = ALL[name], np.random.default_rng(3)
    declared, equations = read(model)
    for at in rng.uniform(0.3, 1.3, (3, len(model.variables))):
        rates = dict(zip(model.states, dense(model, at), strict=True))
        known = dict(zip(model.variables, at, strict=True))
        known |= {c.target: rates[c.derivative(c.order - 1)] for c in model.coordinates}
        scope = {spelled(declared, n): value for n, value in known.items()}
        scope |= {f"ode_late_{i.name}": known[i.name] for i in model.inputs if i.delay}
        assert declared <= set(scope)
        slopes = {spelled(declared, s): rate for s, rate in rates.items()}
        states = 0
        for left, right in equations:
            state = re.fullmatch(r"der\((\w+)\)", left)
            delayed = re.fullmatch(r"delay\((\w+), ([\d.]+)\)", right)
            if delayed:
                assert (left, float(delayed[2])) == (f"ode_late_{delayed[1]}", model.inputs[0].delay)
                continue
            values = [
                eval(side.replace("^", "**"), {"__builtins__": {}}, FUNCTIONS | scope)  # noqa: S307 (our own text)
                for side in ([right] if state else [left, right])
            ]
            states += state is not None
            assert values[0] == pytest.approx(slopes[state[1]] if state else values[1], rel=1e-10, abs=1e-10)
        assert states == len(model.states)


def test_an_input_that_acts_early_is_beyond_modelica():
    early = msgspec.structs.replace(driven_cart().inputs[0], delay=-0.1)
    with pytest.raises(InputError, match=r"input 'u' acts 0\.1 s before"):
        to_modelica(replace(driven_cart(), inputs=(early,)))
    assert "DELAYS = [-0.1]" in to_julia(replace(driven_cart(), inputs=(early,))).files["plant.jl"]


@pytest.mark.parametrize(("write", "word"), [(to_modelica, "model"), (to_julia, "end")])
def test_names_are_those_of_the_language(write, word):
    with pytest.raises(InputError, match=word):
        write(MODELS["coupled"], word)
    (text,) = write(MODELS["rational"]).files.values()
    assert repr(0.1 + 0.2) in text
    assert any("tanh" in note for note in write(slider()).notes)
