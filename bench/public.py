"""Published benchmarks: what odescope finds in them with all defaults, one study for all systems of a set.

    ./run python bench/public.py chaotic --noise 0.01 0.1 --results RESULTS.jsonl
    ./run python bench/public.py odebench --noise 0 0.05 --results RESULTS.jsonl
    ./run python bench/public.py positions --noise 0 0.01 --results RESULTS.jsonl

chaotic: the systems of bench/chaotic.txt, two recordings of ten dominant periods, a hundred samples a period, of all
states; white noise relative to the standard deviation of each. odebench: the systems of bench/odebench.txt, 150 samples
in 10 s by LSODA (rtol 1e-5, atol 1e-7), as their authors have it; noise multiplies, x (1 + noise * normal), and where
there is any, half of the samples are left out at random. Free runs without noise judge the model: reconstruction from
the start that it was identified from, generalisation from the second start, with an R^2 above .9 in every equation
(their authors': over all equations, weighted by variance). positions: the systems of both whose states are positions
and their rates; these are not recorded, order = 2, and white noise is as in chaotic. "Exact": every relation has the
terms of the law and no other.

Every result is a line of --results; what is there is not run again, so that a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from published import SECONDS, System, chaotic, compared, odebench, solved

from odescope import (
    Candidates,
    Data,
    LikelihoodSearch,
    Measured,
    Model,
    NoModelError,
    OdescopeError,
    Study,
    identify,
    simulate,
    to_text,
)

PERIODS, A_PERIOD, BETWEEN = 10, 100, 5  # of a recording; samples; periods between two recordings
SAMPLES = 150
GOOD = 0.9  # R^2 of a free run
CLOSE = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}
AS_PUBLISHED = {"method": "LSODA", "rtol": 1e-5, "atol": 1e-7, "first_step": 1e-6, "min_step": 1e-10}
ANGLES = {"28", "34", "36", "43", "44"}  # of ODEBench: their position is said to be an angle
Recordings = list[dict[str, np.ndarray]]


@dataclass(frozen=True)
class Job:
    """A system of a set at a noise, and the options of its study; an empty basis is the default library."""

    set: str
    system: System
    noise: float
    basis: tuple[str, ...]
    degree: int
    budget: float
    seed: int

    @property
    def key(self) -> str:
        """What its result is kept under."""
        library = f"{' '.join(self.basis)} to {self.degree}" if self.basis else "default"
        return f"{self.set} | {self.system.name} | {self.noise:g} | {library} | {self.budget:g} | {self.seed}"

    @property
    def study(self) -> Study:
        """The study."""
        order, named = self.system.order, self.system.coordinates
        angle = order == 2 and self.system.name in ANGLES
        library = Candidates()
        if self.basis:
            written = [b.format(state) for b in self.basis for state in (self.system.states if "{" in b else [""])]
            library = Candidates(basis=tuple(written), degree=self.degree)
        return Study(
            data=Data(time="t"),
            coordinates={name: Measured(order=order, angle=angle) for name in named},
            library=library,
            likelihood=LikelihoodSearch(budget=self.budget),
        )


def clean(system: System) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return time and states of every recording without noise."""
    if system.name.isdigit():
        t = np.linspace(0.0, SECONDS, SAMPLES)
        return [(t, solved(system, system.starts[0], t, **AS_PUBLISHED))]
    count = PERIODS * A_PERIOD
    t = system.span / A_PERIOD * np.arange(2 * count + BETWEEN * A_PERIOD)
    states = solved(system, system.starts[0], t, **CLOSE)
    return [(t[:count], part) for part in (states[:count], states[-count:])]


