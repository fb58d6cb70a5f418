"""What hangs from a support that moves: its acceleration, an input, acts along every angle."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.pipeline.identification import identify
from odescope.pipeline.supports import _forces
from odescope.study.options import Data, Driven, Measured, Study

ANGLE, T = Measured(order=2, angle=True), 0.02 * np.arange(2500)


def shaken(seed, low, high, size):
    """Return a sum of waves, as a function of time."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(low, high, 12), rng.uniform(0.0, 2.0 * np.pi, 12)
    return lambda t: size / 2.4 * np.sin(2.0 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=-1)


def read(rate, start, names, seed):
    """Return a log of positions, with noise of .5 % of their standard deviations."""
    x = solve_ivp(rate, (0.0, T[-1]), start, t_eval=T, rtol=1e-9, atol=1e-10).y[: len(names)]
    noise = 0.005 * x.std(axis=1, keepdims=True) * np.random.default_rng(seed + 100).standard_normal(x.shape)
    return {"t": T, **dict(zip(names, x + noise, strict=True))}


def gantry(seed):
    """A hook of 1 kg on 1.2 m of rope, a load of 3 kg on .8 m below it; the trolley's acceleration is recorded."""
    a = shaken(seed, 0.1, 1.1, 0.9)

    def rate(t, z):
        p, q, v, w = z
        whole, between, load = 5.76, 2.88 * np.cos(p - q), 1.92
        twist = 2.88 * np.sin(p - q)
        first = -4.8 * (a(t) * np.cos(p) + 9.81 * np.sin(p)) - 0.3 * v - twist * w**2
        second = -2.4 * (a(t) * np.cos(q) + 9.81 * np.sin(q)) - 0.1 * w + twist * v**2
        return [v, w, *np.linalg.solve([[whole, between], [between, load]], [first, second])]

    log = read(rate, [0.3, 0.1, 0.0, 0.0], ("p", "q"), seed)
    return Study(data=Data(time="t"), coordinates={"p": ANGLE, "q": ANGLE}, inputs={"a": Driven()}), log | {"a": a(T)}


def hoisting_crane(seed):
    """A load on a rope under a trolley, both driven: the pull of the winch and the acceleration are recorded."""
    a, pull = shaken(seed, 0.1, 0.6, 1.0), shaken(seed + 50, 0.05, 0.3, 3.0)

    def force(t):
        return 19.6 + pull(t)

    def rate(t, z):
        x, q, v, w = z
        out = x * w**2 + 9.81 * np.cos(q) - a(t) * np.sin(q) - 0.5 * force(t) - 1.5 * v - 2.0 * (x - 3.0)
        return [v, w, out, (-2.0 * v * w - 9.81 * np.sin(q) - a(t) * np.cos(q)) / x - 0.05 * w]

    log = read(rate, [2.5, 0.2, 0.0, 0.0], ("x", "q"), seed)
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2), "q": ANGLE},
        inputs={"a": Driven(), "f": Driven()},
    )
    return study, log | {"a": a(T), "f": force(T)}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_load_below_a_hook_is_driven_by_the_acceleration_of_the_trolley(seed):
    found = identify(*gantry(seed)).model.mechanisms
    terms = {(m.kind, m.term) for m in found}
    assert {t for kind, t in terms if kind == "force"} == {"a*cos(p)", "a*cos(q)"}
    assert {t for kind, t in terms if kind == "kinetic"} == {"p_dot**2", "q_dot**2", "p_dot*q_dot*cos(p - q)"}
    assert {t for kind, t in terms if kind == "potential"} == {"cos(p)", "cos(q)"}
    assert {t for kind, t in terms if kind == "dissipation"} == {"p_dot**2", "q_dot**2"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_load_on_a_rope_that_is_wound_is_driven_along_and_across_it(seed):
    found = identify(*hoisting_crane(seed)).model.mechanisms
    terms = {(m.kind, m.term) for m in found}
    assert {t for kind, t in terms if kind == "force"} == {"f", "a*sin(q)", "a*x*cos(q)"}
    assert {t for kind, t in terms if kind == "kinetic"} == {"x_dot**2", "q_dot**2*x**2"}
    assert {t for kind, t in terms if kind == "potential"} == {"x", "x**2", "x*cos(q)"}
    assert {t for kind, t in terms if kind == "dissipation"} == {"x_dot**2", "q_dot**2*x**2"}


def test_an_input_pushes_along_the_angles_of_what_hangs_and_along_their_sums():
    free = Measured(order=2, angle=True, cyclic=True)
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2), "p": ANGLE, "q": ANGLE, "r": free},
        inputs={"a": Driven(), "t": Driven()},
    )
    found = _forces(study)
    assert set(found["x"]) == {"a*cos(p)", "a*sin(p)", "a*cos(q)", "a*sin(q)"}
    assert {"a*cos(p)", "a*x*sin(p)", "a*cos(p + q)", "a*sin(p - q)"} <= set(found["p"])
    assert not any("q" in f for f in found["p"] if "p" not in f)
    assert found["r"] == ()
