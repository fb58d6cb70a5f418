"""First experiments: logs of 15 to 900 samples by default settings, a mechanism, a decay or a growth each.

    ./run python bench/first_logs.py --seeds 20 --detail

What a student writes down or films: cooling, draining, discharging, growing, falling, swinging, with the noise of a
ruler, a thermometer or a video, rounded as read. A study names the coordinates, their order, and which are angles. By
row: runs with the terms of the law and no other, runs with noise of the process, of which there is none, and seconds
(median).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_limits

from odescope import Data, Measured, NoModelError, Study, identify

Rates = Callable[[float, np.ndarray], Sequence[float]]


@dataclass(frozen=True)
class Experiment:
    """What is done: the rates of all states, where recordings begin, how they are sampled and read, and the law.

    `digits` are those that are written down, None for all; `law` holds the terms of each coordinate's equation, or
    several such sets where they say the same of what was recorded.
    """

    rates: Rates
    starts: tuple[tuple[float, ...], ...]
    seconds: float
    samples: int
    noise: float
    coordinates: dict[str, Measured]
    law: tuple[tuple[set[str], ...], ...]
    digits: int | None = None


AMOUNT, POSITION, ANGLE = Measured(), Measured(order=2), Measured(order=2, angle=True)
PLANE = {"x": POSITION, "y": POSITION}
SPEED, DISTANCE = "sqrt(x_dot**2 + y_dot**2)", "sqrt(x**2 + y**2)"
DRAGS = ({"1", "y_dot**2"}, {"1", "y_dot*abs(y_dot)"})  # of what only falls
EXPERIMENTS = {
    "cooling": Experiment(
        lambda _, x: [-0.04 * (x[0] - 21.5)], ((85.0,),), 60, 61, 0.3, {"T": AMOUNT}, (({"1", "T"},),), 1
    ),
    "capacitor": Experiment(lambda _, x: [-x[0] / 4.7], ((9.0,),), 20, 41, 0.05, {"V": AMOUNT}, (({"V"},),), 2),
    "draining tank": Experiment(
        lambda _, x: [-0.02 * np.sqrt(max(x[0], 0.0))], ((0.5,),), 60, 61, 0.002, {"h": AMOUNT}, (({"sqrt(h)"},),), 3
    ),
    "first order": Experiment(lambda _, x: [-0.012 * x[0]], ((1.0,),), 300, 31, 0.01, {"c": AMOUNT}, (({"c"},),), 3),
    "second order": Experiment(
        lambda _, x: [-0.08 * x[0] ** 2], ((2.0,),), 60, 31, 0.01, {"c": AMOUNT}, (({"c**2"},),), 3
    ),
    "two decays": Experiment(
        lambda _, x: [-0.3 * x[0], 0.3 * x[0] - 0.1 * x[1]],
        ((100.0, 0.0),),
        30,
        61,
        1.0,
        {"A": AMOUNT, "B": AMOUNT},
        (({"A"},), ({"A", "B"},)),
        1,
    ),
    "growth": Experiment(
        lambda _, x: [0.55 * x[0] * (1.0 - x[0] / 660.0)],
        ((10.0,),),
        20,
        21,
        12.0,
        {"N": AMOUNT},
        (({"N", "N**2"},),),
        0,
    ),
    "yeast, twice": Experiment(
        lambda _, x: [0.4 * x[0] * (1.0 - x[0] / 13.0)],
        ((0.45,), (2.0,)),
        18,
        19,
        0.2,
        {"Y": AMOUNT},
        (({"Y", "Y**2"},),),
        2,
    ),
    "hare and lynx": Experiment(
        lambda _, x: [0.55 * x[0] - 0.028 * x[0] * x[1], -0.84 * x[1] + 0.026 * x[0] * x[1]],
        ((30.0, 4.0),),
        20,
        41,
        1.5,
        {"H": AMOUNT, "L": AMOUNT},
        (({"H", "H*L"},), ({"L", "H*L"},)),
        1,
    ),
    "epidemic": Experiment(
        lambda _, x: [-0.0022 * x[0] * x[1], 0.0022 * x[0] * x[1] - 0.44 * x[1]],
        ((762.0, 1.0),),
        14,
        15,
        4.0,
        {"S": AMOUNT, "I": AMOUNT},
        (({"I*S"},), ({"I", "I*S"},)),
        0,
    ),
    "spring": Experiment(
        lambda _, x: [x[1], -25.0 * x[0] - 0.3 * x[1]],
        ((0.08, 0.0),),
        8,
        240,
        0.001,
        {"x": POSITION},
        (({"x", "x_dot"},),),
    ),
    "stiffening spring": Experiment(
        lambda _, x: [x[1], -40.0 * x[0] - 0.6 * x[1] - 30.0 * x[0] ** 3],
        ((1.0, 0.0),),
        12,
        600,
        0.005,
        {"q": POSITION},
        (({"q", "q_dot", "q**3"},),),
    ),
    "pendulum": Experiment(
        lambda _, x: [x[1], -9.81 / 0.6 * np.sin(x[0]) - 0.08 * x[1]],
        ((1.1, 0.0),),
        10,
        300,
        0.01,
        {"p": ANGLE},
        (({"sin(p)", "p_dot"},),),
    ),
    "pendulum in air": Experiment(
        lambda _, x: [x[1], -9.81 / 0.6 * np.sin(x[0]) - 0.05 * x[1] - 0.03 * x[1] * abs(x[1])],
        ((2.6, 0.0),),
        15,
        900,
        0.01,
        {"p": ANGLE},
        (({"sin(p)", "p_dot", "p_dot*abs(p_dot)"},),),
    ),
    "fall": Experiment(
        lambda _, x: [x[1], -9.81 + 0.5 * x[1] ** 2], ((2.5, 0.0),), 1.2, 60, 0.004, {"y": POSITION}, (DRAGS,)
    ),
    "throw": Experiment(
        lambda _, x: [x[2], x[3], 0.0, -9.81], ((0.3, 1.2, 5.0, 6.0),), 1.2, 73, 0.003, PLANE, ((set(),), ({"1"},)), 3
    ),
    "throw in air": Experiment(
        lambda _, x: [x[2], x[3], *(np.array([0.0, -9.81]) - 0.03 * x[2:] * np.hypot(x[2], x[3]))],
        ((0.3, 1.2, 9.0, 12.0),),
        2.5,
        151,
        0.004,
        PLANE,
        (({f"x_dot*{SPEED}"},), ({"1", f"y_dot*{SPEED}"},)),
        3,
    ),
    "planet": Experiment(
        lambda _, x: [x[2], x[3], *(-4.0 * np.pi**2 * x[:2] / np.hypot(x[0], x[1]) ** 3)],
        ((1.0, 0.0, 0.0, 5.5),),
        3,
        300,
        0.003,
        PLANE,
        (({f"x*{DISTANCE}**-3"},), ({f"y*{DISTANCE}**-3"},)),
    ),
}


def logs(of: Experiment, rng: np.random.Generator) -> list[dict[str, np.ndarray]]:
    """Return the recordings of an experiment as they were read."""
    t, found = np.linspace(0.0, of.seconds, of.samples), []
    for start in of.starts:
        run = solve_ivp(of.rates, (0.0, of.seconds), start, t_eval=t, rtol=1e-9, atol=1e-11).y[: len(of.coordinates)]
        run = run + of.noise * rng.standard_normal(run.shape)
        run = run if of.digits is None else np.round(run, of.digits)
        found.append({"t": t, **dict(zip(of.coordinates, run, strict=True))})
    return found


def attempt(job: tuple[str, int]) -> tuple[list[str] | None, bool, float]:
    """Return the terms that a run found where they are not the law, whether under process noise, and its seconds."""
    name, seed = job
    of, begin = EXPERIMENTS[name], time.perf_counter()
    study = Study(data=Data(time="t"), coordinates=of.coordinates)
    try:
        with threadpool_limits(1):
            result = identify(study, logs(of, np.random.default_rng(seed)))
    except NoModelError as error:
        return [str(error)], False, time.perf_counter() - begin
    seconds = time.perf_counter() - begin
    pairs = zip(result.model.relations, result.model.targets, strict=True)
    found = [{t.text for t in relation.terms} - {target} for relation, target in pairs]
    right = all(terms in alike for terms, alike in zip(found, of.law, strict=True))
    process = result.refinement is not None and result.refinement.process is not None
    return None if right else [" + ".join(sorted(terms)) for terms in found], process, seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--only", nargs="+", choices=EXPERIMENTS, default=list(EXPERIMENTS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--detail", action="store_true", help="print the terms that are wrong")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    print("| experiment | samples | right | process noise | s |\n|---|---:|---:|---:|---:|")
    with ProcessPoolExecutor(options.workers) as pool:
        for name in options.only:
            of = EXPERIMENTS[name]
            ends = list(pool.map(attempt, [(name, seed) for seed in seeds]))
            right, process = sum(wrong is None for wrong, _, _ in ends), sum(p for _, p, _ in ends)
            seconds = np.median([s for _, _, s in ends])
            samples = of.samples * len(of.starts)
            print(f"| {name} | {samples} | {right}/{len(ends)} | {process} | {seconds:.1f} |", flush=True)
            for seed, (wrong, _, _) in zip(seeds, ends, strict=True):
                if wrong is not None and options.detail:
                    print(f"    {seed}: {'; '.join(wrong)}")


if __name__ == "__main__":
    main()
