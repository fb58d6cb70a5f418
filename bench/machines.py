"""Machines and reactors whose truth is a few mechanisms, and relations without a bare target: rows of recovery.py.

Every machine has its equations of motion by hand, from which its data come, beside its truth; what the data could tell
is in bench/identifiable.py, the names are in bench/catalogue.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from excitation import band
from scipy.integrate import DOP853
from truths import SLIDING, Truth, lagrangian, reactions

from odescope import Candidates, Data, Driven, Measured, Study
from odescope.commands.demo import NOISE, simulate_log

Recordings = list[dict[str, np.ndarray]]
Rate = Callable[[np.ndarray, np.ndarray], np.ndarray]  # of states and inputs


@dataclass(frozen=True, eq=False)
class Machine:
    """A system with its recordings, its noise by level, and its truth.

    Attributes:
        coordinates: those of the study; likewise inputs and library.
        truth: the mechanisms.
        rate: the derivative of the states, by hand.
        runs: recordings of a seed: t, states and inputs without noise, and `noise` (N, c) of size one.
        noise: standard deviation of each coordinate, by level.
        relative: whether these are multiples of the coordinate's standard deviation.
        spoilt: what becomes of the measured coordinates (N, c), given a generator.
    """

    coordinates: dict[str, Measured]
    truth: Truth
    rate: Rate
    runs: Callable[[int], Recordings]
    noise: Mapping[int, tuple[float, ...]]
    inputs: dict[str, Driven] = field(default_factory=dict)
    library: dict[str, object] = field(default_factory=dict)
    relative: bool = False
    spoilt: Callable[[np.ndarray, np.random.Generator], np.ndarray] = lambda measured, _: measured

    @property
    def study(self) -> Study:
        """The study; it needs the forms of the library that the machine names."""
        return Study(
            data=Data(time="t"),
            coordinates=self.coordinates,
            inputs=self.inputs,
            library=Candidates(**self.library),  # type: ignore[arg-type]
        )

    def sigma(self, clean: Recordings, level: int) -> np.ndarray:
        """Return the standard deviation (c,) of the noise in each coordinate."""
        size = np.array(self.noise[level])
        if not self.relative:
            return size
        return size * np.array([np.concatenate([run[name] for run in clean]).std() for name in self.coordinates])

    def recorded(self, clean: Recordings, level: int, seed: int) -> Recordings:
        """Return the recordings as they are measured."""
        sigma, recordings = self.sigma(clean, level), []
        for k, run in enumerate(clean):
            measured = np.column_stack([run[name] for name in self.coordinates]) + sigma * run["noise"]
            measured = self.spoilt(measured, np.random.default_rng([seed, k]))
            columns = dict(zip(self.coordinates, np.ascontiguousarray(measured.T), strict=True))
            recordings.append({"t": run["t"], **columns, **{name: run[name] for name in self.inputs}})
        return recordings

    def states(self, clean: Recordings) -> list[np.ndarray]:
        """Return the states (N, n) of each recording."""
        return [np.column_stack([run[name] for name in self.truth.model.states]) for run in clean]


def parts(coordinates: dict[str, Measured], inputs: dict[str, Driven]) -> tuple:
    study = Study(coordinates=coordinates, inputs=inputs)
    return study.measured(), study.driven()


def follow(truth: Truth, rate: Rate, t: np.ndarray, start: np.ndarray, rng: np.random.Generator, **u: np.ndarray):
    """Return the recording of a run, its inputs linear between samples; no step passes over a kink."""
    period, values = t[1] - t[0], np.column_stack([*u.values(), np.zeros(len(t))])
    k = 0

    def slope(now: float, s: np.ndarray) -> np.ndarray:
        return rate(s, values[k] + (now - t[k]) / period * (values[k + 1] - values[k]))

    solver, states = DOP853(slope, 0.0, start, t[1], rtol=1e-10, atol=1e-12), [start]
    for k in range(len(t) - 1):
        solver.t_bound, solver.status = t[k + 1], "running"
        while solver.status == "running":
            failure = solver.step()
            if failure:
                raise RuntimeError(failure)
        states.append(solver.y)
    noise = rng.standard_normal((len(t), len(truth.coordinates)))
    return {"t": t, **dict(zip(truth.model.states, np.array(states).T, strict=True)), **u, "noise": noise}


def cart(joint_friction: float = 0.01) -> Machine:
    """The paper's cart with a pendulum: the very logs of the demo, and a level beyond."""
    m, whole, a, b, g = 1.0, 1.8, 0.18, 10.0, 9.81
    inertia = 1.7 * m * a**2
    coordinates = {"x": Measured(order=2, cyclic=True), "phi": Measured(order=2, angle=True)}
    inputs = {"u": Driven()}
    truth = lagrangian(
        *parts(coordinates, inputs),
        {"x_dot**2": whole / 2, "x_dot*phi_dot*cos(phi)": m * a, "phi_dot**2": inertia / 2},
        {"cos(phi)": -m * a * g},
        {"x_dot**2": b / 2, "phi_dot**2": joint_friction / 2},
        {"x": {"u": 1.0}},
    )

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        _, phi, v, w = s
        c = m * a * np.cos(phi)
        right = u[0] - b * v + m * a * np.sin(phi) * w * w, -joint_friction * w - m * a * g * np.sin(phi)
        return np.array([v, w, *np.linalg.solve([[whole, c], [c, inertia]], right)])

    def runs(seed: int) -> Recordings:
        log = simulate_log(seed, 1, joint_friction)
        noise = (log.measured - log.states[:, :2]) / NOISE[1]
        return [
            {"t": log.t, **dict(zip(truth.model.states, log.states.T, strict=True)), "u": log.force, "noise": noise}
        ]

    return Machine(coordinates, truth, rate, runs, {**NOISE, 5: (1.0, 0.5)}, inputs, {"form": "lagrangian"})


