"""Recovery by likelihood over seeds, noise levels and systems: structure, coefficients against their bound, intervals.

    ./run python bench/recovery.py --seeds 20 --levels 1 2 3 4 --friction 0.01 0.15
    ./run python bench/recovery.py --seeds 20 --systems lorenz "van der pol" --noise 0.01 0.05

The structure is right when every equation has the terms of the truth and no other. Over the seeds for which it is:
the root mean square of coefficient error over Cramer-Rao bound (pooled, and the worst coefficient), and the share of
coefficients within 1.96 of their standard errors of the truth. Coverage counts coefficients that have no standard
error apart. Times are wall times of one process of two, one thread of BLAS each.

The bound is that of the whole continuous record, the noise level known, by a path that shares nothing with the
likelihood: finite differences of free runs of `odescope.model.simulation` at a relative tolerance of 1e-11 over short
stretches that start at the true states, chained by their transition matrices in a square-root information filter. A
stretch is short so that chaos does not spoil the differences. What a state once was is known ever better where the
system forgets it, without bound, so the ends of stretches meet to 1e-7 of the spread of each state, not exactly.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from demo_table import STUDY
from systems import CASES, noisy
from threadpoolctl import threadpool_limits

from odescope import NoModelError, Study, identify
from odescope.commands.demo import NOISE, cart_pendulum, simulate_log
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.model.simulation import simulate

STRETCH = 0.25  # seconds
JOINT = 1e-7  # of the spread of a state
TOLERANCE = 1e-11, 1e-13
DIFFERENCE = 1e-4  # relative, of a coefficient; of the spread of a state

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
    """One job: a system, its noise (level or relative), its friction where it is the cart, its seed."""

    system: str
    noise: float
    friction: float
    seed: int

    @property
    def cell(self) -> tuple[str, float, float]:
        """What is pooled."""
        return self.system, self.noise, self.friction


@dataclass(frozen=True, eq=False)
class Case:
    """Truth and data; states (N, n) without noise and sigma (c,) of the noise in each coordinate."""

    study: Study
    truth: Model
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
    return Case(STUDY, cart_pendulum(experiment.friction), [data], [log.states], np.array(NOISE[int(experiment.noise)]))


def system(experiment: Experiment) -> Case:
    case = CASES[experiment.system]
    coordinates, inputs = case.study.measured(), case.study.driven()
    names = [s for c in coordinates for s in c.states]
    scope = Scope.of([*names, *(i.name for i in inputs)])
    relations = tuple(
        Relation(tuple(RelationTerm(Product(f, parse_term(t, scope)), c) for f, t, c in terms))
        for terms in RELATIONS[experiment.system].values()
    )
    truth = Model(coordinates, inputs, relations)
    clean = case.runs(np.random.default_rng(experiment.seed))
    data = noisy(case, experiment.noise, np.random.default_rng(experiment.seed))
    sigma = np.array(
        [experiment.noise * float(np.std(np.concatenate([run[name] for run in clean]))) for name in case.measured]
    )
    states = []
    for run in clean:
        # The only system with an unmeasured state starts it at rest.
        start = np.array([run[s][0] if s in run else 0.0 for s in truth.states])
        again = simulate(truth, run["t"], inputs_of(truth, run), start, *TOLERANCE).states
        first = slice(len(again) // 10)
        for k, name in enumerate(truth.states):
            if name in run:
                error = np.abs(again[first, k] - run[name][first]).max()
                assert error < 1e-4 * np.ptp(run[name]), f"the relations of {experiment.system} are not its truth"
                again[:, k] = run[name]  # in chaos the two part
        states.append(again)
    return Case(case.study, truth, data, states, sigma)


def pose(experiment: Experiment) -> Case:
    return cart(experiment) if experiment.system == "cart" else system(experiment)


def inputs_of(model: Model, run: Mapping[str, np.ndarray]) -> np.ndarray:
    return np.column_stack([run[i.name] for i in model.inputs]) if model.inputs else np.empty((len(run["t"]), 0))


def parameters(model: Model) -> dict[str, tuple[int, int]]:
    """Return relation and term of every coefficient that is to be found, by target and text."""
    found = {}
    for r, (target, relation) in enumerate(zip(model.targets, model.relations, strict=True)):
        for k, term in enumerate(relation.terms):
            if not (term.factor == target and not term.term.factors):
                found[f"{target}: {term.text}"] = (r, k)
    return found


def changed(model: Model, place: tuple[int, int], by: float) -> Model:
    relations = list(model.relations)
    terms = list(relations[place[0]].terms)
    terms[place[1]] = replace(terms[place[1]], coefficient=terms[place[1]].coefficient + by)
    relations[place[0]] = Relation(tuple(terms))
    return replace(model, relations=tuple(relations))


def differences(
    model: Model,
    nearby: list[tuple[Model, Model, float]],
    t: np.ndarray,
    u: np.ndarray,
    start: np.ndarray,
    small: np.ndarray,
) -> np.ndarray:
    """Return central differences of the states with respect to start and coefficients, (len(t), n, n + p)."""
    columns = []
    for h in np.diag(small):
        more, less = (simulate(model, t, u, start + by, *TOLERANCE).states for by in (h, -h))
        columns.append((more - less) / (2 * h.max()))
    for above, below, h in nearby:
        more, less = (simulate(m, t, u, start, *TOLERANCE).states for m in (above, below))
        columns.append((more - less) / (2 * h))
    return np.stack(columns, axis=-1)


@lru_cache(maxsize=1)
def chained(system: str, friction: float, seed: int) -> list[list[np.ndarray]]:
    """Return for every run the sensitivities of its stretches, which do not depend on the noise."""
    case = pose(Experiment(system, 1, friction, seed))
    model, nearby, runs = case.truth, [], []
    for r, k in parameters(model).values():
        h = DIFFERENCE * abs(model.relations[r].terms[k].coefficient)
        nearby.append((changed(model, (r, k), h), changed(model, (r, k), -h), h))
    small = DIFFERENCE * np.concatenate(case.states).std(axis=0)
    for run, states in zip(case.data, case.states, strict=True):
        t, u = run["t"], inputs_of(model, run)
        stretch = max(2, round(STRETCH / (t[1] - t[0])))
        pieces = [slice(b, min(b + stretch, len(t) - 1) + 1) for b in range(0, len(t) - 1, stretch)]
        runs.append([differences(model, nearby, t[piece], u[piece], states[piece.start], small) for piece in pieces])
    return runs


def cramer_rao(case: Case, runs: list[list[np.ndarray]]) -> dict[str, float]:
    """Return the bound of every coefficient: the least standard deviation of an unbiased estimate.

    The filter carries the information of (state at the begin of the stretch, coefficients) as an upper triangular root.
    Over a stretch x(t) = x0 + S_x dx0 + S_c dc: measurements add rows [S_x, S_c] / sigma, the joint to the state at the
    end [S_x, S_c, -1] / gap; a QR factorisation with the columns of dx0 first then leaves the next root.
    """
    model, places = case.truth, parameters(case.truth)
    n, p = len(model.states), len(places)
    rows = [model.states.index(c.name) for c in model.coordinates]
    gap = JOINT * np.concatenate(case.states).std(axis=0)[:, None]
    information = np.zeros((p, p))
    for stretches in runs:
        root = np.zeros((n + p, n + p))
        for k, sensitivity in enumerate(stretches):
            # The last sample belongs to the next stretch, if there is one.
            seen = sensitivity[:, rows] if k + 1 == len(stretches) else sensitivity[:-1, rows]
            seen = np.linalg.qr((seen / case.sigma[:, None]).reshape(-1, n + p), "r")
            data = np.insert(np.vstack([root, seen]), [n] * n, 0.0, axis=1)
            joint = np.column_stack([sensitivity[-1, :, :n], -np.eye(n), sensitivity[-1, :, n:]]) / gap
            root = np.linalg.qr(np.vstack([joint, data]), "r")[n:, n:]
        ends = np.linalg.qr(root, "r")[n:, n:]
        information += ends.T @ ends
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    return dict(zip(places, np.sqrt(np.diag(covariance)), strict=True))


def canonical(relation: Relation) -> dict[tuple[str | None, frozenset], RelationTerm]:
    return {(t.factor, frozenset(t.term.factors)): t for t in relation.terms}


def attempt(experiment: Experiment) -> Result:
    with threadpool_limits(1):
        case = pose(experiment)
        bound = cramer_rao(case, chained(experiment.system, experiment.friction, experiment.seed))
        try:
            result = identify(case.study, case.data)
        except NoModelError as error:
            return Result(dict.fromkeys(case.truth.targets, f"none: {error.stage}"), {}, np.nan, np.nan, str(error))
    failures, coefficients = {}, {}
    for target, true, mine in zip(case.truth.targets, case.truth.relations, result.model.relations, strict=True):
        wanted, found = canonical(true), canonical(mine)
        missing = sorted(wanted[k].text for k in wanted.keys() - found.keys())
        extra = sorted(found[k].text for k in found.keys() - wanted.keys())
        failures[target] = f"missing {missing}, extra {extra}" if missing or extra else ""
        for key, term in wanted.items():
            name = f"{target}: {term.text}"
            if key in found and name in bound:
                error = found[key].coefficient - term.coefficient
                coefficients[name] = (error, found[key].std_error, bound[name])
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
    where = f"cart b1={friction:<5} level {noise:<4g}" if name == "cart" else f"{name} noise {noise:g}"
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
    parser.add_argument("--levels", type=int, nargs="*", default=[1, 2, 3, 4], choices=NOISE)
    parser.add_argument("--friction", type=float, nargs="+", default=[0.01, 0.15])
    parser.add_argument("--systems", nargs="*", choices=CASES, default=[], help="these instead of the cart")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.01, 0.05], help="of these systems, relative")
    parser.add_argument("--detail", action="store_true", help="a line for every coefficient")
    options = parser.parse_args()
    cells = [(name, noise, 0.0) for name in options.systems for noise in options.noise]
    cells = cells or [("cart", level, b) for b in options.friction for level in options.levels]
    groups = dict.fromkeys((name, friction) for name, _, friction in cells)
    jobs = {
        group: [
            Experiment(group[0], noise, group[1], seed)
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
