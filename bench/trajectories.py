"""The simulations and trajectory fits of bench/anchors.py, and the commands as processes of their own."""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path

import numba
import numpy as np
from demo_table import STUDY
from scipy.integrate import solve_ivp
from timing import Process, Row, Timing, alternate, command, duration, slope

from odescope import identify
from odescope.commands.demo import START, cart_pendulum, simulate_log
from odescope.library.mechanism import candidate
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.fit import Fit, fit
from odescope.likelihood.program import Frame, Program
from odescope.likelihood.search import WIDTHS
from odescope.likelihood.segments import Segments, cut_segments
from odescope.model.simulation import simulate
from odescope.recordings.readers import records_from
from odescope.recordings.record import Records
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import Signals, estimate_signals

EVERY = 10  # of the demo's samples, for the simulation: 6 501
COMPARED = 5.0  # seconds: a pendulum that turns over forgets where it came from
LONG = 2  # runs of what takes seconds
STARTS = 0.05  # relative error of the coefficients that a fit begins with


def recorded(samples: int) -> tuple[Records, Signals]:
    """Return the first samples of the demo's log at noise level 1, and the signals in it."""
    log = simulate_log(0)
    columns = {"t": log.t, "x": log.measured[:, 0], "phi": log.measured[:, 1], "u": log.force}
    records = records_from({name: column[:samples] for name, column in columns.items()}, STUDY.layout())
    return records, estimate_signals(records, STUDY.measured(), STUDY.driven(), STUDY.signals.differentiator)


def averages(samples: int) -> Segments:
    records, signals = recorded(samples)
    return cut_segments(records, signals, Spectral())


def structure() -> tuple[Program, np.ndarray, np.ndarray]:
    """Return the cart's program, its true coefficients, and which of them are parameters: twelve."""
    model = cart_pendulum()
    frame = Frame.of(model.coordinates, [i.name for i in model.inputs])
    terms = [(r, t) for r, relation in enumerate(model.relations) for t in relation.terms]
    mechanisms = tuple(candidate(r, t.product, frame.targets[r]) for r, t in terms)
    free = np.flatnonzero([not frame.own(m) for m in mechanisms])
    return Program.of(mechanisms, frame), np.array([t.coefficient for _, t in terms]), free


def trajectory(repeats: int) -> tuple[list[Row], str]:
    """Return the rows of the fit and of the whole search, and a line on how the fit ended."""
    program, truth, free = structure()
    start = truth.copy()
    held = np.setdiff1d(np.arange(len(truth)), free)
    start[free] *= 1.0 + STARTS * np.random.default_rng(1).standard_normal(len(free))
    segments = averages(65_001)
    evaluator = Evaluator(segments)
    ends: list[Fit | None] = []

    def work() -> None:
        ends.append(fit(evaluator, program, start, held, segments.initial, segments.spread * WIDTHS[-1]))

    seconds = alternate({"fit": work}, repeats)["fit"]
    records, _ = recorded(65_001)
    identify(STUDY, records)
    searches = tuple(identify(STUDY, records).seconds["likelihood"] for _ in range(min(repeats, 3)))
    end = ends[-1]
    assert end is not None
    errors = (end.theta - truth)[free] / np.sqrt(end.variances)
    told = (
        f"{'converged' if end.converged else 'not converged'}; {len(segments.measured)} averages of {segments.block}"
        f" samples in {len(segments.start)} joined segments; coefficients off by"
        f" {np.sqrt(np.mean(errors**2)):.2f} standard errors (root mean square), at most {np.abs(errors).max():.1f}"
    )
    absent = "2.1 to 7.5 s, for a tenth of the samples and half the parameters; not rerun"
    limit = "evaluations of the trajectory and its sensitivities, each a pass of RK4 over all segments on two threads"
    return [
        Row(
            "trajectory fit, full continuity, 65 001 samples, 12 parameters, from 5 % off",
            seconds, 0.2, "casadi + IPOPT", None, 2.1 / 0.2, limit, absent,
        ),
        Row(
            "the whole structure search by likelihood, same record",
            Timing(searches), 2.0, "none", None, None, limit, "no counterpart",
        ),
    ], told  # fmt: skip


@numba.njit
def _slopes(t, state, force, period, q, cart, pole):
    """Return the cart's right-hand side for SciPy, written by hand and compiled for this one model."""
    k = min(int(t / period), len(force) - 2)
    u = force[k] + (t / period - k) * (force[k + 1] - force[k])
    _, phi, v, w = state
    s, c = math.sin(phi), math.cos(phi)
    below = 1.0 + q * c * c
    return np.array(
        [
            v,
            w,
            (cart[0] * u + cart[1] * v + cart[2] * w * w * s + cart[3] * w * c + cart[4] * s * c) / below,
            (pole[0] * u * c + pole[1] * v * c + pole[2] * w * w * s * c + pole[3] * w + pole[4] * s) / below,
        ]
    )


