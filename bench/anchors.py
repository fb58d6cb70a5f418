"""The speed of odescope beside its peers, in one run: the tables of docs/benchmarks.md.

    ./run python bench/anchors.py            # an hour or two: PySINDy fits every column at every threshold
    ./run python bench/anchors.py --quick    # a few minutes: PySINDy fits a few columns, its times scaled up
    ./run python bench/anchors.py --write    # writes docs/benchmarks.md as well

PySINDy is a dependency of the benchmarks alone:

    UV_PROJECT_ENVIRONMENT=.venv .venv-uv/bin/uv sync --locked --inexact --group bench

Without it the cells of the peer say so.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import regressions
import streams
import trajectories
from threadpoolctl import threadpool_limits
from timing import Row, table

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks.md"

HEAD = """# How fast it is

    ./run python bench/anchors.py {quick}--write

writes this page: odescope and its peers in the same run, on the same data, taking turns, on two cores.
A time is the median of its runs, with their range; a ratio is the peer's time over odescope's, run by
run where both were repeated. Ratios carry over to another machine, seconds do not: the targets were set where numpy's
batched solve, below, takes 72 ms. A target is met in seconds (yes), by the best run alone (best run), or as
a ratio: a peer's time where the targets were set, over the target.

{peers}
"""

FULL = """PySINDy 2.1.0 fitted every column at every threshold, once."""
QUICK = """With `--quick`, as here, PySINDy 2.1.0 fitted three of 35 columns in SINDyPI, the guesses that hold
the target for its answers, and two columns at all 30 thresholds in STLSQ; its times are multiplied by what was left
out, and say "scaled". Without `--quick` it fits all."""
NONE = """PySINDy was not installed; `bench/anchors.py` says how to."""

WHAT = """## What was run

- **SINDy-PI**: the demo's pendulum on a cart, the 35 candidates of the paper's preset on exact signals. odescope
  factors the matrix once; then every column is a guess, and every threshold from 1e-9 to 0.3 is tried, since the
  support is a step function of it. A model of odescope is a support proposed for a guess. PySINDy's SINDyPI solves one
  convex problem a guess by CVXPY, at one weight of the l1 norm, 0.1, its default.
- **Thresholds**: monomials of Lorenz's states with 1 % of noise, to degree 3, 5 and 6. PySINDy's STLSQ runs in a loop
  over guesses and 30 thresholds from 1e-3 to 1, without ridge.
- **A million samples**: `bench/large_sweep.py`, a process of its own. Candidates are evaluated block by block while
  they are factored, which is timed, and never stand in memory together.
- **Trajectory fit**: the likelihood of the whole trajectory at the narrowest gaps between segments, from smoothed
  states and coefficients 5 % off. It sees block averages, which carry what the samples do below their cutoff; that they
  are fewer is the method's own gain. The search is the likelihood stage of an identification, from what regression
  proposes. The peer's figure is that of the target: multiple shooting was not run again.
- **Solves**: the fit that the sweep is made of, called from compiled code.
- **Simulation**: for SciPy the same equations are written by hand and compiled for this model, input included; its
  solvers step over the kinks of the sampled input and pay for it in rejected steps.
"""


FEW_ROWS = (2_500_000, 5_000_000, 10_000_000, 20_000_000)
MANY_ROWS = (*FEW_ROWS, 100_000_000)
LOG_HEAD = (
    "rows",
    "file, MB",
    "chunks",
    "pass",
    "million rows a second",
    "in all",
    "peak MB",
    "exact",
    "worst error",
)
STREAMED = f"""The demo's pendulum on a cart under a sum of tones at noise level 2, at a thousand samples a second, one
recording in one Parquet file; 35 candidates for each of two targets; memory = {streams.MEMORY} MB, the default. The
pass reads, filters, differentiates, evaluates and factors. Errors are those of the coefficients, after the
likelihood."""
FLOOR_HEAD = ("work", "rate", "floor", "its rate", "share")
PROCESS = """`./run python bench/process_noise.py` simulates white forces that nobody measures, on 3 000 samples of
two masses with 60 candidates, and with `--single --samples 90000` on one with 19. Seconds of the search with process
noise by expectation-maximisation, as it was, and by scoring; the cores were shared, so the ratios are rough. In
processor time that of the two masses is 4; they take 259 integrations in place of 1 638. Of 20 seeds all have the
right terms, and 93.8 % of 160 coefficients are within 1.96 errors of the truth.

