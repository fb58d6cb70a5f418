"""Default studies on logs as machines write them: six rigs, clean, with every defect, and with all of them.

    ./run python bench/real_logs.py --seeds 10 --workers 2 --out table.md
    ./run python bench/real_logs.py --rigs stage motor --defects clean "late reads" all --levels 1 2 --detail

The rigs and what is drawn of them are in bench/rigs.py, the defects in bench/defects.py; a study names the coordinates
with order and angle, the inputs, the time, and for the tanks a basis with sqrt. What counts as the same law is in
bench/laws.py. By row: runs without a model (refused, ended without one, stopped by --limit, crashed); exact structure;
law within 3 % (of the accelerations at random states, root mean square); over the exact ones the worst error of a
coefficient of the equations of motion in %, the worst error of the model's coefficients in its standard errors, and
how many of their 95 % intervals hold the truth; over all models the share of an unseen clean recording for which a
free run stays within a tenth of a standard deviation of every coordinate (median); seconds (median and most).
"""

from __future__ import annotations

import argparse
import re
import time
import zlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from defects import DEFECTS, Run, drawn, logged, ride, sampled
from laws import Verdict, judge, offsets_of, rows_of, shifted
from rigs import LEVELS, RIGS
from threadpoolctl import threadpool_limits

from odescope import InputError, NoModelError, Stopped, identify, simulate
from odescope.model.model import Model

ERROR = 0.1  # standard deviations of a coordinate: the free run has left the recording
CLOSE = 0.03  # relative error of the accelerations: the law is found but for little
HEADER = (
    "| rig | defect | level | no model | exact | within 3 % | worst, % | worst, s.e. | coverage | valid | s |\n"
    "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|"
)


@dataclass(frozen=True)
class Experiment:
    """One job; `limit` is when to stop it, in seconds."""

    rig: str
    defect: str
    level: int
    seed: int
    limit: float


@dataclass(frozen=True)
class Outcome:
    """What came of a job: why there is no model, or what it is worth; `valid` is the share of the unseen recording."""

    failure: str
    seconds: float
    verdict: Verdict | None = None
    valid: float = 0.0
    equations: tuple[str, ...] = ()