def arms(dry: bool = False) -> Machine:
    """Two arms that hang from a motor, absolute angles, friction at the base and at the elbow between them."""
    a, b, c, g1, g2, b1, b2 = 0.20, 0.08, 0.07, 4.0, 1.8, 0.15, 0.04
    f1, f2 = (0.35, 0.08) if dry else (0.0, 0.0)
    coordinates, inputs = {"q1": Measured(order=2, angle=True), "q2": Measured(order=2, angle=True)}, {"u": Driven()}
    truth = lagrangian(
        *parts(coordinates, inputs),
        {"q1_dot**2": a / 2, "q1_dot*q2_dot*cos(q1 - q2)": c, "q2_dot**2": b / 2},
        {"cos(q1)": -g1, "cos(q2)": -g2},
        {"q1_dot**2": b1 / 2, "(q1_dot - q2_dot)**2": b2 / 2}
        | ({"abs(q1_dot)": f1, "abs(q1_dot - q2_dot)": f2} if dry else {}),
        {"q1": {"u": 1.0}},
    )

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        q1, q2, v1, v2 = s
        mixed, twist, rub = c * np.cos(q1 - q2), c * np.sin(q1 - q2), b2 * (v1 - v2)
        if dry:
            rub += f2 * np.tanh(SLIDING * (v1 - v2))
        base = b1 * v1 + (f1 * np.tanh(SLIDING * v1) if dry else 0.0)
        right = (
            u[0] - g1 * np.sin(q1) - base - rub - twist * v2 * v2,
            -g2 * np.sin(q2) + rub + twist * v1 * v1,
        )
        return np.array([v1, v2, *np.linalg.solve([[a, mixed], [mixed, b]], right)])

    def runs(seed: int) -> Recordings:
        rng, t = np.random.default_rng(seed), np.arange(5001) * 0.005
        return [follow(truth, rate, t, np.array([0.3, -0.5, 0.0, 0.0]), rng, u=band(rng, t, 2.0, 2.0))]

    noise = {1: (0.001,) * 2, 2: (0.005,) * 2, 3: (0.02,) * 2, 4: (0.1,) * 2}
    return Machine(coordinates, truth, rate, runs, noise, inputs, {} if dry else {"form": "lagrangian"})


def rotary() -> Machine:
    """A pendulum on a rotary arm (Furuta), th = 0 upright; sin(th)^2 is (1 - cos(2 th)) / 2."""
    base, swing, c, g, b1, b2 = 0.006, 0.0025, 0.0022, 0.10, 0.004, 0.0006
    coordinates = {"arm": Measured(order=2, cyclic=True), "th": Measured(order=2, angle=True)}
    inputs = {"u": Driven()}
    truth = lagrangian(
        *parts(coordinates, inputs),
        {
            "arm_dot**2": base / 2 + swing / 4,
            "arm_dot**2*cos(2*th)": -swing / 4,
            "arm_dot*th_dot*cos(th)": c,
            "th_dot**2": swing / 2,
        },
        {"cos(th)": g},
        {"arm_dot**2": b1 / 2, "th_dot**2": b2 / 2},
        {"arm": {"u": 1.0}},
    )

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        _, th, v, w = s
        sine, cosine = np.sin(th), np.cos(th)
        right = (
            u[0] - b1 * v - 2 * swing * sine * cosine * v * w + c * sine * w * w,
            g * sine - b2 * w + swing * sine * cosine * v * v,
        )
        return np.array([v, w, *np.linalg.solve([[base + swing * sine**2, c * cosine], [c * cosine, swing]], right)])

    def runs(seed: int) -> Recordings:
        rng, t = np.random.default_rng(seed), np.arange(5001) * 0.005
        return [follow(truth, rate, t, np.array([0.0, 2.8, 0.0, 0.0]), rng, u=band(rng, t, 2.5, 0.06))]

    noise = {1: (0.001,) * 2, 2: (0.005,) * 2, 3: (0.02,) * 2, 4: (0.1,) * 2}
    return Machine(coordinates, truth, rate, runs, noise, inputs, {"form": "lagrangian"})


