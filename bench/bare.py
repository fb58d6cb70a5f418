"""Machines of bench/machines.py whose relation has no bare target: six laws, with one percent of noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from excitation import band
from machines import Machine, Rate, Recordings, follow, parts
from truths import relations

from odescope import Driven, Measured

Law = Sequence[tuple[str | None, str, float]]
TIMES = np.arange(3001) * 0.01


def bare(
    coordinates: dict[str, Measured],
    laws: dict[str, Law],
    rate: Rate,
    start: tuple[float, ...],
    drive: Callable[[np.random.Generator], dict[str, np.ndarray]],
    **library: object,
) -> Machine:
    """Return the machine of these laws, thirty seconds at 100 Hz."""
    inputs = {name: Driven() for name in drive(np.random.default_rng(0))}
    truth = relations(*parts(coordinates, inputs), laws)

    def runs(seed: int) -> Recordings:
        rng = np.random.default_rng(seed)
        return [follow(truth, rate, TIMES, np.array(start), rng, **drive(rng))]

    noise = {1: (0.01,) * len(coordinates)}
    return Machine(coordinates, truth, rate, runs, noise, inputs, {"form": "relations", **library}, relative=True)


def swinging(mean: float, size: float, hertz: float) -> Callable[[np.random.Generator], dict[str, np.ndarray]]:
    """Return an input about a mean that stays within a tenth and 1.9 of it."""

    def drive(rng: np.random.Generator) -> dict[str, np.ndarray]:
        u = band(rng, TIMES, hertz, size)
        return {"u": mean + 0.9 * mean * np.tanh(u / mean) if mean else u}

    return drive


def flywheel() -> Machine:
    """Return x x' = a u - b: a flywheel of speed x charged with power u, less a constant loss."""
    a, b = 0.8, 0.5

    def drive(rng: np.random.Generator) -> dict[str, np.ndarray]:
        # The square of the speed is to begin at 4 and to stay above 0.8.
        square = 3.2 * np.tanh(0.9 * band(rng, TIMES, 0.4, 1.0) * np.tanh(TIMES))
        return {"u": (0.5 * np.gradient(square, TIMES) + b) / a}

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([(a * u[0] - b) / s[0]])

    law = (("x_dot", "x", 1.0), (None, "u", -a), (None, "1", b))
    return bare({"x": Measured()}, {"x_dot": law}, rate, (2.0,), drive)


def vehicle() -> Machine:
    """Return x x' = a u - b x - c x^3: a vehicle of speed x under traction power u, rolling resistance and drag."""
    a, b, c = 2.0, 0.6, 0.25

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([a * u[0] / s[0] - b - c * s[0] ** 2])

    law = (("x_dot", "x", 1.0), (None, "u", -a), (None, "x", b), (None, "x**3", c))
    return bare({"x": Measured()}, {"x_dot": law}, rate, (1.5,), swinging(2.0, 1.6, 0.5))


def cone() -> Machine:
    """Return x^2 x' = a u - b x: the level in a conical tank with an inflow u and a laminar outlet."""
    a, b = 1.0, 0.8

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([(a * u[0] - b * s[0]) / s[0] ** 2])

    law = (("x_dot", "x**2", 1.0), (None, "u", -a), (None, "x", b))
    return bare({"x": Measured()}, {"x_dot": law}, rate, (1.2,), swinging(1.0, 0.8, 0.5))


def bubble() -> Machine:
    """Return x x'' + 3/2 x'^2 = a/x^3 - b - u - c x'/x: a gas bubble of radius x in a sound of pressure u."""
    a, b, c = 3.0, 3.0, 0.8

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        x, v = s
        return np.array([v, (a / x**3 - b - u[0] - c * v / x - 1.5 * v * v) / x])

    law = (
        ("x_ddot", "x", 1.0),
        (None, "x_dot**2", 1.5),
        (None, "1/x**3", -a),
        (None, "1", b),
        (None, "u", 1.0),
        (None, "x_dot/x", c),
    )
    basis = ("x", "1/x", "x_dot", "u")
    coordinates = {"x": Measured(order=2)}
    return bare(coordinates, {"x_ddot": law}, rate, (1.0, 0.0), swinging(0.0, 0.8, 1.0), basis=basis)


def yoke() -> Machine:
    """Return sin(q) q'' + cos(q) q'^2 + b sin(q) q' = k cos(q) - a u: a crank turned by a sprung slider at cos(q)."""
    a, b, k = 1.0, 0.8, 9.0

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        q, w = s
        sine, cosine = np.sin(q), np.cos(q)
        return np.array([w, (k * cosine - a * u[0] - cosine * w * w) / sine - b * w])

    law = (
        ("q_ddot", "sin(q)", 1.0),
        (None, "q_dot**2*cos(q)", 1.0),
        (None, "q_dot*sin(q)", b),
        (None, "cos(q)", -k),
        (None, "u", a),
    )
    coordinates = {"q": Measured(order=2, angle=True)}
    return bare(coordinates, {"q_ddot": law}, rate, (1.57, 0.0), swinging(0.0, 1.5, 1.0))


def capacitor() -> Machine:
    """Return (x + c y^2) x' = a u - b x, y' = d w - e y: a voltage on a capacity that it and a temperature raise."""
    a, b, c, d, e = 2.0, 1.5, 0.8, 1.0, 0.7

    def rate(s: np.ndarray, u: np.ndarray) -> np.ndarray:
        x, y = s
        return np.array([(a * u[0] - b * x) / (x + c * y * y), d * u[1] - e * y])

    def drive(rng: np.random.Generator) -> dict[str, np.ndarray]:
        return {**swinging(1.2, 0.9, 0.6)(rng), "w": band(rng, TIMES, 0.5, 1.5)}

    laws = {
        "x_dot": (("x_dot", "x", 1.0), ("x_dot", "y**2", c), (None, "u", -a), (None, "x", b)),
        "y_dot": (("y_dot", "1", 1.0), (None, "w", -d), (None, "y", e)),
    }
    return bare({"x": Measured(), "y": Measured()}, laws, rate, (1.5, 0.5), drive)


BARE = {
    "bare-flywheel": flywheel,
    "bare-vehicle": vehicle,
    "bare-cone": cone,
    "bare-bubble": bubble,
    "bare-yoke": yoke,
    "bare-capacitor": capacitor,
}
