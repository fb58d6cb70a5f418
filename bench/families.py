"""Recovery of laws with functions beside powers, at 1 % noise.

In the first rows the library names the function, its constants declared with ranges of one or two decades; in those
that say "unnamed" it does not.

    ./run python bench/families.py --seeds 20 --workers 2

A run is right where every equation has the terms of the truth and no others, constants by name. Over the right ones:
the worst error of a constant in its standard errors, and how many 95 % intervals of coefficients and constants hold
the truth. Seconds are those of the processor, median and most.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_limits

from odescope import NoModelError, identify
from odescope.model.model import Model
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

NOISE = 0.01  # of the standard deviation of each coordinate
HEADER = "| system | right | constants, worst, s.e. | coverage | s |\n|---|---:|---:|---:|---:|"

Rate = Callable[[float, np.ndarray, float], Sequence[float]]
Equation = Mapping[str, float]  # what the terms add up to, which is the target


@dataclass(frozen=True)
class System:
    """A law, its recordings, and the library that a user would give; `driven` draws an input."""

    rate: Rate
    starts: Sequence[Sequence[float]]
    times: np.ndarray
    names: Sequence[str]
    order: int
    library: Candidates
    truth: Sequence[Equation]
    constants: Mapping[str, float]
    driven: Callable[[np.ndarray, np.random.Generator], np.ndarray] | None = None
    inputs: Mapping[str, Driven] = field(default_factory=dict)


def excitation(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    f, phase = rng.uniform(0.1, 1.2, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    return 1.2 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1)


def jacket(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    one, other = rng.uniform(0.0, 2.0 * np.pi, 2)
    return 330.0 + 30.0 * np.sin(0.15 * t + one) + 15.0 * np.sin(0.4 * t + other)


def clock(t: np.ndarray, _: np.random.Generator) -> np.ndarray:
    return t


def _stage(_, x, u):
    return x[1], u - 4.0 * x[0] - 0.3 * x[1] - 0.8 * np.tanh(x[1] / 0.15)


def _forced(_, x, u):
    return x[1], 1.5 * np.sin(1.37 * u) - 4.0 * x[0] - 0.3 * x[1]


def _reactor(_, x, u):
    reacting = 2e3 * x[0] * np.exp(-3000.0 / x[1])
    return 0.1 - 0.1 * x[0] - reacting, 100.0 * reacting + 0.3 * (u - x[1])


def _hill(*at):
    x = at[1]
    raised = x[1] ** 2.5
    return 2.0 * raised / (0.7**2.5 + raised) - x[0], 1.2 * x[0] - 0.8 * x[1]


def _switch(*at):
    x = at[1]
    return 1.5 / (1.0 + np.exp(-(x[1] - 0.9) * 6.0)) - x[0], 1.2 * x[0] - 0.8 * x[1]


def _enzyme(*at):
    x = at[1]
    flux = 1.2 * x[0] / (0.4 + x[0])
    return 0.1 * x[1] - flux, flux - 0.6 * x[1], 0.5 * x[1]


def _gene(_, x, u):
    return (u + 2.0 * x[0] ** 2 / (1.0 + x[0] ** 2) - 1.2 * x[0],)


def _toggle(*at):
    a, b = at[1]
    return 3.0 / (1.0 + b**3) - a, 2.5 / (1.0 + a**3) - 0.8 * b


def _inhibited(_, x, u):
    growth = 0.5 * x[1] / (0.8 + x[1] + x[1] ** 2 / 4.0) * x[0]
    return growth - u * x[0], u * (8.0 - x[1]) - 2.0 * growth


def dilution(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    f, phase = rng.uniform(0.01, 0.1, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    return 0.1 + 0.012 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1)


def inflow(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    f, phase = rng.uniform(0.002, 0.02, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    return np.maximum(1.0 + 0.12 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1), 0.0)


def feed(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    f, phase = rng.uniform(0.02, 0.3, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
    return 0.4 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=1)


def induction(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.45 + 0.5 * feed(t, rng)


def _tanks(_, h, u):
    first, second = 0.15 * np.sqrt(max(h[0], 0.0)), 0.12 * np.sqrt(max(h[1], 0.0))
    return 0.3 * u - first, first - second


def _valve(_, x, u):
    return (np.tanh(u / 0.6) - 0.5 * x[0],)


def _growth(_, x, u):
    return (1.0 + 0.7 * u - 0.4 * np.exp(x[0] / 0.7),)


def _shaken(t, x, _):
    return x[1], 1.5 * np.sin(1.37 * t + 1.1) - 4.0 * x[0] - 0.3 * x[1]


def _season(t, x, _):
    return x[0] * (1.0 - 0.5 * x[1]) + 0.2 * np.sin(0.9 * t), x[1] * (0.4 * x[0] - 0.8)


def _pumped(t, x, _):
    return x[1], -(2.0 + 1.1 * np.cos(3.3 * t + 0.4)) * x[0] - 0.1 * x[1]


def _contagion(t, x, _):
    infected = (0.5 + 0.125 * np.cos(0.3 * t)) * x[0] * x[1]
    return 0.03 - 0.03 * x[0] - infected, infected - 0.2 * x[1]


ONE_INPUT = {"u": Driven()}
THREE = ((0.1, 2.0), (1.5, 0.3), (1.0, 1.0))
SYSTEMS = {
    "tanh friction, width": System(
        _stage, [(0.5, 0.0)], np.arange(0.0, 30.0, 0.01), "x", 2,
        Candidates(basis=("x", "x_dot", "u", "tanh(x_dot/v0)"), degree=2, parameters={"v0": (0.01, 1.0)}),
        [{"x": -4.0, "x_dot": -0.3, "u": 1.0, "tanh(x_dot/v0)": -0.8}], {"v0": 0.15}, excitation, ONE_INPUT,
    ),
    "sine forcing, frequency": System(
        _forced, [(0.5, 0.0)], np.arange(0.0, 40.0, 0.02), "x", 2,
        Candidates(basis=("x", "x_dot", "sin(w*u)", "cos(w*u)"), degree=2, parameters={"w": (0.5, 5.0)}),
        [{"x": -4.0, "x_dot": -0.3, "sin(u*w)": 1.5}], {"w": 1.37}, clock, ONE_INPUT,
    ),
    "Arrhenius reactor, energy": System(
        _reactor, [(0.8, 330.0)], np.arange(0.0, 120.0, 0.1), "cT", 1,
        Candidates(basis=("c", "T", "u", "exp(-E/T)"), degree=2, parameters={"E": (500.0, 20000.0)}),
        [{"1": 0.1, "c": -0.1, "c*exp(-E/T)": -2e3}, {"T": -0.3, "u": 0.3, "c*exp(-E/T)": 2e5}], {"E": 3000.0},
        jacket, ONE_INPUT,
    ),
    "Hill kinetics, exponent and level": System(
        _hill, THREE, np.arange(0.0, 15.0, 0.05), "ab", 1,
        Candidates(basis=("a", "b", "b**n/(K**n + b**n)"), degree=2, parameters={"n": (1.0, 5.0), "K": (0.1, 3.0)}),
        [{"a": -1.0, "b**n/(K**n + b**n)": 2.0}, {"a": 1.2, "b": -0.8}], {"n": 2.5, "K": 0.7},
    ),
    "gene switch, slope and threshold": System(
        _switch, THREE, np.arange(0.0, 15.0, 0.05), "ab", 1,
        Candidates(
            basis=("a", "b", "1/(1 + exp(-k*(b - m)))"), degree=2, parameters={"k": (1.0, 20.0), "m": (0.1, 3.0)}
        ),
        [{"a": -1.0, "1/(1.0 + exp(-b*k + k*m))": 1.5}, {"a": 1.2, "b": -0.8}], {"k": 6.0, "m": 0.9},
    ),
    "enzyme, saturating flux among reactions": System(
        _enzyme, [(2.0, 0.1, 0.0), (0.5, 1.5, 0.2), (1.0, 2.0, 0.1)], np.arange(0.0, 12.0, 0.05), "SPQ", 1,
        Candidates(composition={"S": "a", "P": "a", "Q": "a"}, molecules=1, saturating=("S", "P")),
        [
            {"P": 0.1, "S/(K_S + S)": -1.2}, {"S/(K_S + S)": 1.2, "P": -0.6}, {"P": 0.5},
        ], {"K_S": 0.4},
    ),
    "two tanks, unnamed roots": System(
        _tanks, [(2.0, 3.0)], np.arange(0.0, 1200.0, 0.5), ("h1", "h2"), 1, Candidates(),
        [{"u": 0.3, "sqrt(h1)": -0.15}, {"sqrt(h1)": 0.15, "sqrt(h2)": -0.12}], {}, inflow, ONE_INPUT,
    ),
    "friction, unnamed tanh": System(
        _stage, [(0.5, 0.0)], np.arange(0.0, 30.0, 0.01), "x", 2, Candidates(basis=("x", "x_dot", "u"), degree=3),
        [{"x": -4.0, "x_dot": -0.3, "u": 1.0, "tanh(x_dot/scale_x_dot)": -0.8}], {"scale_x_dot": 0.15}, excitation,
        ONE_INPUT,
    ),
    "valve, unnamed saturation": System(
        _valve, [(0.3,)], np.arange(0.0, 80.0, 0.05), "x", 1, Candidates(),
        [{"x": -0.5, "tanh(u/scale_u)": 1.0}], {"scale_u": 0.6}, feed, ONE_INPUT,
    ),
    "reaction, unnamed exponential": System(
        _growth, [(0.0,), (1.0,)], np.arange(0.0, 60.0, 0.05), "x", 1, Candidates(),
        [{"1": 1.0, "u": 0.7, "exp(x/rise_x)": -0.4}], {"rise_x": 0.7}, feed, ONE_INPUT,
    ),
    "gene, unnamed rate of Hill": System(
        _gene, [(0.1,), (0.6,), (2.0,)], np.arange(0.0, 40.0, 0.05), "x", 1, Candidates(),
        [{"u": 1.0, "x": -1.2, "x**order_x/(level_x**order_x + x**order_x)": 2.0}], {"order_x": 2.0, "level_x": 1.0},
        induction, ONE_INPUT,
    ),
    "two genes, unnamed rates of Hill": System(
        _toggle, [(0.2, 2.5), (2.5, 0.3), (0.8, 0.3), (3.0, 3.0)], np.arange(0.0, 12.0, 0.05), "ab", 1, Candidates(),
        [
            {"a": -1.0, "level_b**order_b/(b**order_b + level_b**order_b)": 3.0},
            {"b": -0.8, "level_a**order_a/(a**order_a + level_a**order_a)": 2.5},
        ], {"order_a": 3.0, "level_a": 1.0, "order_b": 3.0, "level_b": 1.0},
    ),
    "chemostat, unnamed rate of Haldane": System(
        _inhibited, [(0.6, 2.5), (0.9, 6.0), (1.2, 4.0)], np.arange(0.0, 60.0, 0.1), "XS", 1, Candidates(),
        [
            {"X*u": -1.0, "S*X/(S + S**2/inhibition_S + affinity_S)": 0.5},
            {"u": 8.0, "S*u": -1.0, "S*X/(S + S**2/inhibition_S + affinity_S)": -1.0},
        ], {"affinity_S": 0.8, "inhibition_S": 4.0}, dilution, ONE_INPUT,
    ),
    "oscillator, unrecorded forcing": System(
        _shaken, [(0.5, 0.0)], np.arange(0.0, 40.0, 0.02), "x", 2, Candidates(),
        [{"x": -4.0, "x_dot": -0.3, "sin(rate_t*t)": 1.5 * np.cos(1.1), "cos(rate_t*t)": 1.5 * np.sin(1.1)}],
        {"rate_t": 1.37},
    ),
    "populations, unrecorded season": System(
        _season, [(1.0, 2.0)], np.arange(0.0, 40.0, 0.05), "ab", 1, Candidates(),
        [{"a": 1.0, "a*b": -0.5, "sin(rate_t*t)": 0.2}, {"b": -0.8, "a*b": 0.4}], {"rate_t": 0.9},
    ),
    "swing, unrecorded pumping": System(
        _pumped, [(1.0, 0.0)], np.arange(0.0, 40.0, 0.02), "x", 2, Candidates(),
        [{
            "x": -2.0, "x_dot": -0.1,
            "x*cos(rate_t*t)": -1.1 * np.cos(0.4), "x*sin(rate_t*t)": 1.1 * np.sin(0.4),
        }], {"rate_t": 3.3},
    ),
    "contagion, unrecorded season": System(
        _contagion, [(0.6, 0.05), (0.9, 0.01)], np.arange(0.0, 200.0, 0.2), "ab", 1, Candidates(),
        [
            {"1": 0.03, "a": -0.03, "a*b": -0.5, "a*b*cos(rate_t*t)": -0.125},
            {"b": -0.2, "a*b": 0.5, "a*b*cos(rate_t*t)": 0.125},
        ], {"rate_t": 0.3},
    ),
}  # fmt: skip


def recorded(system: System, rng: np.random.Generator) -> list[dict[str, np.ndarray]]:
    """Return noisy recordings."""
    t, logs = system.times, []
    for start in system.starts:
        u = None if system.driven is None else system.driven(t, rng)

        def rate(now, x, u=u):
            return system.rate(now, x, 0.0 if u is None else float(np.interp(now, t, u)))

        x = solve_ivp(rate, (t[0], t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-11, max_step=2.0 * (t[1] - t[0])).y
        log = {"t": t, **{name: x[k].copy() for k, name in enumerate(system.names)}}
        logs.append(log if u is None else log | {"u": u})
    for name in system.names:
        size = NOISE * np.concatenate([log[name] for log in logs]).std()
        for log in logs:
            log[name] += size * rng.standard_normal(len(t))
    return logs


@dataclass(frozen=True)
class Outcome:
    """What came of a run: whether the terms are right, errors over standard errors, and seconds of the processor."""

    right: bool
    constants: tuple[float, ...]
    scaled: tuple[float, ...]
    seconds: float
    said: str


def attempt(job: tuple[str, int]) -> Outcome:
    name, seed = job
    system = SYSTEMS[name]
    logs = recorded(system, np.random.default_rng(seed))
    study = Study(
        data=Data(time="t"), coordinates={c: Measured(order=system.order) for c in system.names},
        inputs=dict(system.inputs), library=system.library,
    )  # fmt: skip
    begin = time.process_time()
    with threadpool_limits(1):
        try:
            model = identify(study, logs).model
        except NoModelError as error:
            return Outcome(False, (), (), time.process_time() - begin, str(error))
    return judged(system, model, time.process_time() - begin)


def judged(system: System, model: Model, seconds: float) -> Outcome:
    """Return how a model compares with the truth."""
    written = {t: w for p in model.parameters for t, w in zip(p.terms, p.written, strict=True)}
    right, scaled = True, list[float]()
    for relation, target, truth in zip(model.relations, model.targets, system.truth, strict=True):
        found = {written.get(t.term.text, t.text): t for t in relation.terms if t.text != target}
        right &= set(found) == set(truth)
        for term, t in found.items():
            if term in truth and t.std_error:
                scaled.append((t.coefficient + truth[term]) / t.std_error)
    known = [p for p in model.parameters if p.std_error and p.name in system.constants]
    constants = [(p.value - system.constants[p.name]) / p.std_error for p in known]
    said = " | ".join(" ".join(f"{t.coefficient:+.4g} {t.text}" for t in r.terms) for r in model.relations)
    return Outcome(right, tuple(constants), (*scaled, *constants), seconds, said)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--only", nargs="+", default=[], help="beginnings of the names of systems")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--detail", action="store_true", help="print the models that are wrong")
    args = parser.parse_args()
    names = [n for n in SYSTEMS if not args.only or n.startswith(tuple(args.only))]
    print(HEADER)
    with ProcessPoolExecutor(args.workers) as pool:
        for name in names:
            seeds = range(args.first, args.first + args.seeds)
            outcomes = list(pool.map(attempt, [(name, seed) for seed in seeds]))
            good = [o for o in outcomes if o.right]
            worst = max((abs(z) for o in good for z in o.constants), default=np.nan)
            scaled = np.abs([z for o in good for z in o.scaled])
            held = f"{100.0 * np.mean(scaled < 1.96):.0f} % of {len(scaled)}" if scaled.size else ""
            took = [o.seconds for o in outcomes]
            times = f"{np.median(took):.1f}, {max(took):.1f}"
            print(f"| {name} | {len(good)}/{len(outcomes)} | {worst:.1f} | {held} | {times} |", flush=True)
            if args.detail:
                for seed, o in zip(seeds, outcomes, strict=True):
                    if not o.right:
                        print(f"    {seed}: {o.said}", flush=True)


if __name__ == "__main__":
    main()