def recorded(job: Job) -> Recordings:
    """Return the recordings with their noise."""
    rng, runs, found = np.random.default_rng(job.seed), clean(job.system), []
    size = job.noise * np.std(np.concatenate([states for _, states in runs]), axis=0)
    for t, states in runs:
        noise = rng.standard_normal(states.shape)
        if job.set == "odebench":
            kept = np.arange(SAMPLES)
            if job.noise:
                kept = np.sort(rng.choice(SAMPLES, SAMPLES // 2, replace=False))
            t, states = t[kept], (states * (1.0 + job.noise * noise))[kept]
        else:
            states = states + size * noise
        columns = dict(zip(job.system.states, states.T, strict=True))
        found.append({"t": t, **{name: columns[name] for name in job.system.coordinates}})
    return found


def r2(system: System, model: Model, start: Sequence[float]) -> tuple[list[float], float]:
    """Return R^2 of a free run from a start, by state, and over all states weighted by variance; -inf if it ends."""
    t = np.linspace(0.0, SECONDS, SAMPLES)
    truth = solved(system, start, t, **AS_PUBLISHED)
    free = simulate(model, t, {i.name: t for i in model.inputs}, np.array(start))  # a forcing has the time as its input
    if free.ended is not None:
        return [-np.inf] * truth.shape[1], -np.inf
    off, spread = np.sum((free.states - truth) ** 2, axis=0), np.sum((truth - truth.mean(axis=0)) ** 2, axis=0)
    return (1.0 - off / spread).tolist(), float(1.0 - off.sum() / spread.sum())


def attempt(job: Job) -> dict[str, object]:
    """Return the result of a job, as it is kept."""
    begin = time.process_time()
    try:
        result = identify(job.study, recorded(job))
    except (NoModelError, OdescopeError) as error:
        stage = error.stage if isinstance(error, NoModelError) else type(error).__name__
        return {"key": job.key, "none": stage, "message": str(error), "seconds": time.process_time() - begin}
    seconds, model = time.process_time() - begin, result.model
    comparison, refinement = compared(job.system, model), result.refinement
    found: dict[str, object] = {
        "key": job.key,
        "exact": comparison.exact,
        "failures": {target: text for target, text in comparison.failures.items() if text},
        "errors": comparison.errors,
        "model": to_text(model, 5).splitlines(),
        "seconds": seconds,
        "terms": sum(len(relation.terms) - 1 for relation in model.relations),
        "width": None if refinement is None else refinement.outcome.width,
        "scale": None if refinement is None else refinement.outcome.scale,
        "process": refinement is not None and refinement.process is not None,
        "spent": None if refinement is None else refinement.spent,
    }
    if job.system.name.isdigit():
        found["reconstruction"] = r2(job.system, model, job.system.starts[0])
        found["generalisation"] = r2(job.system, model, job.system.starts[1])
    return found


def systems(of: str) -> dict[str, System]:
    if of == "positions":
        both = {**odebench(), **chaotic()}
        return {name: found for name, system in both.items() if (found := system.from_positions) is not None}
    return chaotic() if of == "chaotic" else odebench()


def kept(file: Path) -> dict[str, dict]:
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return {result["key"]: result for result in map(json.loads, lines)}


def table(of: str, cells: dict[float, list[dict]]) -> Iterator[str]:
    """Yield the rows of a table: a noise each."""
    runs = of != "chaotic"
    yield "| noise | systems | models | exact | median error of a coefficient | CPU s, median and worst |" + (
        " reconstruct | generalise | weighted |" if runs else ""
    )
    yield "|---|---:|---:|---:|---:|---:|" + ("---:|---:|---:|" if runs else "")
    for noise, results in cells.items():
        exact = [r for r in results if r.get("exact")]
        errors = [e for r in exact for e in r["errors"].values()]
        spent = [r["seconds"] for r in results]
        line = (
            f"| {noise:g} | {len(results)} | {sum('none' not in r for r in results)} | {len(exact)} |"
            f" {np.median(errors) if errors else np.nan:.1e} | {np.median(spent):.1f}, {max(spent):.0f} |"
        )
        judged = [r for r in results if "generalisation" in r]
        same, other = ([r[k] for r in judged] for k in ("reconstruction", "generalisation"))
        every = [sum(min(by_state) > GOOD for by_state, _ in found) for found in (same, other)]
        weighted = [sum(whole > GOOD for _, whole in found) for found in (same, other)]
        yield line + (f" {every[0]} | {every[1]} | {weighted[0]}, {weighted[1]} |" if runs else "")


def failures(results: Sequence[dict]) -> Iterator[str]:
    for r in results:
        name = r["key"].split(" | ")[1]
        if "none" in r:
            yield f"    {name}: no model, {r['none']}: {r['message'][:300]}"
        elif not r["exact"]:
            state = f"scale {r['scale']:.3g}, width {r['width']:g}" if r["scale"] is not None else "no likelihood"
            text = "; ".join(f"{target} {text}" for target, text in r["failures"].items())
            runs = f", R2 {min(r['generalisation'][0]):.3g}" if "generalisation" in r else ""
            yield f"    {name}: {text} ({state}{', process noise' if r['process'] else ''}{runs}, {r['seconds']:.0f} s)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", choices=("chaotic", "odebench", "positions"))
    parser.add_argument("--noise", type=float, nargs="+", required=True)
    parser.add_argument("--systems", nargs="+", help="these alone")
    parser.add_argument("--basis", nargs="+", default=[], help='a basis for all, "{}" in it for every state')
    parser.add_argument("--degree", type=int, default=3, help="of the basis")
    parser.add_argument("--budget", type=float, default=60.0, help="of each likelihood search")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument("--results", type=Path, required=True, help="file of results, to which new ones are added")
    parser.add_argument("--seconds", type=float, default=np.inf, help="after which no other system is begun")
    parser.add_argument("--detail", action="store_true", help="say how each system failed")
    options = parser.parse_args()
    begin, cells = time.monotonic(), dict[float, list[dict]]()
    found, known = systems(options.set), kept(options.results)
    for noise in options.noise:
        for name in options.systems or found:
            job = Job(
                options.set, found[name], noise, tuple(options.basis), options.degree, options.budget, options.seed
            )
            if job.key not in known:
                if time.monotonic() - begin > options.seconds:
                    continue
                known[job.key] = attempt(job)
                with options.results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(known[job.key]) + "\n")
            cells.setdefault(noise, []).append(known[job.key])
    print("\n".join(table(options.set, cells)))
    for noise, results in cells.items() if options.detail else ():
        print(f"\nnoise {noise:g}\n" + "\n".join(failures(results)))


if __name__ == "__main__":
    main()
