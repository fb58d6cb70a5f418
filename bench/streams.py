"""Logs larger than memory, the floors of the pass over the samples, and growth in recordings: for bench/anchors.py.

What it does alone:

    ./run python bench/streams.py run LOG.parquet     # one streamed identification: a line of JSON
    ./run python bench/streams.py write LOG.parquet --rows 1e8
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
import pyarrow as pa
from demo_table import STUDY
from pyarrow import parquet
from threadpoolctl import threadpool_limits
from timing import alternate, command, duration, figures, slope

from odescope.commands.demo import cart_pendulum
from odescope.library.candidates import Library
from odescope.library.parse import Scope
from odescope.library.tape import evaluate, write_tape
from odescope.regression.factor import factorise

PERIOD, TONES, NOISE = 0.001, 12, (0.005, 0.0025)
GROUP = 1 << 20  # rows of a row group
MEMORY = 1000  # MB, the default of a study


@numba.njit(cache=True)
def force(t, tones):
    total = 0.0
    for k in range(tones.shape[1]):
        total += tones[0, k] * np.sin(tones[1, k] * t + tones[2, k])
    return total


@numba.njit(cache=True)
def slopes(state, u, c, out):
    """The demo's pendulum on a cart, by the coefficients of its explicit form."""
    cos, sin = np.cos(state[1]), np.sin(state[1])
    denominator = 1.0 + c[0] * cos * cos
    cart = c[1] * u + c[2] * state[2] + c[3] * state[3] ** 2 * sin + c[4] * state[3] * cos + c[5] * sin * cos
    angle = (c[6] * u + c[7] * state[2]) * cos + c[8] * state[3] ** 2 * sin * cos + c[9] * state[3] + c[10] * sin
    out[0], out[1], out[2], out[3] = state[2], state[3], cart / denominator, angle / denominator


@numba.njit(cache=True)
def runge_kutta(state, first, count, h, tones, c):
    """Continue the run in place; return positions and force at `count` samples from sample `first` on, (count, 3)."""
    found = np.empty((count, 3))
    k1, k2, k3, k4 = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    begin = force(first * h, tones)
    for k in range(count):
        t = (first + k) * h
        middle, end = force(t + 0.5 * h, tones), force(t + h, tones)
        found[k, 0], found[k, 1], found[k, 2] = state[0], state[1], begin
        slopes(state, begin, c, k1)
        slopes(state + 0.5 * h * k1, middle, c, k2)
        slopes(state + 0.5 * h * k2, middle, c, k3)
        slopes(state + h * k3, end, c, k4)
        state += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        begin = end
    return found


def write_log(path: Path, rows: int, seed: int = 0) -> None:
    """Write a run of the demo's pendulum under a sum of tones, at a thousand samples a second, as Parquet."""
    rng = np.random.default_rng(seed)
    tones = np.array([rng.standard_normal(TONES), rng.uniform(0.3, 19.0, TONES), rng.uniform(0.0, 6.28, TONES)])
    tones[0] *= 20.0 / np.sqrt(0.5 * tones[0] @ tones[0])
    cart, angle = ({t.text: t.coefficient for t in r.terms} for r in cart_pendulum().relations)
    order = ("u", "x_dot", "phi_dot**2*sin(phi)", "phi_dot*cos(phi)", "cos(phi)*sin(phi)")
    turned = ("u*cos(phi)", "x_dot*cos(phi)", "phi_dot**2*cos(phi)*sin(phi)", "phi_dot", "sin(phi)")
    c = np.array([cart["x_ddot*cos(phi)**2"], *(-cart[t] for t in order), *(-angle[t] for t in turned)])
    state, schema = np.array([0.0, 2.9, 0.0, 0.0]), pa.schema([(n, pa.float64()) for n in ("t", "x", "phi", "u")])
    with parquet.ParquetWriter(path, schema) as writer:
        for first in range(0, rows, GROUP):
            found = runge_kutta(state, first, min(GROUP, rows - first), PERIOD, tones, c)
            found[:, :2] += np.array(NOISE) * rng.standard_normal((len(found), 2))
            t = PERIOD * np.arange(first, first + len(found))
            writer.write_table(pa.table([t, *found.T], schema=schema))


def run(path: Path) -> None:
    """Identify a log by regression and likelihood; print rows, seconds of the pass and in all, and peak memory."""
    import msgspec

    from odescope.model.scores import Streamed
    from odescope.parallel.memory import peak_bytes
    from odescope.pipeline.identification import identify
    from odescope.study.options import Data

    study = msgspec.structs.replace(STUDY, data=Data(files=(str(path),), time="t", memory=MEMORY))
    begin = time.perf_counter()
    result = identify(study)
    seconds = time.perf_counter() - begin
    streamed = result.model.scores.streamed or Streamed(result.records.samples, 0, 0)
    truth = {t.text: t.coefficient for r in cart_pendulum().relations for t in r.terms}
    found = {t.text: t.coefficient for r in result.model.relations for t in r.terms}
    exact = [{t.text for t in r.terms} for r in result.model.relations] == [
        {t.text for t in r.terms} for r in cart_pendulum().relations
    ]
    worst = max((abs(found[k] / v - 1.0) for k, v in truth.items() if k in found), default=np.nan)
    print(
        json.dumps(
            {
                "rows": streamed.rows,
                "chunks": streamed.portions,
                "pass": result.seconds.get("recordings"),
                "seconds": seconds,
                "megabytes": peak_bytes() / 1e6,
                "exact": exact,
                "worst": worst,
            }
        )
    )


