"""The sweeps of bench/anchors.py, PySINDy beside odescope on the same matrices, and what it costs to grow them."""

from __future__ import annotations

import contextlib
import io
import json
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numba
import numpy as np
from demo_table import STUDY
from scipy.integrate import solve_ivp
from scipy.linalg.lapack import dposv
from timing import Row, Timing, alternate, command, duration, once, slope

from odescope.commands.demo import cart_pendulum, simulate_log, true_signals
from odescope.library.candidates import Library
from odescope.library.parse import Scope
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.recordings.readers import records_from
from odescope.regression.factor import Factor, factorise
from odescope.regression.proposers import EnergyThreshold
from odescope.regression.solve import normal_fit
from odescope.selection.sweep import Sweep, sweep
from odescope.signals.estimate import estimate_signals

try:
    import pysindy
except ImportError:
    pysindy = None

SAMPLES, FRICTION = 62_501, 0.01
THRESHOLDS = np.geomspace(1e-3, 1.0, 30)
ALL = (EnergyThreshold(),)


@dataclass(frozen=True, eq=False)
class Matrix:
    """A library on samples, (N, m), and the columns of the true relation of its target."""

    terms: tuple[Product, ...]
    theta: np.ndarray
    truth: tuple[int, ...]


def everything(factor: Factor, terms: Sequence[Product]) -> Sweep:
    return sweep(factor, terms, (tuple(range(len(terms))),), ALL)


def cart_matrix(target: str, kind: str) -> Matrix:
    """Return the paper's 35 candidates on the demo's run: exact signals, or those estimated at noise level 1."""
    log = simulate_log(0, 1, FRICTION)
    if kind == "exact":
        signals = true_signals(log, FRICTION) | {"u": log.force}
    else:
        data = {"t": log.t, "x": log.measured[:, 0], "phi": log.measured[:, 1], "u": log.force}
        coordinates, options = STUDY.measured(), STUDY.signals
        found = estimate_signals(
            records_from(data, STUDY.layout()), coordinates, STUDY.driven(), options.differentiator, decimate=False
        )
        signals = dict(zip(found.names, found.joined(), strict=True))
    skipped = (len(signals["x"]) - SAMPLES) // 2
    columns = np.ascontiguousarray([v[skipped : skipped + SAMPLES] for v in signals.values()])
    library = STUDY.candidates(target).products((target,))
    theta = np.ascontiguousarray(evaluate(write_tape(tuple(signals), [p.expanded for p in library]), columns).T)
    relation = next(r for r in cart_pendulum(FRICTION).relations if r.terms[0].factor == target)
    return Matrix(library, theta, tuple(sorted(library.index(t.product) for t in relation.terms)))


def sindy_pi(theta: np.ndarray, guesses: list[int]) -> np.ndarray:
    optimizer = pysindy.SINDyPI(reg_weight_lam=0.1, model_subset=guesses)
    # It prints a line a model.
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return optimizer.fit(theta, theta).coef_[guesses]


def holds_truth(coefficients: np.ndarray, guesses: Sequence[int], matrix: Matrix) -> bool:
    """Say whether some model of the peer has the true terms, cut at whatever energy suits it best."""
    norms = np.linalg.norm(matrix.theta, axis=0)
    for guess, row in zip(guesses, coefficients, strict=True):
        largest = np.argsort(np.abs(row) * norms)[::-1][: len(matrix.truth) - 1]
        if tuple(sorted({guess, *largest.tolist()})) == matrix.truth:
            return True
    return False


