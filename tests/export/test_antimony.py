"""Antimony turned into SBML and simulated by libRoadRunner, where they are installed, beside the free run."""

from dataclasses import replace

import numpy as np
import pytest
from exported_models import driven_cart, free_run, reactor
from hand_models import relation
from test_c import dense

from odescope.errors import InputError
from odescope.export.programs.antimony import to_antimony
from odescope.library.parse import Scope
from odescope.model.model import Model
from odescope.recordings.coordinate import Coordinate, Input


def coupled():
    """Names that Antimony reserves, a sign, a logarithm, powers, and rates that share relations."""
    names = ["time", "_b", "ln", "u"]
    scope = Scope.of(names)
    return Model(
        tuple(Coordinate(n) for n in names[:3]),
        (Input("u"),),
        (
            relation(scope, ("time_dot", "1", 1.0), ("_b_dot", "time", 0.5), (None, "sign(time - 0.7*_b)", 1 / 3)),
            relation(scope, ("_b_dot", "1", 1.0), ("time_dot", "ln**-2", 0.25), (None, "log(ln)*u", -2.0)),
            relation(scope, ("ln_dot", "1", 1.0), (None, "_b**1.5", 0.1 + 0.2), (None, "abs(u)*tanh(time)", 1e-3)),
        ),
    )


def simulator(model):
    """Return a simulator of the model, and how its names are spelled."""
    antimony = pytest.importorskip("antimony", reason="no Antimony")
    roadrunner = pytest.importorskip("roadrunner", reason="no libRoadRunner")
    program = to_antimony(model)
    antimony.clearPreviousLoads()
    assert antimony.loadAntimonyString(program.files["plant.ant"]) >= 0, antimony.getLastError()
    spelling = {n: n for n in model.variables} | dict(note.split(" is written ") for note in program.notes)
    return roadrunner.RoadRunner(antimony.getSBMLString("plant")), spelling


@pytest.mark.parametrize("model", [reactor(), coupled()], ids=["reactor", "coupled"])
def test_the_rates_are_those_of_the_relations(model):
    running, spelling = simulator(model)
    for at in np.random.default_rng(3).uniform(0.3, 1.3, (5, len(model.variables))):
        for name, value in zip(model.variables, at, strict=True):
            running[spelling[name]] = value
        found = [running[f"{spelling[s]}'"] for s in model.states]
        assert np.allclose(found, dense(model, at), rtol=1e-12)


def test_the_simulation_is_the_free_run():
    model, start, t = reactor(), [1.2, 0.3], np.linspace(0.0, 10.0, 101)
    feed = np.where(np.sin(1.7 * t) > 0.0, 0.9, 0.2)
    exact = free_run(model, feed[:, None], start, t)
    running, _ = simulator(model)
    running.integrator.relative_tolerance, running.integrator.absolute_tolerance = 1e-11, 1e-13
    for name, value in zip(model.states, start, strict=True):
        running[name] = value
    found = [start]
    for begin, end, value in zip(t[:-1], t[1:], feed, strict=False):
        running["feed"] = value
        running.simulate(begin, end, 2)
        found.append([running[s] for s in model.states])
    assert np.abs(np.array(found) - exact).max() < 1e-6
    assert np.ptp(exact, axis=0).min() > 0.1


def test_what_is_no_rate_is_refused_by_name():
    with pytest.raises(InputError, match="x_ddot of the coordinate 'x' is of order 2"):
        to_antimony(driven_cart())
    with pytest.raises(InputError, match="'model'"):
        to_antimony(reactor(), "model")


def test_every_digit_is_there_and_reserved_names_are_said():
    program = to_antimony(coupled())
    assert program.notes == ("time is written time_", "_b is written v_b", "ln is written ln_")
    assert repr(1 / 3) in program.files["plant.ant"]


def test_what_is_to_be_set_before_a_run_is_said():
    text = to_antimony(coupled()).files["plant.ant"]
    assert "// Every state starts at 0.0: set time_, v_b, ln_ to where a run begins.\n" in text
    assert "set each to its value as it acts.\n" in text
    late = replace(coupled(), inputs=(Input("u", delay=0.5),))
    assert "set each to its value as it acts, as late as is said above.\n" in to_antimony(late).files["plant.ant"]
