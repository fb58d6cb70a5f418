"""Modelica and Julia read back by a small evaluator: no tool of either can be installed where the tests run."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from exported_models import driven_cart, push, reactor, slider
from hand_models import MODELS
from test_c import dense

from odescope.errors import InputError
from odescope.export.programs.julia import to_julia
from odescope.export.programs.modelica import to_modelica
from odescope.model.simulation import drive

ALL = {**MODELS, "cart": driven_cart("linear", 0.025), "reactor": reactor(), "slider": slider()}
FUNCTIONS = {
    f: getattr(np, f) for f in ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sign", "tanh", "sinh", "cosh")
}


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


class FromOne:
    """An array with the indices of Julia."""

    def __init__(self, values):
        self.values = values

    def __len__(self):
        return len(self.values)

    def __getitem__(self, at):
        row, *column = at if isinstance(at, tuple) else (at,)
        assert 1 <= row <= len(self)
        return self.values[(row - 1, *(k - 1 for k in column))]


@pytest.mark.parametrize(("hold", "delay"), [("linear", 0.0234), ("zero", 0.0234), ("linear", -0.017), ("zero", 0.0)])
def test_in_julia_a_record_acts_as_in_the_free_run(hold, delay):
    model, t = driven_cart(hold, delay), 0.01 * np.arange(40)
    (text,) = to_julia(model).files.values()
    body = re.search(r"^function (acting\(.*?\))\n(.*?)^end$", text, re.MULTILINE | re.DOTALL)
    lines = [re.sub(r"^    (.*) && return (.*)$", r"    if \1: return \2", line) for line in body[2].splitlines()]
    source = "\n".join([f"def {body[1]}:", *lines]).replace("times[end]", "times[len(times)]")
    scope = {"DELAYS": FromOne(np.array([delay])), "HOLDS": FromOne(np.array([hold])), "len": len}
    scope["searchsortedlast"] = lambda times, at: np.searchsorted(times.values, at, side="right")
    exec(source.replace("inputs[end", "inputs[len(inputs)"), scope)  # noqa: S102 (our own text)
    driven = drive(model.inputs, t, push(t))
    for begin, end, value, following in zip(driven.t, driven.t[1:], driven.begin, driven.end, strict=False):
        for share in (0.25, 0.75):
            found = scope["acting"](FromOne(t), FromOne(push(t)), 1, begin + share * (end - begin))
            assert found == pytest.approx(value[0] + share * (following[0] - value[0]), rel=1e-9)


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
