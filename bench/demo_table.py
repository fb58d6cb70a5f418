"""Recovery of the paper's pendulum on a cart over seeds and noise levels: the table of the README.

    ./run python bench/demo_table.py --seeds 20 --levels 1 2

A structure is exact when the chosen relation has the terms of the truth and no other. "less joint friction" counts an
x_ddot that lacks only the joint friction. The error is the largest over all coefficients but joint friction's,
relative, among the exact ones.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from odescope import Candidates, Data, Driven, Measured, NoModelError, Study, identify
from odescope.commands.demo import cart_pendulum, simulate_log, table_two

STUDY = Study(
    data=Data(time="t"),
    coordinates={"x": Measured(order=2, cyclic=True), "phi": Measured(order=2, angle=True)},
    inputs={"u": Driven()},
    library=Candidates(preset="paper"),
)
FRICTION = {"x_ddot": "phi_dot*cos(phi)", "phi_ddot": "phi_dot"}


@dataclass(frozen=True)
class Outcome:
    """What one run gave for one target."""

    target: str
    missing: frozenset[str]
    extra: frozenset[str]
    error: float


def run(job: tuple[int, int, float]) -> list[Outcome]:
    seed, level, friction = job
    log = simulate_log(seed, level, friction)
    data = {"t": log.t, "x": log.measured[:, 0], "phi": log.measured[:, 1], "u": log.force}
    try:
        with threadpool_limits(1):
            found = identify(STUDY, data).model
    except NoModelError as error:
        return [Outcome(target, frozenset({str(error)}), frozenset(), np.nan) for target in FRICTION]
    rows = table_two(cart_pendulum(friction), found)
    outcomes = []
    for target, joint in FRICTION.items():
        mine = [r for r in rows if r.target == target]
        errors = [
            abs(r.found / r.truth - 1.0)
            for r in mine
            if r.term != joint and r.found is not None and r.truth is not None
        ]
        missing = frozenset(r.term for r in mine if r.found is None)
        extra = frozenset(r.term for r in mine if r.truth is None)
        outcomes.append(Outcome(target, missing, extra, max(errors, default=np.nan)))
    return outcomes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--levels", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--friction", type=float, nargs="+", default=[0.01])
    options = parser.parse_args()
    jobs = [(s, level, b) for b in options.friction for level in options.levels for s in range(options.seeds)]
    with ProcessPoolExecutor(2) as pool:
        results = dict(zip(jobs, pool.map(run, jobs), strict=True))
    print("b1     level  target     exact   less joint friction   largest coefficient error (median, worst)")
    for friction in options.friction:
        for level in options.levels:
            for k, (target, joint) in enumerate(FRICTION.items()):
                found = [results[s, level, friction][k] for s in range(options.seeds)]
                exact = [o for o in found if not o.missing and not o.extra]
                less = [o for o in found if o.missing == {joint} and not o.extra]
                errors = [o.error for o in exact] or [np.nan]
                print(
                    f"{friction:<6} {level:<6} {target:<10} {len(exact):>2}/{options.seeds}   {len(less):>8}"
                    f"              {np.median(errors):8.2%} {np.max(errors):8.2%}"
                )
                for s, o in enumerate(found):
                    if o.missing or o.extra:
                        print(f"         seed {s}: missing {sorted(o.missing)}, extra {sorted(o.extra)}")


if __name__ == "__main__":
    main()
