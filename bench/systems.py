"""Recovery of systems other than the demo, with the default library and all defaults.

    ./run python bench/systems.py --seeds 10 --noise 0.001 0.01 0.05

Michaelis-Menten x' = .6 - 1.5 x/(.3 + x) (8 recordings of 8 s), Lorenz, a predator and prey with Holling's second
response (4 recordings), and a driven van der Pol oscillator of which the position alone is measured. Noise is relative
to each coordinate's standard deviation.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_limits
from truths import multiplied_out

from odescope import Data, Driven, Measured, NoModelError, Study, identify


@dataclass(frozen=True)
class Case:
    """A system: its study, its recordings from a generator, the terms of its relations."""

    study: Study
    runs: Callable[[np.random.Generator], list[dict[str, np.ndarray]]]
    measured: tuple[str, ...]
    truth: dict[str, set[str]]


def solve(f: Callable, t: np.ndarray, start: np.ndarray, **options: float) -> np.ndarray:
    return solve_ivp(f, (t[0], t[-1]), start, t_eval=t, rtol=1e-10, atol=1e-12, **options).y


def michaelis_menten(rng: np.random.Generator) -> list[dict[str, np.ndarray]]:
    t = np.linspace(0.0, 8.0, 401)
    return [
        {"t": t, "x": solve(lambda _, x: 0.6 - 1.5 * x / (0.3 + x), t, np.array([start]))[0]}
        for start in rng.uniform(0.05, 4.0, 8)
    ]


def lorenz(rng: np.random.Generator) -> list[dict[str, np.ndarray]]:
    t = np.arange(0.0, 20.0, 0.002)

    def f(_: float, s: np.ndarray) -> list[float]:
        return [10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 8 / 3 * s[2]]

    return [{"t": t, **dict(zip("xyz", solve(f, t, np.array([-8 + rng.standard_normal(), 7, 27])), strict=True))}]


def predator_prey(rng: np.random.Generator) -> list[dict[str, np.ndarray]]:
    t = np.arange(0.0, 40.0, 0.05)

    def f(_: float, s: np.ndarray) -> list[float]:
        eaten = s[0] * s[1] / (1 + 0.5 * s[0])
        return [s[0] * (1 - s[0] / 3) - eaten, 0.6 * eaten - 0.4 * s[1]]

    return [{"t": t, **dict(zip("xy", solve(f, t, rng.uniform(0.3, 2.5, 2)), strict=True))} for _ in range(4)]


def van_der_pol(rng: np.random.Generator) -> list[dict[str, np.ndarray]]:
    period, count = 0.01, 6001
    t = period * np.arange(count)
    spectrum = np.fft.rfft(rng.standard_normal(count))
    spectrum[np.fft.rfftfreq(count, period) > 0.5] = 0.0
    u = np.fft.irfft(spectrum, count)
    u *= 1.5 / u.std()

    def f(now: float, s: np.ndarray) -> list[float]:
        return [s[1], 1.5 * (1 - s[0] ** 2) * s[1] - s[0] + float(np.interp(now, t, u))]

    return [{"t": t, "x": solve(f, t, np.array([1.0, 0.0]), max_step=0.02)[0], "u": u}]


TIME = Data(time="t")
CASES = {
    "michaelis-menten": Case(
        Study(data=TIME, coordinates={"x": Measured()}),
        michaelis_menten,
        ("x",),
        {"x_dot": {"1", "x", "x_dot", "x*x_dot"}},
    ),
    "lorenz": Case(
        Study(data=TIME, coordinates={"x": Measured(), "y": Measured(), "z": Measured()}),
        lorenz,
        ("x", "y", "z"),
        {"x_dot": {"x", "y", "x_dot"}, "y_dot": {"x", "y", "x*z", "y_dot"}, "z_dot": {"x*y", "z", "z_dot"}},
    ),
    "predator-prey": Case(
        Study(data=TIME, coordinates={"x": Measured(), "y": Measured()}),
        predator_prey,
        ("x", "y"),
        {
            "x_dot": {"x", "x**2", "x**3", "x*y", "x_dot", "x*x_dot"},
            "y_dot": {"y", "x*y", "y_dot", "x*y_dot"},
        },
    ),
    "van der pol": Case(
        Study(data=TIME, coordinates={"x": Measured(order=2)}, inputs={"u": Driven()}),
        van_der_pol,
        ("x",),
        {"x_ddot": {"x", "x_dot", "x**2*x_dot", "u", "x_ddot"}},
    ),
}


def noisy(case: Case, noise: float, rng: np.random.Generator) -> list[dict[str, np.ndarray]]:
    """The recordings of a case with white noise, relative to each coordinate's standard deviation over all of them."""
    runs = case.runs(rng)
    for name in case.measured:
        size = noise * float(np.std(np.concatenate([run[name] for run in runs])))
        for run in runs:
            run[name] = run[name] + size * rng.standard_normal(len(run[name]))
    return runs


def attempt(job: tuple[str, float, int]) -> dict[str, str]:
    name, noise, seed = job
    case = CASES[name]
    try:
        with threadpool_limits(1):
            result = identify(case.study, noisy(case, noise, np.random.default_rng(seed)))
    except NoModelError as error:
        return dict.fromkeys(case.truth, f"none: {error.stage}")
    outcome = {}
    for target, relation in zip(result.model.targets, result.model.relations, strict=True):
        found = {term.product.expanded.text for term in multiplied_out(relation).terms}
        truth = case.truth[target]
        extra, missing = sorted(found - truth), sorted(truth - found)
        outcome[target] = "" if found == truth else f"missing {missing}, extra {extra}"
    return outcome


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.001, 0.01, 0.05])
    parser.add_argument("--systems", nargs="+", choices=CASES, default=list(CASES))
    options = parser.parse_args()
    jobs = [(name, noise, seed) for name in options.systems for noise in options.noise for seed in range(options.seeds)]
    with ProcessPoolExecutor(2) as pool:
        results = dict(zip(jobs, pool.map(attempt, jobs), strict=True))
    for name in options.systems:
        for noise in options.noise:
            for target in CASES[name].truth:
                found = [results[name, noise, seed][target] for seed in range(options.seeds)]
                print(f"{name:<18} noise {noise:<6} {target:<7} exact {found.count('')}/{options.seeds}")
                for seed, failure in enumerate(found):
                    if failure:
                        print(f"      seed {seed}: {failure}")


if __name__ == "__main__":
    main()