def streamed(sizes: tuple[int, ...]) -> tuple[list[tuple[str, ...]], str]:
    """Return a line for each number of rows, and what follows for 10^8."""
    lines, passes = [], []
    with tempfile.TemporaryDirectory() as folder:
        for rows in sizes:
            path = Path(folder) / f"{rows}.parquet"
            write_log(path, rows)
            found = json.loads(command([sys.executable, __file__, "run", str(path)]).output)
            size = path.stat().st_size
            path.unlink()
            passes.append(found["pass"])
            lines.append(
                (
                    f"{rows:,}".replace(",", " "),
                    f"{size / 1e6:.0f}",
                    str(found["chunks"]),
                    duration(found["pass"]),
                    figures(rows / found["pass"] / 1e6),
                    duration(found["seconds"]),
                    f"{found['megabytes']:.0f}",
                    "yes" if found["exact"] else "no",
                    f"{100.0 * found['worst']:.2g} %",
                )
            )
    steep, rate = slope(sizes, passes), sizes[-1] / passes[-1]
    told = (
        f"The time of the pass grows as the rows to the power {steep:.2f}; at {figures(rate / 1e6)} million rows a"
        f" second 10^8 rows take {duration(1e8 / rate)}"
        + (", as measured." if sizes[-1] >= 10**8 else f", extrapolated from {figures(sizes[-1] / 1e6)} million.")
    )
    return lines, told


def floors(repeats: int) -> list[tuple[str, ...]]:
    """Return how far evaluation and factorisation of blocks are from what the machine can do, on one and two cores."""
    m, block, blocks = 56, 4096, 48
    names = ["a", "b", "c"]
    library = list(Library.of(names, Scope.of(names)).powers(5))[:m]
    rng, lines = np.random.default_rng(0), []
    columns = [rng.standard_normal((3, block)) for _ in range(blocks)]
    values = [np.ascontiguousarray(rng.standard_normal((block, m))) for _ in range(blocks)]
    source = [rng.standard_normal((m, block)) for _ in range(blocks)]
    square = [rng.standard_normal((512, 512)) for _ in range(8)]
    tape = write_tape(names, library)
    for cores in (1, os.cpu_count() or 1):
        with ThreadPoolExecutor(cores) as pool, threadpool_limits(1, "blas"):

            def each(work, items, pool=pool):
                return lambda: list(pool.map(work, items))

            timed = alternate(
                {
                    "evaluate": each(lambda c: evaluate(tape, c), columns),
                    "copy": each(np.copy, source),
                    "factor": each(lambda v: factorise([v]), values),
                    "product": each(lambda s: s @ s, square),
                },
                repeats,
            )
        written = 8.0 * m * block * blocks / 1e9
        # R alone of a Householder QR.
        work = 2.0 * m * m * (block - m / 3.0) * blocks / 1e9
        rates = {
            "evaluate": written / timed["evaluate"].median,
            "copy": written / timed["copy"].median,
            "factor": work / timed["factor"].median,
            "product": 2.0 * 512**3 * len(square) / 1e9 / timed["product"].median,
        }
        told = f"{cores} core{'s' * (cores > 1)}"
        lines += [
            (f"evaluating {m} products, {told}", f"{figures(rates['evaluate'])} GB/s written", "copying as much",
             f"{figures(rates['copy'])} GB/s", f"{100 * rates['evaluate'] / rates['copy']:.0f} %"),
            (f"factoring {m} columns, {told}", f"{figures(rates['factor'])} GFlop/s", "product of matrices",
             f"{figures(rates['product'])} GFlop/s", f"{100 * rates['factor'] / rates['product']:.0f} %"),
        ]  # fmt: skip
    return lines


def recordings(counts: tuple[int, ...], repeats: int) -> tuple[str, str, str, float]:
    """Return how the whole identification grows with the number of recordings of 6500 samples, each a file."""
    import msgspec

    from odescope.likelihood.search import LikelihoodSearch
    from odescope.pipeline.identification import identify
    from odescope.study.options import Data

    times = []
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{k}.parquet" for k in range(max(counts))]
        for k, path in enumerate(files):
            write_log(path, 6500, seed=k)
        for count in counts:
            data = Data(files=tuple(map(str, files[:count])), time="t")
            study = msgspec.structs.replace(STUDY, data=data, likelihood=LikelihoodSearch(enabled=False))
            times.append(alternate({"identify": lambda study=study: identify(study)}, repeats)["identify"].best)
    steep = slope(counts, times)
    return (
        "identification without likelihood over recordings of 6 500 samples",
        ", ".join(map(str, counts)),
        ", ".join(figures(1e3 * t) for t in times),
        steep,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "write"))
    parser.add_argument("log", type=Path)
    parser.add_argument("--rows", type=float, default=1e7)
    options = parser.parse_args()
    if options.what == "write":
        write_log(options.log, int(options.rows))
    else:
        run(options.log)


if __name__ == "__main__":
    main()