def simulation(repeats: int) -> tuple[list[Row], str]:
    log, model = simulate_log(0), cart_pendulum()
    t, force = np.ascontiguousarray(log.t[::EVERY]), np.ascontiguousarray(log.force[::EVERY])
    initial = np.array(START)
    cart, pole = (np.array([-t.coefficient for t in relation.terms[2:]]) for relation in model.relations)
    constants = force, float(t[1] - t[0]), model.relations[0].terms[1].coefficient, cart, pole

    def scipy(method: str) -> np.ndarray:
        return solve_ivp(_slopes, (t[0], t[-1]), initial, method, t, rtol=1e-8, atol=1e-10, args=constants).y.T

    timed = alternate(
        {
            "ours": lambda: simulate(model, t, force[:, None], initial),
            "RK45": lambda: scipy("RK45"),
            "LSODA": lambda: scipy("LSODA"),
        },
        repeats,
    )
    close = simulate(model, t, force[:, None], initial, 1e-12, 1e-14).states
    free = {
        "odescope": simulate(model, t, force[:, None], initial).states,
        "RK45": scipy("RK45"),
        "LSODA": scipy("LSODA"),
    }
    early = t <= COMPARED
    off = ", ".join(f"{name} {np.abs(states - close)[early].max():.1e}" for name, states in free.items())
    limit = (
        "no step runs over a kink of the sampled input, so there are 6 500 steps of seven evaluations at least, and"
        " each runs a generic tape: nothing is compiled for a model"
    )
    work = "simulation, 4 states, 65 s, 6 501 input samples, rtol 1e-8"
    rows = [
        Row(work, timed["ours"], 0.005, "SciPy RK45", timed["RK45"], 200 / 5, limit),
        Row(work, timed["ours"], 0.005, "SciPy LSODA", timed["LSODA"], 81 / 5, limit),
    ]
    return rows, f"largest deviation from a run at rtol 1e-12, in the first {COMPARED:g} s: {off}"


def growth(repeats: int) -> tuple[str, str, str, float]:
    """Return the likelihood's evaluation over N: what grows, sizes, times in ms, log-log slope."""
    program, truth, free = structure()
    sizes, seconds = [], []
    for samples in (8_126, 16_251, 32_501, 65_001):
        segments = averages(samples)
        evaluator, gap = Evaluator(segments), segments.spread * WIDTHS[-1]
        work = {"it": lambda e=evaluator, g=gap: e.expand(program, truth, free, e.segments.initial, g, 0.0)}
        sizes.append(len(segments.measured))
        seconds.append(alternate(work, 3 * repeats)["it"].best)
    texts = ", ".join(map(str, sizes)), ", ".join(f"{1e3 * s:.3g}" for s in seconds)
    return ("likelihood and its derivatives over averages of 9 samples", *texts, slope(sizes, seconds))


def commands(repeats: int) -> tuple[list[tuple[str, ...]], str]:
    """Return a table of commands (seconds, processor, target, met, peak MB), and a line on a cold start."""
    program = str(Path(sys.executable).with_name("odescope"))
    with tempfile.TemporaryDirectory() as folder:
        asked = {
            "Python itself": [sys.executable, "-c", "pass"],
            "`import odescope`": [sys.executable, "-c", "import odescope"],
            "`odescope --help`": [program, "--help"],
            "`odescope demo`": [program, "demo", "--out", str(Path(folder) / "demo")],
        }
        runs: dict[str, list[Process]] = {name: [] for name in asked}
        for turn in range(repeats + 1):
            for name, arguments in asked.items():
                if "demo" in name and turn > LONG:
                    continue
                found = command(arguments)
                if turn:  # the first round warms up
                    runs[name].append(found)
        cold = command(asked["`odescope demo`"], NUMBA_CACHE_DIR=str(Path(folder) / "empty"))
    targets = {"`import odescope`": 0.15, "`odescope --help`": 0.25}
    rows = []
    for name, found in runs.items():
        timing, target = Timing(tuple(r.seconds for r in found)), targets.get(name)
        verdict = (
            "" if target is None else "yes" if timing.median < target else "best run" if timing.best < target else "no"
        )
        wanted = "" if target is None else duration(target)
        busy = duration(float(np.median([r.busy for r in found])))
        rows.append((name, timing.text, busy, wanted, verdict, f"{max(r.megabytes for r in found):.0f}"))
    told = (
        f"With no kernel compiled yet `odescope demo` takes {cold.seconds:.0f} s, once. `--help` and an import compile"
        " nothing. Processor time is that of all threads; where it is less than the seconds waited, other work had the"
        " cores."
    )
    return rows, told