def cart_dry() -> Machine:
    """The cart with dry friction of the wheels and of the joint beside the viscous, at default settings."""
    m, whole, a, b, b1, f, f1, g = 1.0, 1.8, 0.18, 5.0, 0.02, 4.0, 0.05, 9.81
    inertia = 1.7 * m * a**2
    coordinates = {"x": Measured(order=2, cyclic=True), "phi": Measured(order=2, angle=True)}
    inputs = {"u": Driven()}
    truth = lagrangian(
        *parts(coordinates, inputs),
        {"x_dot**2": whole / 2, "x_dot*phi_dot*cos(phi)": m * a, "phi_dot**2": inertia / 2},
        {"cos(phi)": -m * a * g},
        {"x_dot**2": b / 2, "abs(x_dot)": f, "phi_dot**2": b1 / 2, "abs(phi_dot)": f1},
        {"x": {"u": 1.0}},
    )

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        _, phi, v, w = s
        c, sine = m * a * np.cos(phi), m * a * np.sin(phi)
        wheels, joint = b * v + f * np.tanh(SLIDING * v), b1 * w + f1 * np.tanh(SLIDING * w)
        return np.array(
            [v, w, *np.linalg.solve([[whole, c], [c, inertia]], (u[0] - wheels + sine * w * w, -joint - g * sine))]
        )

    def runs(seed: int) -> Recordings:
        rng, t = np.random.default_rng(seed), np.arange(6001) * 0.005
        return [follow(truth, rate, t, np.array([0.0, 2.9, 0.0, 0.0]), rng, u=band(rng, t, 3.0, 20.0))]

    return Machine(coordinates, truth, rate, runs, {1: (0.0005, 0.0025), 2: (0.005, 0.025)}, inputs)


def late(measured: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the samples with forty of them late: what was read is the one before."""
    at = rng.choice(np.arange(1, len(measured)), 40, replace=False)
    spoilt = measured.copy()
    spoilt[at] = measured[at - 1]
    return spoilt


def stepped(machine: Machine, steps: tuple[float, ...]) -> Machine:
    """Return the machine read by encoders of these steps; the bound is that of white noise as large."""

    def spoilt(measured: np.ndarray, _: np.random.Generator) -> np.ndarray:
        return np.round(measured / steps) * steps

    def runs(seed: int) -> Recordings:
        return [{**run, "noise": np.zeros_like(run["noise"])} for run in machine.runs(seed)]

    return replace(machine, runs=runs, noise={1: tuple(s / np.sqrt(12) for s in steps)}, spoilt=spoilt)


def enzyme() -> Machine:
    """S + E <-> C -> P + E, all four measured, eight beginnings."""
    k1, back, k2 = 1.0, 0.4, 0.8
    coordinates = {name: Measured() for name in "SECP"}
    truth = reactions(parts(coordinates, {})[0], {"S + E -> C": k1, "C -> S + E": back, "C -> P + E": k2})

    def rate(s: np.ndarray, _: np.ndarray) -> np.ndarray:
        bind, split, turn = k1 * s[0] * s[1], back * s[2], k2 * s[2]
        return np.array([split - bind, split + turn - bind, bind - split - turn, turn])

    def runs(seed: int) -> Recordings:
        rng, t = np.random.default_rng(seed), np.arange(201) * 0.04
        starts = [(rng.uniform(0.5, 4.0), rng.uniform(0.3, 2.0), 0.0, 0.0) for _ in range(8)]
        return [follow(truth, rate, t, np.array(start), rng) for start in starts]

    composition = {"S": "s", "E": "e", "C": "s e", "P": "s"}
    library = {"form": "reactions", "composition": composition}
    return Machine(coordinates, truth, rate, runs, {1: (0.05,) * 4}, {}, library, relative=True)