| record | before | now | ratio |
|--- |---: |---: |---: |
| two masses, 3 000 samples, runs in turn under the same load | 36 s | 4.3 s, 7.6 s | 5 to 9 |
| one mass, 90 000 samples, the new under the heavier load | 148 s | 9.9 s | 15 |
"""
FLOORS = """Blocks of 4096 samples, which stay in cache, in threads of one process, BLAS in one thread each. Evaluation
writes its values once: its floor is the copy of as many. Factorisation is arithmetic: its floor is a product of
matrices of 512 x 512. A Householder QR of a tall block does much of its work on vectors and cannot come near; nor is
it faster in two threads, by NumPy's LAPACK or SciPy's, whose many small calls wait for each other. The Gram matrix
takes a fifth of the time and half of the digits."""


def explained(rows: list[Row]) -> str:
    missed = [row for row in rows if row.met != "yes"]
    if not missed:
        return "Every target is met in seconds."
    reasons: dict[str, list[str]] = {}
    for row in missed:
        reasons.setdefault(row.limit, []).append(row.work)
    return "\n".join(f"- {'; '.join(dict.fromkeys(works))}: {reason}." for reason, works in reasons.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fit a few columns with the peer, and scale in the open")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    options = parser.parse_args()
    few = max(2, options.repeats // 2)
    peers = NONE if regressions.pysindy is None else QUICK if options.quick else FULL
    parts = [HEAD.format(quick="--quick " if options.quick else "", peers=peers)]

    def add(*pieces: str) -> None:
        for piece in pieces:
            print(piece, end="\n\n", flush=True)
            parts.append(piece + "\n")

    add("## Commands and memory")
    started, cold = trajectories.commands(options.repeats)
    # As identify does: threads of BLAS would only contend with those of the sweep. Peers of one matrix have no use for
    # more, and those of CVXPY bring their own.
    with threadpool_limits(1, "blas"):
        million, busy, megabytes, detail = regressions.million(few)
        started.append(
            ("`bench/large_sweep.py`", million.ours.text, busy, "5 s; 1000 MB", million.met, f"{megabytes:.0f}")
        )
        add(table(("process", "waited", "processor", "target", "met", "peak MB"), started, right=(5,)), cold)
        rows, answers = regressions.pendulum(options.quick, options.repeats)
        rows += [*regressions.thresholds(options.quick, options.repeats), million]
        fits, ended = trajectories.trajectory(options.repeats)
        simulated, deviation = trajectories.simulation(few)
        rows += [*fits, *regressions.solves(options.repeats), *simulated]
        head = ("work", "odescope", "target: seconds; ratio", "peer", "peer / odescope", "met")
        add("## Beside the peers", table(head, [row.cells for row in rows]))
        add(
            f"A million samples: {detail}. Trajectory fit: {ended}. Simulation: {deviation}.",
            "## What is found",
            "Guesses of the peer are terms of the truth itself, and its answers are cut at whatever size suits"
            " it best; of odescope's, which guess or threshold found the truth does not count either.",
            table(
                (
                    "target",
                    "signals",
                    "supports of odescope",
                    "truth among them",
                    "terms of SINDyPI",
                    "truth among them",
                ),
                answers,
            ),
            WHAT.strip(),
            "## What limits the rest",
            explained(rows),
            "## How it grows",
            "The least of several runs at each size, and the slope of its logarithm over that of the size.",
        )
        curves = [*regressions.growth(few), trajectories.growth(few), streams.recordings((4, 16, 64), few)]
        cells = [(name, sizes, times, f"{steep:.2f}") for name, sizes, times, steep in curves]
        add(table(("what", "sizes", "ms", "slope"), cells, right=(3,)))
        logs, told = streams.streamed(FEW_ROWS if options.quick else MANY_ROWS)
        add("## More data than memory", STREAMED, table(LOG_HEAD, logs, right=tuple(range(7))), told)
        add("## Process noise", PROCESS)
        add("## How far from the floor", FLOORS, table(FLOOR_HEAD, streams.floors(options.repeats)))
    if options.write:
        PAGE.write_text("\n".join(parts), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
