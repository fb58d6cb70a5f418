"""The unit checked and run by FMPy, where it is installed, in both kinds of simulation beside the free run."""

import io
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from exported_models import TIMES, driven_cart, free_run, push, slider
from hand_models import MODELS
from test_c import COMPILER, STRICT, dense

from odescope.errors import InputError
from odescope.export.programs.fmu import to_fmu
from odescope.model.model import without_delays
from odescope.recordings.coordinate import Input

LATE_SLIDER = replace(slider(), inputs=(Input("f", "zero", None, 0.137),))
ROUGH = 2.2 * np.sin(1.3 * TIMES)[:, None]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Write a unit, have FMPy check it, and compile its sources where an importer would put them."""
    fmpy = pytest.importorskip("fmpy", reason="no FMPy")
    if COMPILER is None:
        pytest.skip("no C compiler")

    def build(model):
        folder = tmp_path_factory.mktemp("fmu")
        path = folder / "plant.fmu"
        path.write_bytes(to_fmu(model).files["plant.fmu"])
        from fmpy.validation import validate_fmu

        assert validate_fmu(str(path)) == []
        unpacked = folder / "unpacked"
        with zipfile.ZipFile(path) as archive:
            archive.extractall(unpacked)
        binaries = unpacked / "binaries" / fmpy.platform_tuple
        binaries.mkdir(parents=True)
        sources = [str(unpacked / "sources" / f"{s}.c") for s in ("plant", "fmi3")]
        headers = Path(fmpy.__file__).parent / "c-code"
        target = str(binaries / f"plant{fmpy.sharedLibraryExtension}")
        # The headers of the standard declare what the strictest rules of C99 do not like.
        flags = [f for f in STRICT if f != "-pedantic-errors"]
        command = [COMPILER, *flags, "-shared", "-fPIC", f"-I{headers}", "-o", target, *sources, "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return str(unpacked)

    return build


def simulated(unit, kind, model, inputs, start, t=TIMES, **options):
    from fmpy import simulate_fmu

    names, period = model.states, t[1] - t[0]
    types = [("time", np.double), *((i.name, np.double) for i in model.inputs)]
    signals = np.array([(at, *row) for at, row in zip(t, inputs.tolist(), strict=True)], dtype=types)
    result = simulate_fmu(
        unit,
        fmi_type=kind,
        start_values=dict(zip(names, start, strict=True)),
        input=signals,
        stop_time=10.0,
        output_interval=period,
        output=list(names),
        **options,
    )
    found = np.column_stack([result[n] for n in names])
    time = np.asarray(result["time"]) / period
    on = np.abs(time - np.round(time)) < 1e-6  # events have rows of their own; of two at an instant the later counts
    last = dict(zip(np.round(time[on]).astype(int), found[on], strict=True))
    return np.array([last[k] for k in range(len(t))])


# FMPy's integrator holds inputs from one row of its result to the next, and is not told of their jumps: so none.


def test_in_model_exchange_it_runs_as_the_free_run_does(built):
    model, start, force = driven_cart(), [0.1, 2.4, 0.0, -0.2], np.full((len(TIMES), 1), 2.0)
    exact = free_run(model, force, start)
    found = simulated(built(model), "ModelExchange", model, force, start, relative_tolerance=1e-9)
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()


def test_in_model_exchange_dry_friction_sticks_and_slides_by_events(built):
    model, start, force = slider(), [2.5, -1.5, 0.0, 0.0], np.full((len(TIMES), 1), 0.3)
    exact = free_run(model, force, start)
    found = simulated(built(model), "ModelExchange", model, force, start, relative_tolerance=1e-9)
    assert np.abs(found - exact).max() < 1e-5
    for rate in (2, 3):
        still = np.abs(exact[:, rate]) < 1e-12
        assert 0.02 < np.mean(still) < 0.98
        assert np.mean(np.abs(found[still, rate]) < 1e-7) > 0.95


@pytest.mark.parametrize("model", [driven_cart("zero"), replace(slider(), inputs=(Input("f", "zero"),))])
def test_in_co_simulation_it_runs_as_the_free_run_does_under_held_inputs(model, built):
    inputs, start = (push(), [0.1, 0.4, 0.0, -0.2]) if model.states[0] == "x" else (ROUGH, [0.3, -0.2, 0.0, 0.0])
    exact = free_run(model, inputs, start)
    found = simulated(built(model), "CoSimulation", model, inputs, start)
    assert np.abs(found - exact).max() < 1e-6 * max(1.0, np.abs(exact).max())


@pytest.mark.parametrize(
    "model", [driven_cart("zero", 0.0234), driven_cart("linear", 0.0234), driven_cart("linear", 0.01), LATE_SLIDER]
)
def test_in_co_simulation_the_unit_delays_inputs(model, built):
    inputs, start = (push(), [0.1, 0.4, 0.0, -0.2]) if model.states[0] == "x" else (ROUGH, [0.3, -0.2, 0.0, 0.0])
    exact = free_run(model, inputs, start)
    found = simulated(built(model), "CoSimulation", model, inputs, start)
    assert np.abs(found - exact).max() < 1e-6 * max(1.0, np.abs(exact).max())
    assert np.abs(free_run(without_delays(model), inputs, start) - exact).max() > 1e-3


def prepared(path, kind, start, force):
    """Return a unit of FMPy's, initialised, and the references of its variables."""
    from fmpy import read_model_description
    from fmpy.fmi3 import FMU3Model, FMU3Slave

    described = read_model_description(path)
    unit = (FMU3Slave if kind == "CoSimulation" else FMU3Model)(
        guid=described.guid, unzipDirectory=path, modelIdentifier="plant", instanceName="a"
    )
    reference = {v.name: v.valueReference for v in described.modelVariables}
    unit.instantiate()
    unit.enterInitializationMode(startTime=0.0)
    unit.setFloat64([reference[n] for n in (*driven_cart().states, "u")], [*start, force])
    unit.exitInitializationMode()
    return unit, reference


