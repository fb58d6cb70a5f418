"""The Kalman filter that is exported to C beside that of `odescope filter`: processor time of a cycle.

    ./run python bench/exported_filter.py

A cycle is a prediction over one sample and an update with its readings.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from odescope.commands.demo import NOISE, cart_pendulum, simulate_log
from odescope.export.programs.c import to_c
from odescope.observer.noise import ObserverNoise
from odescope.observer.run import ReadyRecord, run_filter
from odescope.recordings.record import Record

REPEATS, PROCESS = 7, 0.1

LOOP = """
#include "plant.h"

int along(const double x[], const double p[], const double u[], const double y[], int count, double h,
          const double q[], const double r[], double out[])
{
    plant_kalman filter;
    plant_kalman_begin(&filter, x, p);
    for (int k = 0; k < count; k++) {
        if (k && plant_kalman_predict(&filter, u + k - 1, u + k, h, q)) return 1;
        if (plant_kalman_update(&filter, y + 2 * k, r, 0, 0)) return 1;
        for (int i = 0; i < PLANT_STATES; i++) out[k * PLANT_STATES + i] = filter.motion.x[i];
    }
    return 0;
}
"""


def main() -> None:
    model, log = cart_pendulum(), simulate_log(seed=0)
    values = np.column_stack([log.measured, log.force])
    ready = ReadyRecord.of(model, Record(log.t, values, ("x", "phi", "u"), (None,) * 3))
    noise = ObserverNoise(dict(zip(("x", "phi"), NOISE[1], strict=True)), dict.fromkeys(model.targets, PROCESS))
    arrays = [ready.first.mean, ready.first.covariance, log.force, log.measured]
    given = [np.ascontiguousarray(a, dtype=np.float64) for a in arrays]
    more = [np.array([0.0, 0.0, PROCESS**2, PROCESS**2]), np.array(NOISE[1]) ** 2, np.empty((len(log.t), 4))]

    with tempfile.TemporaryDirectory() as made:
        along = compiled(Path(made), to_c(model).files).along

        def in_c() -> None:
            passed = [a.ctypes.data_as(ctypes.c_void_p) for a in (*given, *more)]
            step = ctypes.c_double(float(log.t[1] - log.t[0]))
            if along(*passed[:4], len(log.t), step, *passed[4:]):
                raise SystemExit("the filter in C failed")

        states = run_filter(ready, noise).states
        ours, theirs = best(in_c), best(lambda: run_filter(ready, noise))
    apart = np.abs(more[-1] - states).max(axis=0) / np.abs(states).max(axis=0)
    a_cycle = [1e6 * seconds / len(log.t) for seconds in (ours, theirs)]
    print(f"a cycle of the filter in C {a_cycle[0]:.2f} us, of the one in Python {a_cycle[1]:.2f} us:", end=" ")
    print(f"{a_cycle[1] / a_cycle[0]:.1f} times; states apart by at most {apart.max():.1e} of their size")


def compiled(folder: Path, files: dict[str, str]) -> ctypes.CDLL:
    """Return the exported files and the loop as a library."""
    for name, text in {**files, "along.c": LOOP}.items():
        (folder / name).write_text(text)
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise SystemExit("there is no C compiler")
    sources, library = map(str, folder.glob("*.c")), str(folder / "along.so")
    subprocess.run([compiler, "-std=c99", "-O2", "-shared", "-fPIC", "-o", library, *sources, "-lm"], check=True)
    return ctypes.CDLL(library)


def best(work) -> float:
    """Return the least processor time of some runs, in seconds."""
    found = []
    for _ in range(REPEATS):
        begin = time.process_time()
        work()
        found.append(time.process_time() - begin)
    return min(found)


if __name__ == "__main__":
    main()
