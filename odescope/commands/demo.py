"""The paper's pendulum on a cart: the reference model, its simulated log, its study, and Table 2 (paper, section 4).

Errata mended: the coefficients are those of Table 2, I1 = 0.7 m1 a1^2, and phi_ddot = -C/D.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from odescope.arrays import FloatArray
from odescope.commands.files import MARKS, WRITTEN, check_writable, refuse_foreign
from odescope.events import FilesWritten, Monitor, StageBegan
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input
from odescope.report.data import TableRow
from odescope.study.toml import read_study

if TYPE_CHECKING:
    from odescope.commands.run import RunResult

DURATION, PERIOD = 65.0, 0.001
FORCE_RMS, FORCE_BAND = 20.0, 3.0  # newtons, hertz
START = (0.0, 30.0 * np.pi / 32.0, 0.0, 0.0)
NOISE = {1: (0.0005, 0.0025), 2: (0.005, 0.0025), 3: (0.05, 0.025), 4: (0.5, 0.25)}  # metres, radians
PAPER_JOINT_FRICTION = 0.01

LOG, STUDY_FILE = "log.csv", "demo.toml"
STUDY_HEAD = "# The paper's pendulum on a cart; see the README."
STUDY = """{head}

[data]
files = ["{log}"]
time = "t"

[coordinates.x]
order = 2
cyclic = true
unit = "m"

[coordinates.phi]
order = 2
angle = true
unit = "rad"

[inputs.u]
unit = "N"

[library]
preset = "paper"