def pendulum(quick: bool, repeats: int) -> tuple[list[Row], list[tuple[str, ...]]]:
    """Return the SINDy-PI rows, and the table of answers."""
    matrix = cart_matrix("x_ddot", "exact")
    factored = Timing(tuple(once(lambda: factorise([matrix.theta])) for _ in range(repeats)))
    factor = factorise([matrix.theta])
    ours = alternate({"sweep": lambda: everything(factor, matrix.terms)}, repeats)["sweep"]
    columns = tuple(range(len(matrix.terms)))
    models = sum(len(list(ALL[0].supports(factor, guess, columns))) for guess in columns)
    theirs = each = None
    if pysindy is not None:
        guesses = [0, 17, 34] if quick else list(columns)
        theirs = Timing((once(lambda: sindy_pi(matrix.theta, guesses)),), len(columns) / len(guesses))
        each = Timing(theirs.seconds, 1.0 / len(guesses))
    limit = (
        "small fits, several to each support found, which the cores that other work uses as well do a factor of two"
        " slower than when they are free"
    )
    rows = [
        Row(
            "SINDy-PI, pendulum on a cart, 62 501 x 35: all guesses, all thresholds (peer: one)",
            ours,
            0.05,
            "SINDyPI",
            theirs,
            75.7 / 0.05,
            limit,
        ),
        Row(
            f"the same per model ({models} of ours, 35 of the peer's)",
            Timing(ours.seconds, 1.0 / models),
            1e-4,
            "SINDyPI",
            each,
            2.2 / 1e-4,
            limit,
        ),
        Row("the factor before it", factored, 0.1, "no counterpart", None, absent="none"),
    ]
    answers = [answer(target, kind, quick) for kind in ("exact", "estimated") for target in ("x_ddot", "phi_ddot")]
    return rows, answers


def answer(target: str, kind: str, quick: bool) -> tuple[str, ...]:
    """Return target, matrix, what odescope found and what the peer did, guesses of the truth's own terms."""
    matrix = cart_matrix(target, kind)
    found = everything(factorise([matrix.theta]), matrix.terms)
    held = "yes" if matrix.truth in found.supports else "no"
    if pysindy is None:
        return target, kind, str(len(found.supports)), held, "PySINDy not installed", ""
    guesses = list(matrix.truth[-2:] if quick else matrix.truth)  # the last of them hold the target
    coefficients = sindy_pi(matrix.theta, guesses)
    energies = np.abs(coefficients) * np.linalg.norm(matrix.theta, axis=0)
    dense = np.median(np.sum(energies > 1e-6 * energies.max(axis=1, keepdims=True), axis=1))
    theirs = "yes" if holds_truth(coefficients, guesses, matrix) else "no"
    return target, kind, str(len(found.supports)), held, f"{dense:.0f} of 34", theirs


def monomials(samples: int, degree: int) -> tuple[tuple[Product, ...], np.ndarray]:
    """Return the monomials of Lorenz's states, each brought to the unit interval, with the noise of 1 %."""
    run = solve_ivp(
        lambda _, s: [10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 8 / 3 * s[2]],
        (0.0, samples * 1e-3),
        [-8.0, 7.0, 27.0],
        t_eval=np.arange(samples) * 1e-3,
        rtol=1e-8,
    )
    states = run.y / np.abs(run.y).max(axis=1, keepdims=True)
    states += 0.01 * np.random.default_rng(0).standard_normal(states.shape)
    names = ("x", "y", "z")
    terms = Library.of(names, Scope.of(names)).powers(degree).products(())
    return terms, np.ascontiguousarray(evaluate(write_tape(names, [p.term for p in terms]), states).T)


