"""Recovery by likelihood over seeds, noise levels and systems: structure, coefficients against their bound, intervals.

    ./run python bench/recovery.py --seeds 20 --levels 1 2 3 4 --friction 0.01 0.15
    ./run python bench/recovery.py --seeds 20 --systems lorenz "van der pol" --noise 0.01 0.05

The structure is right when every equation has the terms of the truth and no other; a saturation such as x*y/(K + x) is
multiplied out first, which is the same law, without errors of its coefficients. Over the seeds for which it is:
the root mean square of coefficient error over Cramer-Rao bound (pooled, and the worst coefficient), and the share of
coefficients within 1.96 of their standard errors of the truth. Coverage counts coefficients that have no standard
error apart. Times are wall times of one process of two, one thread of BLAS each.
    ./run python bench/recovery.py --seeds 20 --machines cart arms rotary enzyme --levels 1 2 3

A machine (bench/machines.py) is exact when its mechanisms, kind and term, are those of the truth, too. Coefficients are
those of the relations, whose scale is set in one way whatever the search held fixed. The bounds are in bench/bounds.py.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from bounds import TOLERANCE, cramer_rao, inputs_of, sensitivities
from catalogue import MACHINES
from demo_table import STUDY
from systems import CASES, noisy
from threadpoolctl import threadpool_limits
from truths import Truth, canonical, chemistry, multiplied_out, relations

from odescope import NoModelError, Study, identify
from odescope.commands.demo import NOISE, cart_pendulum, simulate_log
from odescope.library.mechanism import Mechanism
from odescope.library.parse import parse_term
from odescope.model.model import Model
from odescope.model.relation import Relation
from odescope.model.simulation import simulate

# Relations of bench/systems.py with the target's coefficient 1: (factor, term, coefficient).
RELATIONS: dict[str, dict[str, tuple[tuple[str | None, str, float], ...]]] = {
    "michaelis-menten": {
        "x_dot": (("x_dot", "1", 1.0), ("x_dot", "x", 1 / 0.3), (None, "1", -0.6), (None, "x", 0.9 / 0.3)),
    },
    "lorenz": {
        "x_dot": (("x_dot", "1", 1.0), (None, "x", 10.0), (None, "y", -10.0)),
        "y_dot": (("y_dot", "1", 1.0), (None, "x", -28.0), (None, "x*z", 1.0), (None, "y", 1.0)),
        "z_dot": (("z_dot", "1", 1.0), (None, "x*y", -1.0), (None, "z", 8 / 3)),
    },
    "predator-prey": {
        "x_dot": (
            ("x_dot", "1", 1.0),
            ("x_dot", "x", 0.5),
            (None, "x", -1.0),
            (None, "x**2", 1 / 3 - 0.5),
            (None, "x**3", 0.5 / 3),
            (None, "x*y", 1.0),
        ),
        "y_dot": (("y_dot", "1", 1.0), ("y_dot", "x", 0.5), (None, "x*y", 0.4 * 0.5 - 0.6), (None, "y", 0.4)),
    },
    "van der pol": {
        "x_ddot": (
            ("x_ddot", "1", 1.0),
            (None, "x", 1.0),
            (None, "x_dot", -1.5),
            (None, "x**2*x_dot", 1.5),
            (None, "u", -1.0),
        ),
    },
}


@dataclass(frozen=True)
class Experiment:
    """One job: a system, its noise (level or relative), its friction where it is the cart, its seed.

    With `machine`, the system is one of bench/catalogue.py.
    """

    system: str
    noise: float
    friction: float
    seed: int
    machine: bool = False

    @property
    def cell(self) -> tuple[str, float, float]:
        """What is pooled."""
        return self.system, self.noise, self.friction


@dataclass(frozen=True, eq=False)
class Case:
    """Truth and data; states (N, n) without noise and sigma (c,) of the noise in each coordinate."""

    study: Study
    truth: Truth
    data: list[dict[str, np.ndarray]]
    states: list[np.ndarray]
    sigma: np.ndarray


@dataclass(frozen=True)
class Result:
    """What one run gave: failures by target, and (error, std_error, bound) of every true coefficient by name."""

    failures: Mapping[str, str]
    coefficients: Mapping[str, tuple[float, float | None, float]]
    likelihood: float
    whole: float
    note: str

    @property
    def exact(self) -> bool:
        """Whether every equation has the right terms."""
        return not any(self.failures.values())


def cart(experiment: Experiment) -> Case:
    log = simulate_log(experiment.seed, int(experiment.noise), experiment.friction)
    data = {"t": log.t, "x": log.measured[:, 0], "phi": log.measured[:, 1], "u": log.force}
    model = cart_pendulum(experiment.friction)
    terms = [[(t.factor, t.term.text, t.coefficient) for t in relation.terms] for relation in model.relations]
    truth = relations(model.coordinates, model.inputs, dict(zip(model.targets, terms, strict=True)))
    return Case(STUDY, truth, [data], [log.states], np.array(NOISE[int(experiment.noise)]))


def system(experiment: Experiment) -> Case:
    case = CASES[experiment.system]
    truth = relations(case.study.measured(), case.study.driven(), RELATIONS[experiment.system])
    clean = case.runs(np.random.default_rng(experiment.seed))
    data = noisy(case, experiment.noise, np.random.default_rng(experiment.seed))
    sigma = np.array(
        [experiment.noise * float(np.std(np.concatenate([run[name] for run in clean]))) for name in case.measured]
    )
    states, model = [], truth.model
    for run in clean:
        # The only system with an unmeasured state starts it at rest.
        start = np.array([run[s][0] if s in run else 0.0 for s in model.states])
        again = simulate(model, run["t"], inputs_of(model, run), start, *TOLERANCE).states
        first = slice(len(again) // 10)
        for k, name in enumerate(model.states):
            if name in run:
                error = np.abs(again[first, k] - run[name][first]).max()
                assert error < 1e-4 * np.ptp(run[name]), f"the relations of {experiment.system} are not its truth"
                again[:, k] = run[name]  # in chaos the two part
        states.append(again)
    return Case(case.study, truth, data, states, sigma)


@lru_cache(maxsize=1)
def run_of(name: str, friction: float, seed: int) -> list[dict[str, np.ndarray]]:
    return MACHINES[name](friction).runs(seed)


def machine(experiment: Experiment) -> Case:
    made, level = MACHINES[experiment.system](experiment.friction), int(experiment.noise)
    clean = run_of(experiment.system, experiment.friction, experiment.seed)
    data = made.recorded(clean, level, experiment.seed)
    return Case(made.study, made.truth, data, made.states(clean), made.sigma(clean, level))


def pose(experiment: Experiment) -> Case:
    if experiment.machine:
        return machine(experiment)
    return cart(experiment) if experiment.system == "cart" else system(experiment)


@lru_cache(maxsize=1)
def chained(system: str, friction: float, seed: int, machine: bool) -> list[list[np.ndarray]]:
    """Return the sensitivities of every recording, which do not depend on the noise."""
    case = pose(Experiment(system, 1, friction, seed, machine))
    return sensitivities(case.truth, case.data, case.states)


def structure(relation: Relation) -> dict[tuple[str | None, frozenset], tuple[str, float, float | None]]:
    """Return text, coefficient and standard error of every term."""
    found = {}
    for t in relation.terms:
        sign, factors = canonical(t.term)
        found[t.factor, factors] = (t.text, sign * t.coefficient, t.std_error)
    return found


def alike(truth: Truth, mechanisms: Sequence[Mechanism]) -> str:
    """Return how mechanisms differ from those of the truth in kind, term and reaction; "" if in nothing."""

    def keyed(these: Sequence[Mechanism]) -> dict[tuple, str]:
        return {
            (m.kind, canonical(parse_term(m.term, truth.scope))[1], chemistry(m.name)): f"{m.name or m.term} ({m.kind})"
            for m in these
            if m.kind not in ("term", "tie")
        }

    wanted, found = keyed(truth.mechanisms), keyed(mechanisms)
    if wanted.keys() == found.keys():
        return ""
    missing, extra = (sorted(a[k] for k in a.keys() - b.keys()) for a, b in ((wanted, found), (found, wanted)))
    return f"missing {missing}, extra {extra}"


def compared(truth: Model, found: Model) -> tuple[dict[str, str], dict[str, tuple[float, float | None, float]]]:
    """Return how each relation fails, and (error, std_error, bound) of its coefficients; the truth has the bounds."""
    failures, coefficients = {}, {}
    for target, true, mine in zip(truth.targets, truth.relations, found.relations, strict=True):
        wanted, got = structure(true), structure(multiplied_out(mine))
        missing = sorted(wanted[k][0] for k in wanted.keys() - got.keys())
        extra = sorted(got[k][0] for k in got.keys() - wanted.keys())
        failures[target] = f"missing {missing}, extra {extra}" if missing or extra else ""
        if any(k not in got for k in wanted):
            continue
        # Both have 1 in front of the leading target; should they not agree which that is, there is a scale between.
        lead = next(iter(wanted))
        scale = wanted[lead][1] / got[lead][1]
        for key, (text, c, bound) in wanted.items():
            if bound is not None:
                error = got[key][2] if abs(scale - 1.0) < 1e-9 else None
                coefficients[f"{target}: {text}"] = (scale * got[key][1] - c, error, bound)
    return failures, coefficients


def attempt(experiment: Experiment) -> Result:
    with threadpool_limits(1):
        case = pose(experiment)
        runs = chained(experiment.system, experiment.friction, experiment.seed, experiment.machine)
        bounded = case.truth.stated(cramer_rao(case.truth, case.states, case.sigma, runs))
        try:
            result = identify(case.study, case.data)
        except NoModelError as error:
            return Result(dict.fromkeys(case.truth.targets, f"none: {error.stage}"), {}, np.nan, np.nan, str(error))
    failures, coefficients = compared(bounded, result.model)
    mechanisms = getattr(result.model, "mechanisms", ())
    # Where the form is not asked for, it may be relations, which are all that there is to compare.
    if mechanisms or getattr(case.study.library, "form", "auto") not in ("auto", "relations"):
        failures["mechanisms"] = alike(case.truth, mechanisms)
    refinement = result.refinement
    note = (
        "no likelihood"
        if refinement is None
        else f"scale {refinement.outcome.scale:.3g}, width {refinement.outcome.width:g}"
    )
    return Result(failures, coefficients, result.seconds["likelihood"], sum(result.seconds.values()), note)


def show(cell: tuple[str, float, float], results: Mapping[int, Result], detail: bool) -> None:
    name, noise, friction = cell
    right = [r for r in results.values() if r.exact]
    found = (
        {c: np.array([r.coefficients[c][0] / r.coefficients[c][2] for r in right]) for c in right[0].coefficients}
        if right
        else {}
    )
    sized = {c: float(np.sqrt(np.mean(v**2))) for c, v in found.items()}
    # Pooled over coefficients, an error is weighed by its own bound.
    pooled = float(np.sqrt(np.mean([v**2 for v in sized.values()]))) if sized else np.nan
    stated = [(e, s) for r in right for e, s, _ in r.coefficients.values() if s is not None]
    silent = sum(s is None for r in right for _, s, _ in r.coefficients.values())
    coverage = np.mean([abs(e) <= 1.96 * s for e, s in stated]) if stated else np.nan
    likelihood, whole = ([getattr(r, k) for r in results.values()] for k in ("likelihood", "whole"))
    where = f"{name} noise {noise:g}" if name in CASES else f"{name} level {noise:g}"
    where = f"cart b1={friction:<5} level {noise:<4g}" if name == "cart" else where
    print(
        f"{where:<28} {len(right):>3}/{len(results):<3} {pooled:8.2f} {max(sized.values(), default=np.nan):8.2f}"
        f" {coverage:9.1%} {silent:>5}   {np.nanmedian(likelihood):6.2f} {np.nanmax(likelihood):6.2f}"
        f"   {np.nanmedian(whole):6.2f} {np.nanmax(whole):6.2f}"
    )
    for c, ratio in sized.items() if detail else ():
        claimed = [r.coefficients[c][1] / r.coefficients[c][2] for r in right if r.coefficients[c][1] is not None]
        print(
            f"      {c:<42} error/bound: rms {ratio:5.2f}, mean {np.mean(found[c]):+5.2f};"
            f" std_error/bound {np.median(claimed) if claimed else np.nan:5.2f}"
        )
    for seed, r in results.items():
        for target, failure in r.failures.items():
            if failure:
                print(f"      seed {seed}: {target}: {failure} ({r.note})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--levels", type=int, nargs="*", help="of the cart or the machines; all if left out")
    parser.add_argument("--friction", type=float, nargs="+", default=[0.01, 0.15], help="of the cart's joint")
    parser.add_argument("--systems", nargs="*", choices=CASES, default=[], help="these instead of the cart")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.01, 0.05], help="of these systems, relative")
    parser.add_argument("--machines", nargs="*", choices=MACHINES, default=[], help="these instead of the cart")
    parser.add_argument("--detail", action="store_true", help="a line for every coefficient")
    options = parser.parse_args()
    cells = [(name, noise, 0.0) for name in options.systems for noise in options.noise]
    for name in options.machines:
        for friction in options.friction if name == "cart" else [0.0]:
            levels = MACHINES[name](friction).noise
            cells += [(name, n, friction) for n in levels if options.levels is None or n in options.levels]
    cells = cells or [("cart", n, b) for b in options.friction for n in NOISE if n in (options.levels or NOISE)]
    groups = dict.fromkeys((name, friction) for name, _, friction in cells)
    jobs = {
        group: [
            Experiment(group[0], noise, group[1], seed, group[0] in options.machines)
            for seed in range(options.first, options.first + options.seeds)
            for name, noise, friction in cells
            if (name, friction) == group
        ]
        for group in groups
    }
    print(
        "                              exact   error/bound     coverage  none   likelihood, s   identify, s\n"
        "                                      pooled   worst                   median  worst   median  worst"
    )
    with ProcessPoolExecutor(2) as pool:
        # All noise levels of a seed in one process, which then finds their sensitivities once.
        pending = {g: pool.map(attempt, of, chunksize=len(of) // options.seeds) for g, of in jobs.items()}
        for group, results in pending.items():
            found = dict(zip(jobs[group], results, strict=True))
            for cell in cells:
                if (cell[0], cell[2]) == group:
                    show(cell, {e.seed: r for e, r in found.items() if e.cell == cell}, options.detail)


if __name__ == "__main__":
    main()