def attempt(experiment: Experiment) -> Outcome:
    own = zlib.crc32(experiment.rig.encode())
    rig = RIGS[experiment.rig](np.random.default_rng([experiment.seed, own]))
    rng = np.random.default_rng([experiment.seed, own, DEFECTS.index(experiment.defect)])
    suffered = drawn(experiment.defect, rig, rng)
    seen = ride(rig, suffered, sampled(rig, suffered, rig.samples, rng), rng)
    log = logged(rig, suffered, seen, experiment.level, rng)
    truth = rig.truth(suffered.beside)
    begin = time.perf_counter()
    with threadpool_limits(1):
        try:
            found = identify(rig.study, log, stop=lambda: time.perf_counter() - begin > experiment.limit).model
        except Exception as error:  # one that nobody meant to raise is a result too
            kind = {InputError: "refused", NoModelError: "none", Stopped: "stopped"}.get(type(error), repr(type(error)))
            return Outcome(f"{kind}: {str(error).partition(chr(10))[0]}", time.perf_counter() - begin)
        seconds = time.perf_counter() - begin
        columns = np.column_stack([seen.states, seen.inputs]).T
        also = rows_of(truth, [rig.displaced(law, suffered.beside) for law in rig.also])
        verdict = judge(truth, suffered.zero, also, found, columns, rng)
        quiet = replace(suffered, torque=0.0)
        unseen = ride(rig, quiet, np.arange(rig.samples // 2) * rig.period, rng)
        valid = followed(found, unseen)
    return Outcome("", seconds, verdict, valid, tuple(map(written, found.relations)))


def followed(model: Model, unseen: Run) -> float:
    """Return the share of a recording that the free run from its true beginning stays with."""
    count = len(model.coordinates)
    states = shifted(unseen.states.T, offsets_of(model)).T
    free = simulate(model, unseen.t, unseen.inputs, states[0])
    off = np.abs(free.states - states[: len(free.t)])[:, :count] / states[:, :count].std(axis=0)
    left = np.flatnonzero((off > ERROR).any(axis=1))
    return float(left[0] if left.size else len(free.t)) / len(unseen.t)


def written(relation) -> str:
    return " ".join(
        f"{t.coefficient:+.4g}{'' if t.std_error is None else f'({t.std_error:.1g})'} {t.text}" for t in relation.terms
    )


def row(name: str, defect: str, level: str, outcomes: Sequence[Outcome]) -> str:
    """Return a row of the table."""
    count = len(outcomes)
    judged = [o for o in outcomes if o.verdict is not None]
    verdicts = [o.verdict for o in judged if o.verdict is not None]
    right = [v for v in verdicts if v.exact]
    close = sum(v.off < CLOSE for v in verdicts)
    per_cent = [100 * max(map(abs, v.physical.values())) for v in right]
    scaled = np.abs([e / s for v in right for e, s in v.stated])
    coverage = f"{100 * np.mean(scaled < 1.96):.0f} % of {len(scaled)}" if scaled.size else ""
    cells = (
        name,
        defect,
        level,
        f"{count - len(judged)}/{count}",
        f"{len(right)}/{count}",
        f"{close}/{count}",
        f"{max(per_cent):.2g}" if right else "",
        f"{scaled.max():.1f}" if scaled.size else "",
        coverage,
        f"{np.median([o.valid for o in judged]):.2f}" if judged else "",
        f"{np.median([o.seconds for o in outcomes]):.0f}, {max(o.seconds for o in outcomes):.0f}",
    )
    return f"| {' | '.join(cells)} |"


def reasons(outcomes: Sequence[Outcome]) -> list[str]:
    """Return why there was no model, the most frequent first, numbers left out so that like errors count as one."""
    masked = (re.sub(r"\d[\d., ]*", "# ", o.failure) for o in outcomes if o.failure)
    return [f"- {n} times: {text}" for text, n in Counter(masked).most_common()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=list(RIGS))
    parser.add_argument("--defects", nargs="+", choices=DEFECTS, default=list(DEFECTS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--levels", type=int, nargs="+", choices=LEVELS, default=[1], help="of the noise")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds after which a run is stopped")
    parser.add_argument("--out", type=Path, help="a file for the table")
    parser.add_argument("--detail", action="store_true", help="the equations of every run")
    options = parser.parse_args()
    cells = [(r, d, n) for r in options.rigs for d in options.defects for n in options.levels]
    seeds = range(options.first, options.first + options.seeds)
    jobs = [Experiment(*cell, seed, options.limit) for cell in cells for seed in seeds]
    lines, outcomes = [HEADER], list[Outcome]()

    def tell(line: str) -> None:
        lines.append(line)
        print(line, flush=True)

    print(HEADER)
    with ProcessPoolExecutor(options.workers) as pool:
        results = pool.map(attempt, jobs)
        for name, defect, level in cells:
            of = [next(results) for _ in seeds]
            outcomes += of
            tell(row(name, defect, str(level), of))
            for seed, o in zip(seeds, of, strict=True) if options.detail else ():
                print(f"    seed {seed}: {o.failure or ('exact' if o.verdict and o.verdict.exact else 'other')}")
                print("".join(f"        {e}\n" for e in o.equations), end="", flush=True)
    for name in options.rigs:
        for level in options.levels:
            mine = [
                o
                for j, o in zip(jobs, outcomes, strict=True)
                if (j.rig, j.level) == (name, level) and j.defect != "all"
            ]
            if mine:
                tell(row(name, "every row but all", str(level), mine))
    for line in ("", *reasons(outcomes)):
        tell(line)
    if options.out is not None:
        options.out.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