def test_a_unit_that_is_set_back_has_its_past_again(built):
    model, start, force = driven_cart("linear", 0.0234), [0.1, 0.4, 0.0, -0.2], push()[:, 0]
    unit, reference = prepared(built(model), "CoSimulation", start, force[0])

    def run(first, last):
        for k in range(first, last):
            unit.setFloat64([reference["u"]], [force[k]])
            unit.doStep(currentCommunicationPoint=TIMES[k], communicationStepSize=TIMES[k + 1] - TIMES[k])
        return unit.getFloat64([reference[s] for s in model.states])

    run(0, 100)
    state = unit.getFMUState()
    after = run(100, 200)
    assert np.allclose(after, free_run(model, push(), start)[200], rtol=1e-6, atol=1e-7)
    unit.setFMUState(state)
    assert run(100, 200) == after
    # Derivatives are those under the input that acts, and not under that which was recorded last.
    unit.setFloat64([reference["u"]], [force[200]])
    rates = unit.getFloat64([reference[f"der({s})"] for s in model.states])
    late = np.interp(2.0 - 0.0234, TIMES, force)
    assert np.allclose(rates, dense(model, [*after, late]), rtol=1e-9)
    unit.freeFMUState(state)
    unit.reset()
    unit.terminate()
    unit.freeInstance()


def test_in_model_exchange_an_input_is_taken_as_it_comes(built):
    model, start = driven_cart("linear", 0.0234), [0.1, 0.4, 0.0, -0.2]
    unit, reference = prepared(built(model), "ModelExchange", start, 1.0)
    for force in (1.0, 7.0):
        unit.setFloat64([reference["u"]], [force])
        rates = unit.getFloat64([reference[f"der({s})"] for s in model.states])
        assert np.allclose(rates, dense(model, [*start, force]), rtol=1e-12)
    unit.terminate()
    unit.freeInstance()


def test_an_input_that_acts_early_is_refused_by_name():
    with pytest.raises(InputError, match=r"an FMU cannot say that the input 'u' acts 0\.25 s before"):
        to_fmu(driven_cart("zero", -0.25))


@pytest.mark.parametrize("name", MODELS)
def test_every_unit_is_one(name, built):
    built(MODELS[name])


def test_the_archive_is_the_same_each_time_and_holds_its_sources():
    model = driven_cart("zero", 0.25)
    (content,) = to_fmu(model).files.values()
    assert content == next(iter(to_fmu(model).files.values()))
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert sorted(archive.namelist()) == [
            "modelDescription.xml",
            "sources/buildDescription.xml",
            "sources/fmi3.c",
            "sources/plant.c",
            "sources/plant.h",
        ]
        described = ElementTree.fromstring(archive.read("modelDescription.xml"))
        assert described.get("instantiationToken").encode() in archive.read("sources/fmi3.c")
    variables = {v.get("name"): v for v in described.iter("Float64")}
    assert "0.25 s after" in variables["u"].get("description")
    assert "0.125" in variables["phi"].get("description")
    assert set(variables) >= {"time", "x", "der(phi_dot)"}


def test_names_are_those_of_the_standard():
    with pytest.raises(InputError, match="'while'"):
        to_fmu(MODELS["coupled"], "while")
