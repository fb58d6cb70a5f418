"""The CasADi module run by CasADi, where it is installed, beside the relations and odescope's own free run."""

import numpy as np
import pytest
from exported_models import TIMES, driven_cart, free_run, push, reactor, slider
from hand_models import MODELS
from test_c import dense, differences

from odescope.errors import InputError
from odescope.export.programs.casadi import to_casadi

ALL = {**MODELS, "cart": driven_cart("zero", 0.25), "reactor": reactor(), "slider": slider()}


def module(model):
    pytest.importorskip("casadi", reason="no CasADi")
    namespace = {}
    exec(compile(to_casadi(model).files["plant.py"], "exported", "exec"), namespace)  # noqa: S102 (our own output)
    return namespace


@pytest.mark.parametrize("name", ALL)
def test_the_function_and_its_jacobian_are_those_of_the_relations(name):
    model, rng = ALL[name], np.random.default_rng(3)
    exported = module(model)
    function = exported["derivative"]
    for at in rng.uniform(0.3, 1.3, (3, len(model.variables))):
        x, u = at[: len(model.states)], at[len(model.states) :]
        assert np.allclose(np.array(function(x, u))[:, 0], dense(model, at), rtol=1e-12, atol=1e-12)
        slopes = np.hstack([np.array(j) for j in function.jacobian()(x, u, 0)])
        oracle = differences(lambda z, model=model: dense(model, z), at)
        assert np.allclose(slopes, oracle, rtol=1e-6, atol=1e-6 * np.abs(oracle).max())


def test_its_steps_run_as_the_free_run_does():
    model, start = driven_cart(), [0.1, 0.4, 0.0, -0.2]
    step, force = module(model)["step"], push()[:, 0]
    x, found = np.array(start), [start]
    for k in range(len(TIMES) - 1):
        for part in range(4):
            u0, u1 = (force[k] + (force[k + 1] - force[k]) * (part + j) / 4 for j in (0, 1))
            x = step(x, u0, u1, 0.0025)
        found.append(np.array(x)[:, 0])
    exact = free_run(model, push(), start)
    assert np.abs(np.array(found) - exact).max() < 1e-6 * np.abs(exact).max()


def test_what_the_module_says_beside():
    exported = module(ALL["cart"])
    assert exported["STATES"] == ("x", "phi", "x_dot", "phi_dot")
    assert (exported["INPUTS"], exported["DELAYS"], exported["HOLDS"]) == (("u",), (0.25,), ("zero",))
    assert exported["OFFSETS"] == (0.125, 0.125)
    assert "tanh" in module(slider())["__doc__"]


def test_names_are_those_of_the_language():
    with pytest.raises(InputError, match="'casadi'"):
        to_casadi(MODELS["coupled"], "casadi")
    program = to_casadi(MODELS["hostile"])
    assert "float is written float_" in program.notes
    assert repr(0.1 + 0.2) in to_casadi(MODELS["rational"]).files["plant.py"]
