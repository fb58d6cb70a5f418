"""Exports at times far from zero, as of clocks that count from 1970: in programs of their own, which may hang."""

import subprocess
import sys

import numpy as np
import pytest
from exported_models import driven_cart, free_run, push
from test_c import COMPILER, needs_compiler
from test_fmu import built  # noqa: F401

from odescope.export.programs.c import to_c

SECONDS = 20  # that a run may take, of a few hundredths
START = [0.1, 0.4, 0.0, -0.2]
FAR = (2.0**24 - 0.5, 1.7e9 + 0.123456)  # the spacing of doubles doubles within the run; a clock that counts from 1970
STEPS = 0.01 * np.arange(101)

MAIN = """
#include "plant.h"
#include <stdio.h>
int main(void)
{
    static double t[101], u[101];
    double x[PLANT_STATES];
    plant_motion motion;
    for (int i = 0; i < PLANT_STATES; i++) if (scanf("%lf", x + i) != 1) return 1;
    for (int k = 0; k < 101; k++) if (scanf("%lf %lf", t + k, u + k) != 2) return 1;
    plant_begin(&motion, x);
    for (int k = 0; k < 100; k++) if (plant_follow(&motion, t, u, 101, k, 1e-3)) return 1;
    for (int i = 0; i < PLANT_STATES; i++) printf("%.17g\\n", motion.x[i]);
    return 0;
}
"""

IMPORTER = """
import sys
from fmpy import read_model_description
from fmpy.fmi3 import FMU3Slave
path, *numbers = sys.argv[1:]
start, begin = [float(v) for v in numbers[:4]], float(numbers[4])
described = read_model_description(path)
unit = FMU3Slave(guid=described.guid, unzipDirectory=path, modelIdentifier="plant", instanceName="a")
reference = {v.name: v.valueReference for v in described.modelVariables}
states = [reference[n] for n in ("x", "phi", "x_dot", "phi_dot")]
unit.instantiate()
unit.enterInitializationMode(startTime=begin)
unit.setFloat64([*states, reference["u"]], [*start, float(numbers[5])])
unit.exitInitializationMode()
for k, force in enumerate(numbers[5:-1]):
    unit.setFloat64([reference["u"]], [float(force)])
    unit.doStep(currentCommunicationPoint=begin + 0.01 * k, communicationStepSize=0.01)
print(*unit.getFloat64(states))
"""


def finished(command, given=None):
    done = subprocess.run(command, input=given, capture_output=True, text=True, check=False, timeout=SECONDS)
    assert done.returncode == 0, done.stderr
    return np.array(done.stdout.split(), dtype=float)


@needs_compiler
@pytest.mark.parametrize(("hold", "delay"), [("band-limited", 0.0), ("linear", 0.137), ("zero", -0.0123)])
def test_the_inputs_of_c_find_their_corners_at_any_time(hold, delay, tmp_path):
    model, force = driven_cart(hold, delay), push(STEPS)
    for name, text in {**to_c(model, "plant").files, "main.c": MAIN}.items():
        (tmp_path / name).write_text(text)
    program = str(tmp_path / "main")
    command = [COMPILER, "-std=c99", "-O1", "-o", program, *map(str, tmp_path.glob("*.c")), "-lm"]
    subprocess.run(command, capture_output=True, check=True)
    exact = free_run(model, force, START, STEPS)[-1]
    for since in (0.0, *FAR):
        rows = "\n".join(f"{t!r} {u!r}" for t, u in zip((since + STEPS).tolist(), force[:, 0].tolist(), strict=True))
        found = finished([program], " ".join(map(str, START)) + "\n" + rows)
        np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-8 + 1e2 * np.spacing(since))


@pytest.mark.parametrize("hold", ["linear", "zero"])
def test_a_unit_delays_inputs_at_any_time(hold, built):  # noqa: F811
    model, force = driven_cart(hold, 0.137), push(STEPS)
    unit, exact = built(model), free_run(model, force, START, STEPS)[-1]
    for since in FAR:
        numbers = [*START, since, *force[:, 0].tolist()]
        found = finished([sys.executable, "-c", IMPORTER, unit, *map(repr, numbers)])
        np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-8 + 1e2 * np.spacing(since))
