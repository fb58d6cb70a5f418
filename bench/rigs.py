"""Six machines as they stand in workshops, parameters drawn by seed, with their equations of motion by hand.

| rig | drawn uniformly |
|---|---|
| stage: m x'' + b x' + F sign(x') = f | m 20 to 120 kg, b/m 0.5 to 4 /s, F/m 0.1 to 0.4 m/s^2 |
| cart: a pendulum on it, dry friction of wheels and joint | whole mass 1 to 3 kg, 0.2 to 0.4 of it the pendulum's, |
| | its centre at 0.15 to 0.35 m, inertia 1.1 to 1.6 m a^2, b/M 1 to 4 /s, F/M 0.3 to 1.5 m/s^2, joint: viscous |
| | 0.05 to 0.3 /s and dry 0.3 to 1.5 rad/s^2 of its inertia |
| arm: two driven links, second angle relative to the first | m1, m2 0.3 to 0.8 kg, l1 0.2 to 0.35 m, centres at |
| | 0.6 to 1 of l1 and 0.12 to 0.22 m, inertia 1.05 to 1.3 m r^2, joints: viscous 0.005 to 0.04 N m s, dry 0.03 to |
| | 0.12 N m |
| tanks: h1' = k u - c1 sqrt(h1), h2' = c2 sqrt(h1) - c3 sqrt(h2) | mean levels 3 to 8, c1 0.1 to 0.2, c2/c1 0.7 |
| | to 1.2 |
| motor: q'' + b q' + F sign(q') + p = k v | b 1 to 4 /s, F 2 to 8 rad/s^2, k 20 to 60 rad/s^2/V; p by chance the |
| | spring 30 to 80 q, or the disc 30 to 80 sin(q), q then an angle |
| spindle: w' + b w + F sign(w) + d w abs(w) = k v, of which the speed w is read | b 0.3 to 2 /s, F 5 to 40 rad/s^2, |
| | d 0.002 to 0.02, k 20 to 80 rad/s^2/V |

The stage follows a reference of band-limited noise (0.3 to 0.6 Hz, 0.1 m) in closed loop, 1 to 2 Hz wide, damping 0.7
to 1; the others run open loop under band-limited noise. Positions are read with white noise, sizes at level 1: stage
20 to 100 um, cart 0.1 to 0.4 mm and 0.5 to 1.5 mrad, arm and motor 0.5 to 1.5 mrad, tanks 0.002 to 0.01, spindle 0.02
to 0.1 rad/s; levels multiply it. Dry friction is tanh(v/w) with w a two hundredth of a usual speed, or less.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import cos, sin, sqrt, tanh

import numpy as np
from excitation import band
from travel import Drive, Rate
from truths import Truth, relations

from odescope import Candidates, Data, Driven, Measured, Study

Law = Sequence[tuple[str | None, str, float]]  # (factor, term, coefficient), which add up to zero
GRAVITY = 9.81


@dataclass(frozen=True, eq=False)
class Rig:
    """A machine, how it is driven and read, and its truth.

    Attributes:
        coordinates: those of the study, which names nothing else but the inputs and the library.
        laws: one a target, by target, with sign(v) for dry friction; the first term sets the scale.
        rate: the derivative of the states, by hand, with tanh(v/w).
        drive: from a generator and the sample times.
        start: states.
        strength: root mean square of each input, roughly: the measure of disturbances.
        noise: standard deviation of each coordinate's readings at level 1.
        step: of each coordinate's encoder at its finest.
        period: of the samples, seconds.
        samples: of a recording.
        also: further laws that follow from these and that a model may hold instead of one of them.
    """

    coordinates: Mapping[str, Measured]
    laws: Mapping[str, Law]
    rate: Rate
    drive: Callable[[np.random.Generator, np.ndarray], Drive]
    start: tuple[float, ...]
    strength: Mapping[str, float]
    noise: tuple[float, ...]
    step: tuple[float, ...]
    period: float
    samples: int
    library: Candidates = field(default_factory=Candidates)
    also: tuple[Law, ...] = ()

    @property
    def study(self) -> Study:
        """The study as a user would write it."""
        inputs = {name: Driven() for name in self.strength}
        return Study(data=Data(time="t"), coordinates=dict(self.coordinates), inputs=inputs, library=self.library)

    def truth(self, beside: Sequence[float]) -> Truth:
        """Return the equations of motion where these constants act beside the inputs."""
        study = self.study
        laws = {target: self.displaced(law, beside) for target, law in self.laws.items()}
        return relations(study.measured(), study.driven(), laws)

    def displaced(self, law: Law, beside: Sequence[float]) -> Law:
        """Return a law in which every input stands beside a constant."""
        constants = dict(zip(self.strength, beside, strict=True))
        whole = sum(c * constants.get(text, 0.0) for factor, text, c in law if factor is None)
        return (*law, (None, "1", whole)) if whole else law


def less(first: Law, second: Law) -> Law:
    """Return the difference of two laws."""
    total = {(factor, text): c for factor, text, c in first}
    for factor, text, c in second:
        total[factor, text] = total.get((factor, text), 0.0) - c
    return tuple((factor, text, c) for (factor, text), c in total.items() if c)


def played(signals: Sequence[np.ndarray]) -> Drive:
    """Return the drive that plays signals back, whatever the machine does."""
    rows = np.column_stack(signals)
    return lambda k, _: rows[k]


def stage(rng: np.random.Generator) -> Rig:
    m, width = rng.uniform(20.0, 120.0), 5e-4
    b, dry = m * rng.uniform(0.5, 4.0), m * rng.uniform(0.1, 0.4)
    pull, damping = 2 * np.pi * rng.uniform(1.0, 2.0), rng.uniform(0.7, 1.0)
    hertz = rng.uniform(0.3, 0.6)

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([s[1], (u[0] - b * s[1] - dry * tanh(s[1] / width)) / m])

    def drive(rng: np.random.Generator, t: np.ndarray) -> Drive:
        wanted = band(rng, t, hertz, 0.1)
        speed = np.gradient(wanted, t)

        def control(k: int, s: np.ndarray) -> np.ndarray:
            return np.array([m * (pull**2 * (wanted[k] - s[0]) + 2 * damping * pull * (speed[k] - s[1]))])

        # The loop is to begin without a jolt.
        return lambda k, s: control(k, s) * min(1.0, k / 100)

    law = (("x_ddot", "1", m), (None, "x_dot", b), (None, "sign(x_dot)", dry), (None, "f", -1.0))
    return Rig(
        {"x": Measured(order=2)}, {"x_ddot": law}, rate, drive, (0.0, 0.0), {"f": dry + 0.1 * b + 0.25 * m},
        (rng.uniform(2e-5, 1e-4),), (5e-5,), 0.004, 3001,
    )  # fmt: skip


def cart(rng: np.random.Generator) -> Rig:
    whole, width = rng.uniform(1.0, 3.0), 1e-3
    m, a = whole * rng.uniform(0.2, 0.4), rng.uniform(0.15, 0.35)
    arm, inertia = m * a, m * a**2 * rng.uniform(1.1, 1.6)
    b, dry = whole * rng.uniform(1.0, 4.0), whole * rng.uniform(0.3, 1.5)
    b1, dry1 = inertia * rng.uniform(0.05, 0.3), inertia * rng.uniform(0.3, 1.5)
    push = whole * rng.uniform(2.0, 4.0)

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        _, phi, v, w = s
        c, swing = arm * cos(phi), arm * sin(phi)
        r1 = u[0] - b * v - dry * tanh(v / width) + swing * w * w
        r2 = -b1 * w - dry1 * tanh(w / width) - swing * GRAVITY
        d = whole * inertia - c * c
        return np.array([v, w, (inertia * r1 - c * r2) / d, (whole * r2 - c * r1) / d])

    laws: dict[str, Law] = {
        "x_ddot": (
            ("x_ddot", "1", whole), ("phi_ddot", "cos(phi)", arm), (None, "phi_dot**2*sin(phi)", -arm),
            (None, "x_dot", b), (None, "sign(x_dot)", dry), (None, "u", -1.0),
        ),
        "phi_ddot": (
            ("phi_ddot", "1", inertia), ("x_ddot", "cos(phi)", arm), (None, "sin(phi)", arm * GRAVITY),
            (None, "phi_dot", b1), (None, "sign(phi_dot)", dry1),
        ),
    }  # fmt: skip
    return Rig(
        {"x": Measured(order=2), "phi": Measured(order=2, angle=True)}, laws, rate,
        lambda rng, t: played([band(rng, t, 2.5, push)]), (0.0, rng.uniform(-1.0, 1.0), 0.0, 0.0), {"u": push},
        (rng.uniform(1e-4, 4e-4), rng.uniform(5e-4, 1.5e-3)), (1e-4, 2 * np.pi / 8192), 0.005, 3001,
    )  # fmt: skip


def arm(rng: np.random.Generator) -> Rig:
    m1, m2, l1 = rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.8), rng.uniform(0.2, 0.35)
    r1, r2, width = l1 * rng.uniform(0.6, 1.0), rng.uniform(0.12, 0.22), 1e-3
    b = m2 * r2**2 * rng.uniform(1.05, 1.3)
    a = m1 * r1**2 * rng.uniform(1.05, 1.3) + b + m2 * l1**2
    c, g1, g2 = m2 * l1 * r2, (m1 * r1 + m2 * l1) * GRAVITY, m2 * r2 * GRAVITY
    rub1, rub2 = rng.uniform(0.005, 0.04, 2)
    dry1, dry2 = rng.uniform(0.03, 0.12, 2)

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        q1, q2, v, w = s
        bend, twist, weight = c * cos(q2), c * sin(q2), g2 * sin(q1 + q2)
        m11, m12 = a + 2.0 * bend, b + bend
        r1 = u[0] - rub1 * v - dry1 * tanh(v / width) + twist * (2.0 * v * w + w * w) - g1 * sin(q1) - weight
        r2 = u[1] - rub2 * w - dry2 * tanh(w / width) - twist * v * v - weight
        d = m11 * b - m12 * m12
        return np.array([v, w, (b * r1 - m12 * r2) / d, (m11 * r2 - m12 * r1) / d])

    first: Law = (
        ("q1_ddot", "1", a), ("q1_ddot", "cos(q2)", 2 * c), ("q2_ddot", "1", b), ("q2_ddot", "cos(q2)", c),
        (None, "q1_dot*q2_dot*sin(q2)", -2 * c), (None, "q2_dot**2*sin(q2)", -c), (None, "sin(q1)", g1),
        (None, "sin(q1 + q2)", g2), (None, "q1_dot", rub1), (None, "sign(q1_dot)", dry1), (None, "u1", -1.0),
    )  # fmt: skip
    second: Law = (
        ("q2_ddot", "1", b), ("q1_ddot", "1", b), ("q1_ddot", "cos(q2)", c), (None, "q1_dot**2*sin(q2)", c),
        (None, "sin(q1 + q2)", g2), (None, "q2_dot", rub2), (None, "sign(q2_dot)", dry2), (None, "u2", -1.0),
    )  # fmt: skip
    angle, sizes = Measured(order=2, angle=True), (0.2 * g1, 0.3 * g2)

    def drive(rng: np.random.Generator, t: np.ndarray) -> Drive:
        return played([band(rng, t, 2.5, size) for size in sizes])

    return Rig(
        {"q1": angle, "q2": angle}, {"q1_ddot": first, "q2_ddot": second}, rate, drive,
        (*rng.uniform(-0.6, 0.6, 2), 0.0, 0.0), dict(zip(("u1", "u2"), sizes, strict=True)),
        tuple(rng.uniform(5e-4, 1.5e-3, 2)), (2 * np.pi / 8192,) * 2, 0.005, 3001, also=(less(first, second),),
    )  # fmt: skip


def tanks(rng: np.random.Generator) -> Rig:
    (h1, h2), c1 = rng.uniform(3.0, 8.0, 2), rng.uniform(0.1, 0.2)
    c2, mean = c1 * rng.uniform(0.7, 1.2), 3.0
    k, c3 = c1 * sqrt(h1) / mean, c2 * sqrt(h1 / h2)

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([k * u[0] - c1 * sqrt(s[0]), c2 * sqrt(s[0]) - c3 * sqrt(s[1])])

    laws: dict[str, Law] = {
        "h1_dot": (("h1_dot", "1", 1.0), (None, "u", -k), (None, "sqrt(h1)", c1)),
        "h2_dot": (("h2_dot", "1", 1.0), (None, "sqrt(h1)", -c2), (None, "sqrt(h2)", c3)),
    }

    def drive(rng: np.random.Generator, t: np.ndarray) -> Drive:
        return played([mean * (1.0 + 0.6 * np.tanh(band(rng, t, 0.015, 0.6)))])

    return Rig(
        {"h1": Measured(), "h2": Measured()}, laws, rate, drive, (h1, h2), {"u": 0.4 * mean},
        tuple(rng.uniform(0.002, 0.01, 2)), (0.005, 0.005), 1.0, 3001,
        Candidates(basis=("sqrt(h1)", "sqrt(h2)", "u")),
    )  # fmt: skip


def motor(rng: np.random.Generator) -> Rig:
    b, dry, gain = rng.uniform(1.0, 4.0), rng.uniform(2.0, 8.0), rng.uniform(20.0, 60.0)
    disc, pull, width = rng.random() < 0.5, rng.uniform(30.0, 80.0), 2e-3

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        turn = sin(s[0]) if disc else s[0]
        return np.array([s[1], gain * u[0] - b * s[1] - dry * tanh(s[1] / width) - pull * turn])

    law = (
        ("q_ddot", "1", 1.0), (None, "q_dot", b), (None, "sign(q_dot)", dry), (None, "sin(q)" if disc else "q", pull),
        (None, "v", -gain),
    )  # fmt: skip
    volts = 0.6 * pull / gain
    return Rig(
        {"q": Measured(order=2, angle=disc)}, {"q_ddot": law}, rate, lambda rng, t: played([band(rng, t, 3.0, volts)]),
        (0.0, 0.0), {"v": volts}, (rng.uniform(5e-4, 1.5e-3),), (2 * np.pi / 8192,), 0.005, 3001,
    )  # fmt: skip


def spindle(rng: np.random.Generator) -> Rig:
    b, dry, gain = rng.uniform(0.3, 2.0), rng.uniform(5.0, 40.0), rng.uniform(20.0, 80.0)
    drag, width = rng.uniform(0.002, 0.02), 2e-3

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([gain * u[0] - b * s[0] - dry * tanh(s[0] / width) - drag * s[0] * abs(s[0])])

    law = (
        ("w_dot", "1", 1.0), (None, "w", b), (None, "sign(w)", dry), (None, "w*abs(w)", drag), (None, "v", -gain),
    )  # fmt: skip
    volts = 3.0 * dry / gain
    return Rig(
        {"w": Measured()}, {"w_dot": law}, rate, lambda rng, t: played([band(rng, t, 1.0, volts)]),
        (0.0,), {"v": volts}, (rng.uniform(0.02, 0.1),), (0.05,), 0.01, 3001,
    )  # fmt: skip


RIGS: dict[str, Callable[[np.random.Generator], Rig]] = {
    "stage": stage,
    "cart": cart,
    "arm": arm,
    "tanks": tanks,
    "motor": motor,
    "spindle": spindle,
}
LEVELS = {1: 1.0, 2: 5.0, 3: 20.0}  # times the noise of level 1