[random]
seed = {seed}
"""


def cart_pendulum(joint_friction: float = PAPER_JOINT_FRICTION) -> Model:
    """Return the reference model (22), (23) in its explicit, rational form, with the parameters of Table 2.

    phi = 0 hangs down; joint_friction in N m s.
    """
    m1, mc, a1, bc, g = 1.0, 0.8, 0.18, 10.0, 9.81
    inertia = 0.7 * m1 * a1**2
    whole = inertia + m1 * a1**2
    scale = whole * (m1 + mc)
    q = -((m1 * a1) ** 2) / scale
    cart = {
        "u": -whole / scale,
        "x_dot": whole * bc / scale,
        "phi_dot**2*sin(phi)": -whole * m1 * a1 / scale,
        "phi_dot*cos(phi)": -m1 * a1 * joint_friction / scale,
        "sin(phi)*cos(phi)": -((m1 * a1) ** 2) * g / scale,
    }
    pendulum = {
        "u*cos(phi)": m1 * a1 / scale,
        "x_dot*cos(phi)": -m1 * a1 * bc / scale,
        "phi_dot**2*sin(phi)*cos(phi)": (m1 * a1) ** 2 / scale,
        "phi_dot": (m1 + mc) * joint_friction / scale,
        "sin(phi)": (m1 + mc) * m1 * a1 * g / scale,
    }
    coordinates = (Coordinate("x", 2, cyclic=True, unit="m"), Coordinate("phi", 2, angle=True, unit="rad"))
    scope = Scope.of(["x", "phi", "x_dot", "phi_dot", "u"])

    def relation(target: str, rest: Mapping[str, float]) -> Relation:
        denominator = (
            RelationTerm(Product(target), 1.0),
            RelationTerm(Product(target, parse_term("cos(phi)**2", scope)), q),
        )
        return Relation(
            (*denominator, *(RelationTerm(Product(None, parse_term(t, scope)), c) for t, c in rest.items()))
        )

    return Model(coordinates, (Input("u", "linear", "N"),), (relation("x_ddot", cart), relation("phi_ddot", pendulum)))


@dataclass(frozen=True, eq=False)
class SimulatedLog:
    """A simulated log: t (N,), force (N,), states (N, 4) without noise, measured (N, 2) with noise."""

    t: FloatArray
    force: FloatArray
    states: FloatArray
    measured: FloatArray


def run_demo(out: Path, seed: int, level: int, joint_friction: float, monitor: Monitor) -> RunResult:
    """Simulate a log, write it with its study to a folder, and identify it there; see `run_study`.

    Args:
        out: folder for the log, the study and the results.
        seed: of the force and the noise.
        level: of the noise, see `NOISE`.
        joint_friction: in N m s.
        monitor: whom to tell, and whom to ask whether to stop.
    """
    from odescope.commands.run import Reference, run_study

    check_writable(out)
    refuse_foreign(out, (*WRITTEN, LOG, STUDY_FILE), (*MARKS, (STUDY_FILE, STUDY_HEAD.encode())))
    out.mkdir(parents=True, exist_ok=True)
    monitor.tell(StageBegan("simulating the pendulum on a cart"))
    log = simulate_log(seed, level, joint_friction)
    study = write_log(out, log, seed)
    monitor.tell(FilesWritten(out, (LOG, STUDY_FILE)))
    truth = Reference(
        lambda: true_signals(log, joint_friction), lambda model: table_two(cart_pendulum(joint_friction), model)
    )
    title = "Pendulum on a cart"
    return run_study(read_study(study), out, out, title=title, source=study, reference=truth, monitor=monitor)


def simulate_log(seed: int, level: int = 1, joint_friction: float = PAPER_JOINT_FRICTION) -> SimulatedLog:
    """Return the log of one run: a force of white noise cut at 3 Hz, positions with white noise of the level.

    Args:
        seed: of the force and the noise.
        level: of the noise, see `NOISE`.
        joint_friction: in N m s.
    """
    rng = np.random.default_rng(seed)
    count = round(DURATION / PERIOD) + 1
    t = np.arange(count, dtype=np.float64) * np.float64(PERIOD)
    spectrum = np.fft.rfft(rng.standard_normal(count))
    spectrum[np.fft.rfftfreq(count, PERIOD) > FORCE_BAND] = 0.0
    force = np.fft.irfft(spectrum, count)
    force *= FORCE_RMS / np.sqrt(np.mean(force**2))
    run = simulate(cart_pendulum(joint_friction), t, force[:, None], np.array(START))
    noise = rng.standard_normal((count, 2)) * np.array(NOISE[level])
    return SimulatedLog(t, force, run.states, run.states[:, :2] + noise)


def true_signals(log: SimulatedLog, joint_friction: float) -> dict[str, FloatArray]:
    """Return every state and target of a log by name, (N,), without noise."""
    model = cart_pendulum(joint_friction)
    columns = np.ascontiguousarray(np.column_stack([log.states, log.force]).T)
    quotients = model.quotients
    values = evaluate(
        write_tape(model.variables, [p for q in quotients for p in (q.numerator, q.denominator)]), columns
    )
    targets = {q.target: values[2 * k] / values[2 * k + 1] for k, q in enumerate(quotients)}
    return dict(zip(model.states, log.states.T, strict=True)) | targets


def write_demo(folder: Path, seed: int, level: int, joint_friction: float) -> Path:
    """Write log.csv and demo.toml to a folder and return the path of the study.

    Args:
        folder: that is there.
        seed: of the force and the noise.
        level: of the noise, see `NOISE`.
        joint_friction: in N m s.
    """
    return write_log(folder, simulate_log(seed, level, joint_friction), seed)


def write_log(folder: Path, log: SimulatedLog, seed: int) -> Path:
    """Write a log as log.csv, with demo.toml beside it, and return the path of the study.

    Args:
        folder: that is there.
        log: what was simulated.
        seed: that the study is to have.
    """
    columns = np.column_stack([log.t, log.measured, log.force])
    rows = [",".join(map(repr, row)) for row in columns.tolist()]
    partial = folder / f".{LOG}.partial"
    try:
        partial.write_text("\n".join(["t,x,phi,u", *rows, ""]), encoding="utf-8", newline="\n")
        partial.replace(folder / LOG)
    finally:
        partial.unlink(missing_ok=True)
    (folder / STUDY_FILE).write_text(STUDY.format(head=STUDY_HEAD, log=LOG, seed=seed), encoding="utf-8")
    return folder / STUDY_FILE


# Table 2 of the paper, its model normalised to a denominator 1 + q cos^2(phi).
PAPER_TABLE: dict[str, dict[str, float]] = {
    "x_ddot": {
        "u": 0.55672,
        "x_dot": -5.6129,
        "phi_dot**2*sin(phi)": 0.10007,
        "cos(phi)*sin(phi)": 3.2232,
        "x_ddot*cos(phi)**2": -0.3231,
    },
    "phi_ddot": {
        "u*cos(phi)": -1.8095,
        "x_dot*cos(phi)": 18.898,
        "phi_dot**2*cos(phi)*sin(phi)": -0.3230,
        "sin(phi)": -32.058,
        "phi_ddot*cos(phi)**2": -0.3299,
    },
}


def table_two(truth: Model, found: Model) -> list[TableRow]:
    """Return Table 2 with three columns; a term that one of them lacks is None there."""
    rows = []
    for target, true, mine in zip(truth.targets, truth.relations, found.relations, strict=True):
        left, right = _normalised(true), _normalised(mine)
        for term in dict.fromkeys((*left, *right)):
            paper = PAPER_TABLE[target].get(term)
            rows.append(TableRow(target=target, term=term, truth=left.get(term), paper=paper, found=right.get(term)))
    return rows


def _normalised(relation: Relation) -> dict[str, float]:
    """Return numerator coefficients with the sign of the explicit form, and those of the denominator beside its 1."""
    return {
        t.text: t.coefficient if t.factor else -t.coefficient
        for t in relation.terms
        if not (t.factor and not t.term.factors)
    }
