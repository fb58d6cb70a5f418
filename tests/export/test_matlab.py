"""The function file run in Octave, where there is one, by ode45 and ode15s beside odescope's own free runs."""

import shutil
import subprocess

import numpy as np
import pytest
from exported_models import TIMES, driven_cart, free_run, push, reactor, slider
from hand_models import MODELS
from test_c import dense

from odescope.errors import InputError
from odescope.export.programs.matlab import to_matlab

OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
needs_octave = pytest.mark.skipif(OCTAVE is None, reason="no Octave")
ALL = {**MODELS, "cart": driven_cart(), "reactor": reactor(), "slider": slider()}


def octave(folder, script):
    """Return the numbers that a script writes to the variable `out`."""
    (folder / "script.m").write_text(f"{script}\nsave('-ascii', '-double', 'out.txt', 'out');\n")
    command = [OCTAVE, "--no-gui", "--norc", "--quiet", "script.m"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return np.loadtxt(folder / "out.txt", ndmin=2)


def written(values):
    return "[" + "; ".join(" ".join(map(repr, row)) for row in np.atleast_2d(values).tolist()) + "]"


@needs_octave
def test_the_derivative_is_that_of_the_relations(tmp_path):
    rng, calls, exact = np.random.default_rng(3), [], []
    for name, model in ALL.items():
        (tmp_path / f"{name}.m").write_text(to_matlab(model, name).files[f"{name}.m"])
        for at in rng.uniform(0.3, 1.3, (3, len(model.variables))):
            states = len(model.states)
            calls.append(f"{name}(0, {written(at[:states])}', {written(at[states:])}')")
            exact.append(dense(model, at))
    found = octave(tmp_path, "out = [" + "; ".join(calls) + "];")[:, 0]
    assert np.allclose(found, np.concatenate(exact), rtol=1e-12, atol=1e-12)


@needs_octave
@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_ode45_runs_as_the_free_run_does(delay, tmp_path):
    model, start = driven_cart("linear", delay), [0.1, 0.4, 0.0, -0.2]
    (tmp_path / "plant.m").write_text(to_matlab(model, "plant").files["plant.m"])
    fine = np.arange(10001) * 1e-3
    exact = free_run(model, push(fine), start, fine)[::10]
    # Before the record begins, an input has the value of its first sample.
    script = f"""u = @(t) 8*sin(2*max(t, 0)) + 3*cos(5.3*max(t, 0) + 0.4);
    options = odeset('RelTol', 1e-9, 'AbsTol', 1e-11);
    [t, out] = ode45(@(t, x) plant(t, x, u), {written(TIMES)}, {written(start)}', options);"""
    found = octave(tmp_path, script)
    assert np.abs(found - exact).max() < 1e-4 * np.abs(exact).max()  # the free run takes the force as a polygon
    coarse = free_run(model, push(TIMES), start)
    assert np.abs(found - exact).max() < 0.1 * np.abs(coarse - exact).max()


@needs_octave
def test_dry_friction_goes_through_standstill(tmp_path):
    model, start = slider(), [0.3, -0.2, 0.0, 0.0]
    program = to_matlab(model, "plant")
    assert any("tanh" in note for note in program.notes)
    (tmp_path / "plant.m").write_text(program.files["plant.m"])
    exact = free_run(model, 2.2 * np.sin(1.3 * TIMES)[:, None], start)
    script = f"""[t, out] = ode15s(@(t, x) plant(t, x, 2.2*sin(1.3*t)), {written(TIMES)}, {written(start)}',
    odeset('RelTol', 1e-7, 'AbsTol', 1e-9));"""
    assert np.abs(octave(tmp_path, script) - exact)[:, :2].max() < 1e-3


@needs_octave
def test_a_root_of_a_negative_number_is_an_error_and_not_complex(tmp_path):
    (tmp_path / "plant.m").write_text(to_matlab(reactor(), "plant").files["plant.m"])
    with pytest.raises(AssertionError, match="realsqrt"):
        octave(tmp_path, "out = plant(0, [-1; 1], 0);")


def test_names_are_those_of_the_language():
    with pytest.raises(InputError, match="'end'"):
        to_matlab(MODELS["coupled"], "end")
    assert "_np is written v_np" in to_matlab(MODELS["hostile"]).notes
    assert repr(0.1 + 0.2) in to_matlab(MODELS["rational"]).files["plant.m"]
