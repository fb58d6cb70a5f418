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
from test_c import COMPILER, STRICT

from odescope.errors import InputError
from odescope.export.programs.fmu import to_fmu
from odescope.recordings.coordinate import Input

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


def simulated(unit, kind, model, inputs, start, **options):
    from fmpy import simulate_fmu

    names = model.states
    types = [("time", np.double), *((i.name, np.double) for i in model.inputs)]
    signals = np.array([(t, *row) for t, row in zip(TIMES, inputs.tolist(), strict=True)], dtype=types)
    result = simulate_fmu(
        unit,
        fmi_type=kind,
        start_values=dict(zip(names, start, strict=True)),
        input=signals,
        stop_time=10.0,
        output_interval=0.01,
        output=list(names),
        **options,
    )
    found = np.column_stack([result[n] for n in names])
    time = np.asarray(result["time"]) / 0.01
    on = np.abs(time - np.round(time)) < 1e-6  # events have rows of their own; of two at an instant the later counts
    last = dict(zip(np.round(time[on]).astype(int), found[on], strict=True))
    return np.array([last[k] for k in range(len(TIMES))])


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
