"""The CasADi module run by CasADi, where it is installed, beside the relations and odescope's own free run."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from exported_models import TIMES, driven_cart, free_run, push, reactor, slider
from hand_models import MODELS, relation
from test_c import dense, differences

from odescope.errors import InputError
from odescope.export.programs.casadi import to_casadi
from odescope.library.parse import Scope

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


@pytest.mark.parametrize("hold", ["linear", "zero", "band-limited"])
@pytest.mark.parametrize("delay", [0.0, 0.0234, 0.02, -0.017])
def test_it_lays_a_record_out_as_the_inputs_act(hold, delay):
    model, start = driven_cart(hold, delay), [0.1, 0.4, 0.0, -0.2]
    exact = free_run(model, push(), start)
    found = module(model)["simulate"](start, TIMES, push())
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()


def test_inputs_of_different_holds_and_delays_act_together():
    inputs = tuple(
        msgspec.structs.replace(i, delay=d) for i, d in zip(MODELS["rational"].inputs, (0.013, 0.004), strict=True)
    )
    model, t = replace(MODELS["rational"], inputs=inputs), np.sort(np.random.default_rng(2).uniform(0.0, 0.3, 31))
    u, start = np.column_stack([np.sin(7.0 * t), np.where(t < 0.1, 0.5, 1.0)]), [0.2, 0.4, 0.6, 0.8]
    found = module(model)["simulate"](start, t, u)
    assert np.allclose(found, free_run(model, u, start, t), rtol=1e-7, atol=1e-8)


def test_without_inputs_it_runs_as_well():
    model, start, t = MODELS["coupled"], [0.3, 0.4, 0.5, 0.1, 0.2, 0.3], 0.01 * np.arange(101)
    exact = free_run(model, np.empty((101, 0)), start, t)
    assert np.allclose(module(model)["simulate"](start, t, np.empty((101, 0))), exact, rtol=1e-7, atol=1e-8)


def test_smooth_friction_is_followed_through_standstill():
    # The oracle has the smooth step in the place of the sign, as the module says that it does.
    model = slider()
    terms = {
        f"sign({rate})": f"tanh({1e4 / max(map(abs, model.domain[rate]))!r}*{rate})" for rate in ("p_dot", "q_dot")
    }
    scope = Scope.of(model.variables)
    smooth = replace(
        model,
        relations=tuple(
            relation(scope, *((t.factor, terms.get(t.term.text, t.term.text), t.coefficient) for t in r.terms))
            for r in model.relations
        ),
    )
    force, start = 2.2 * np.sin(1.3 * TIMES)[:, None], [0.3, -0.2, 0.0, 0.0]
    found = module(model)["simulate"](start, TIMES, force)
    assert np.abs(found - free_run(smooth, force, start)).max() < 1e-6
    assert 1e-5 < np.abs(found - free_run(model, force, start)).max() < 1e-3


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