def stlsq(theta: np.ndarray, guesses: Sequence[int]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for guess in guesses:
            others = np.delete(theta, guess, axis=1)
            for threshold in THRESHOLDS:
                pysindy.STLSQ(threshold=float(threshold), alpha=0.0).fit(others, theta[:, [guess]])


def thresholds(quick: bool, repeats: int) -> list[Row]:
    rows = []
    for degree, target, anchor in ((3, 0.05, 15.0), (5, 0.3, 299.0), (6, 0.8, 418.0)):
        terms, theta = monomials(50_000, degree)
        m, factor = len(terms), factorise([theta])
        guesses = np.linspace(1, m - 1, 2 if quick else m - 1).astype(int).tolist()
        ours = alternate({"sweep": lambda factor=factor, terms=terms: everything(factor, terms)}, repeats)["sweep"]
        theirs = None
        if pysindy is not None:
            theirs = Timing((once(lambda theta=theta, guesses=guesses: stlsq(theta, guesses)),), m / len(guesses))
        limit = (
            "every distinct support is a Cholesky of its own, and supports are thousands here: the time is theirs and"
            " grows with their number, which the data decide. `terms = 30`, the default of a study, ends the walk early"
        )
        work = f"N = 50 000, m = {m}: all guesses, all thresholds (peer: 30)"
        rows.append(Row(work, ours, target, "STLSQ", theirs, anchor / target, limit))
    return rows


def million(repeats: int) -> tuple[Row, str, float, str]:
    """Return the row, processor time of the process, its peak memory in MB, and how the time divides."""
    script = str(Path(__file__).with_name("large_sweep.py"))
    runs = [command([sys.executable, script]) for _ in range(repeats)]
    found = [json.loads(run.output) for run in runs]
    row = Row(
        "N = 10^6, m = 100: factor streamed in blocks, all guesses, all thresholds",
        Timing(tuple(f["factor"] + f["sweep"] for f in found)),
        5.0,
        "none",
        None,
        limit="the QR of the blocks by LAPACK, 20 GFlop",
        absent="no counterpart",
    )
    factor, swept = (float(np.median([f[part] for f in found])) for part in ("factor", "sweep"))
    law = "the law is among them" if all(f["law"] for f in found) else "the law is not among them"
    detail = f"factor {factor:.1f} s, sweep {swept:.1f} s, {found[0]['supports']} supports, {law}"
    busy = duration(float(np.median([run.busy for run in runs])))
    return row, busy, max(run.megabytes for run in runs), detail


@numba.njit(nogil=True)
def _solve_all(r, gram, supports, left, x):  # as the sweep calls it: from compiled code
    for k in range(supports.shape[0]):
        x[k] = normal_fit(r, gram, supports[k], left)


def solves(repeats: int) -> list[Row]:
    """Return 10^4 solves of size 35 beside numpy's and LAPACK's."""
    rng = np.random.default_rng(0)
    r = factorise([rng.standard_normal((1000, 41))]).r
    gram = r.T @ r
    supports = np.sort(np.array([rng.permutation(40)[:35] for _ in range(10_000)]), axis=1)
    matrices = np.ascontiguousarray(gram[supports[:, :, None], supports[:, None, :]])
    right, x = np.ascontiguousarray(gram[supports, 40]), np.empty((10_000, 35))
    timed = alternate(
        {
            "ours": lambda: _solve_all(r, gram, supports, 40, x),
            "numpy": lambda: np.linalg.solve(matrices, right[:, :, None]),
            "lapack": lambda: [dposv(a, b) for a, b in zip(matrices, right, strict=True)],
        },
        repeats,
    )
    limit = (
        "the sweep's fit does more than the peers' solve: it gathers its matrix from the Gram matrix, watches every"
        " pivot, and refines the answer once on R; one thread, as a sweep gives the other to another guess"
    )
    work = "10^4 symmetric solves of size 35"
    return [
        Row(work, timed["ours"], 0.014, "numpy batched", timed["numpy"], 72 / 14, limit),
        Row(work, timed["ours"], 0.014, "LAPACK dposv in a loop", timed["lapack"], 61 / 14, limit),
    ]


def growth(repeats: int) -> list[tuple[str, str, str, float]]:
    """Return what grows, its sizes, its times in ms, and the log-log slope."""
    rng = np.random.default_rng(0)
    found = []

    def curve(name: str, sizes: Sequence[int], work: Callable[[int], Callable[[], object]]) -> None:
        # The least of several: what a size costs when nothing else runs.
        seconds = [alternate({"it": work(n)}, repeats)["it"].best for n in sizes]
        texts = ", ".join(map(str, sizes)), ", ".join(f"{1e3 * s:.3g}" for s in seconds)
        found.append((name, *texts, slope(sizes, seconds)))

    def of_width(m: int) -> Callable[[], object]:
        mixed = rng.standard_normal((5000, m)) @ (np.eye(m) + 0.1 * rng.standard_normal((m, m)))
        factor, terms = (
            factorise([mixed]),
            Library.of([f"a{k}" for k in range(m)], Scope.of([f"a{k}" for k in range(m)])).products(()),
        )
        return lambda: everything(factor, terms)

    curve("sweep over m (all guesses, all thresholds)", (20, 28, 40, 56, 80), of_width)
    curve(
        "factor over N (m = 35)",
        (15_625, 31_250, 62_500, 125_000, 250_000),
        lambda n: partial(factorise, [rng.standard_normal((n, 35))]),
    )
    curve(
        "factor over m (N = 50 000)",
        (20, 40, 80),
        lambda m: partial(factorise, [rng.standard_normal((50_000, m))]),
    )
    return found
