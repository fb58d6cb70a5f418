"""How long the search with process noise takes: simulated masses under white forces, which no model follows exactly.

    ./run python bench/process_noise.py --samples 3000 --seeds 1
    ./run python bench/process_noise.py --single --samples 90000

Two masses on hardening springs, or one with `--single`; every sample has a force of its own, held until the next, which
nobody measures, beside an input that is. Columns: seconds of the whole identification and of the search with process
noise alone; whether the terms are those of the truth; how many coefficients are within 1.96 errors of the truth.
"""

from __future__ import annotations

import argparse
import time
from itertools import combinations_with_replacement

import numpy as np

from odescope import Candidates, Data, Driven, Measured, Study, identify
from odescope.events import Event, Progress

PERIOD, NOISE, FORCE = 0.02, 1e-3, 6.0
X_DDOT = {"x": -40.0, "x_dot": -0.8, "z": 15.0, "x**3": -20.0, "u": 30.0}
Z_DDOT = {"z": -60.0, "z_dot": -1.0, "x": 15.0}
ALONE = {"x": -40.0, "x_dot": -0.8, "x**3": -20.0, "u": 30.0}


def simulate(samples: int, single: bool, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return a log: RK4 at a quarter of the period, input and forces held over each."""
    u = np.repeat(rng.standard_normal(samples // 10 + 1), 10)[:samples]
    force = FORCE * rng.standard_normal((samples, 2))
    step, state, rows = PERIOD / 4.0, np.zeros(4), np.empty((samples, 4))

    def rate(s: np.ndarray, k: int) -> np.ndarray:
        x, z, v, w = s
        first = -40.0 * x - 0.8 * v + (0.0 if single else 15.0 * z) - 20.0 * x**3 + 30.0 * u[k] + force[k, 0]
        return np.array([v, w, first, -60.0 * z - w + 15.0 * x + force[k, 1]])

    for k in range(samples):
        rows[k] = state
        for _ in range(4):
            a = rate(state, k)
            b = rate(state + 0.5 * step * a, k)
            c = rate(state + 0.5 * step * b, k)
            d = rate(state + step * c, k)
            state = state + step / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    measured = rows[:, :2] + NOISE * rng.standard_normal((samples, 2))
    log = {"t": PERIOD * np.arange(samples), "u": u, "x": measured[:, 0]}
    return log if single else {**log, "z": measured[:, 1]}


def study(single: bool) -> Study:
    """Return the study: 60 candidates for two masses, 20 for one, the targets among them."""
    variables = ("x", "x_dot", "u") if single else ("x", "z", "x_dot", "z_dot", "u")
    products = [f"{a}*{b}" for a, b in combinations_with_replacement(variables, 2)]
    cubes = ["x**3", "x_dot**3", "u**3", "x**2*x_dot", "x*x_dot**2"]
    cubes += ["x**2*u", "x_dot**2*u", "x*u**2"] if single else ["z**3", "z_dot**3"]
    targets = ["x_ddot"] if single else ["x_ddot", "z_ddot"]
    return Study(
        coordinates={c: Measured(order=2) for c in (("x",) if single else ("x", "z"))},
        inputs={"u": Driven(hold="zero")},
        data=Data(time="t"),
        library=Candidates(coupled=True, terms=("1", *variables, *products, *cubes, *targets)),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=3000)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--single", action="store_true")
    options = parser.parse_args()
    truths = {"x_ddot": ALONE} if options.single else {"x_ddot": X_DDOT, "z_ddot": Z_DDOT}
    covered = list[bool]()
    print("seed  seconds  of process noise  exact  within")
    for seed in range(options.seeds):
        log = simulate(options.samples, options.single, np.random.default_rng(seed))
        heard = list[float]()

        def hear(event: Event, heard: list[float] = heard) -> None:
            searching = isinstance(event, Progress) and event.part == "search with process noise"
            if searching or heard:
                heard.append(time.perf_counter())

        began = time.perf_counter()
        model = identify(study(options.single), [log], watch=hear).model
        ended = time.perf_counter()
        found = {
            target: {str(t.product.term): t for t in relation.terms if t.product.factor is None}
            for target, relation in zip(truths, model.relations, strict=True)
        }
        exact = all(found[t].keys() == truth.keys() for t, truth in truths.items())
        within = [
            abs(found[t][k].coefficient + truth) < 1.96 * (found[t][k].std_error or 0.0)
            for t in truths
            for k, truth in truths[t].items()
            if k in found[t]
        ]
        covered += within if exact else []
        mode = f"{heard[1] - heard[0]:16.2f}" if heard else f"{'none':>16}"
        print(f"{seed:4}  {ended - began:7.2f}  {mode}  {exact!s:>5}  {sum(within)} of {len(within)}", flush=True)
    if covered:
        print(
            f"of {len(covered)} coefficients of exact models {np.mean(covered):.1%} are within 1.96 errors of the truth"
        )


if __name__ == "__main__":
    main()
