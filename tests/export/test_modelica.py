"""The class run by Rumoca, a compiler of Modelica, where it is installed, inside a model that drives it."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from exported_models import ROUND_TRIPS, TIMES, free_run, reactor

from odescope.export.programs.modelica import to_modelica
from odescope.model.model import without_delays

FINE = 2.5e-4 * np.arange(40001)  # seconds: a record as good as the function that Modelica is given
FORCE = "3.5 + 0.9*sin(1.7*time)"
CASES = {name: (trip.model, trip.start) for name, trip in ROUND_TRIPS.items()} | {"reactor": (reactor(), (1.2, 0.3))}


def run(model, start):
    """Return the states (N, n) of Rumoca's run at TIMES."""
    rumoca = pytest.importorskip("rumoca", reason="no Rumoca")
    program = to_modelica(model)
    written = dict(n.split(" is written ") for n in program.notes if " is written " in n)
    spelling = {n: n for n in model.variables} | written
    begin = ", ".join(f"{spelling[s]}(start = {value!r})" for s, value in zip(model.states, start, strict=True))
    rig = f"model Rig\n  plant p({begin});\nequation\n  p.{spelling[model.inputs[0].name]} = {FORCE};\nend Rig;\n"
    compiled = rumoca.Session().loads(program.files["plant.mo"] + rig, model="Rig")
    options = rumoca.SimConfig(rtol=1e-10, atol=1e-12, solver="bdf")
    found = compiled.simulate(10.0, dt=0.01, config=options)
    return np.column_stack([found[f"p.{spelling[s]}"] for s in model.states])


def exact(model, start):
    smooth = replace(model, inputs=tuple(msgspec.structs.replace(i, hold="linear") for i in model.inputs))
    return free_run(smooth, (3.5 + 0.9 * np.sin(1.7 * FINE))[:, None], start, FINE)[::40]


@pytest.mark.parametrize("name", CASES)
def test_it_runs_as_the_free_run_does(name):
    model, start = without_delays(CASES[name][0]), CASES[name][1]
    expected = exact(model, start)
    assert np.all(np.abs(run(model, start) - expected) < 1e-6 * np.abs(expected).max(axis=0))
    assert len(expected) == len(TIMES)


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n != "network")) for n in ROUND_TRIPS])
def test_its_input_is_late(name):
    # Rumoca reads a delayed signal off lines between its own steps, and does not come nearer than that.
    model, start = CASES[name]
    expected = exact(model, start)
    effect = np.abs(exact(without_delays(model), start) - expected).max(axis=0)
    assert np.all(np.abs(run(model, start) - expected).max(axis=0) < 0.02 * effect)
    assert np.all(effect > 1e-3 * np.abs(expected).max(axis=0))
