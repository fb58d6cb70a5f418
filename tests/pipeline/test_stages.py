"""Stages whose friction falls with speed, or whose travel ends at springs: laws that no library names."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from odescope.library.constants import Constant
from odescope.library.mechanism import candidate
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.likelihood.suspicion import suspicions
from odescope.pipeline.identification import identify
from odescope.study.options import Data, Driven, Measured, Study

STUDY = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
T = np.arange(0.0, 12.0, 0.005)
SUBSTEPS = 6  # of Runge and Kutta's a sample: friction is steep near standstill


def recorded(force, amplitude, seed, noise=0.002):
    """Return two logs of x'' = force(x, v, u), u in lines through random knots."""
    rng, logs = np.random.default_rng(seed), []
    for _ in range(2):
        knots = np.arange(0.0, 14.0, 0.25)
        u = PchipInterpolator(knots, rng.uniform(-amplitude, amplitude, len(knots)))(T)
        s, h, x = np.zeros(2), T[1] / SUBSTEPS, np.zeros(len(T))
        for k in range(len(T) - 1):
            ahead = np.interp(np.arange(2 * SUBSTEPS + 1) / (2 * SUBSTEPS), [0.0, 1.0], u[k : k + 2])
            for j in range(SUBSTEPS):
                rate = lambda z, now: np.array([z[1], force(z[0], z[1], now)])  # noqa: E731
                a = rate(s, ahead[2 * j])
                b = rate(s + 0.5 * h * a, ahead[2 * j + 1])
                c = rate(s + 0.5 * h * b, ahead[2 * j + 1])
                d = rate(s + h * c, ahead[2 * j + 2])
                s = s + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
            x[k + 1] = s[0]
        logs.append({"t": T, "x": x + noise * x.std() * rng.standard_normal(len(T)), "u": u})
    return logs


def coefficients(model):
    return {t.text: t for t in model.shown_relations[0].terms}


@pytest.mark.parametrize(("seeds", "least"), [((2,), 1), pytest.param(range(6), 5, marks=pytest.mark.slow)])
def test_friction_that_falls_with_speed_is_stribecks_curve(seeds, least):
    assert sum(map(is_stribecks, seeds)) >= least


def is_stribecks(seed):
    """Say whether a stage with drawn friction is found, and all that is told of it within five standard errors."""
    rng, dry_friction = np.random.default_rng(100 + seed), "tanh(width_x_dot**-1*x_dot)"
    dry, viscous = rng.uniform(0.5, 2.0), rng.uniform(1.0, 3.0)
    more, speed = dry * rng.uniform(0.3, 1.0), rng.uniform(0.08, 0.25)
    logs = recorded(
        lambda x, v, u: u - viscous * v - (dry + more * np.exp(-((v / speed) ** 2))) * np.tanh(v / 0.004),
        (dry + more) * rng.uniform(2.0, 4.0),
        seed,
    )
    model = identify(STUDY, logs).model
    found, curve = coefficients(model), f"exp(-stribeck_x_dot**-2*x_dot**2)*{dry_friction}"
    if set(found) != {"x_ddot", "x_dot", "u", dry_friction, curve}:
        return False
    (told,) = (p for p in model.parameters if p.name == "stribeck_x_dot")
    pairs = [(found[curve].coefficient, found[curve].std_error, more), (told.value, told.std_error, speed)]
    pairs.append((found["x_dot"].coefficient, found["x_dot"].std_error, viscous))
    return all(abs(value - truth) < 5.0 * error for value, error, truth in pairs)


@pytest.mark.slow
def test_springs_at_both_ends_of_a_travel_are_found_where_the_best_cubic_does_not_follow():
    """What stands for functions comes from the record then, not from the cubic."""
    for seed in range(3):
        logs = recorded(lambda x, v, u: u - v - 20.0 * x - 400.0 * (max(x - 0.5, 0.0) - max(-x - 0.5, 0.0)), 30.0, seed)
        model = identify(STUDY, logs).model
        (edge,) = model.parameters
        assert abs(edge.value - 0.5) < 5.0 * edge.std_error
        assert set(coefficients(model)) == {"x_ddot", "x_dot", "x", "u", "(abs(edge_x + x) - abs(edge_x - x))**1"}


def ending(coefficients):
    """Return the end of a likelihood stage from the coefficients of terms, "times x" being that of x*v_dot."""
    scope = Scope.of(["x", "v", "w"])
    products = [
        Product("v_dot", parse_term(text.removeprefix("times "), scope))
        if text.startswith("times ")
        else Product(None, parse_term(text, scope))
        for text in coefficients
    ]
    values = np.array([np.zeros(99), np.linspace(-1.0, 1.0, 99), np.full(99, 0.1)])
    space = SimpleNamespace(
        mechanisms=[candidate(1, p, "v_dot") for p in products],
        frame=SimpleNamespace(
            targets=("x_dot", "v_dot"),
            variables=("x", "v"),
            states=("x", "v"),
            following=np.array([-1, -2]),
            constants={"w": Constant("w", 1e-3, 1.0, 0.1, optional=True)},
        ),
        needed={},
        evaluated=lambda terms, theta: evaluate(write_tape(["x", "v", "w"], terms), values),
    )
    fit = SimpleNamespace(present=np.arange(len(products)), theta=np.array([*coefficients.values()]))
    return SimpleNamespace(space=space, fit=fit, process=None, outcome=SimpleNamespace(scale=1.0))


@pytest.mark.parametrize(("friction", "drag", "suspected"), [(0.5, -0.2, ["v"]), (-0.5, 0.2, ["v"]), (0.5, 0.2, [])])
def test_quadratic_friction_that_drives_is_suspected_of_being_a_fall_of_dry_friction(friction, drag, suspected):
    end = ending({"times 1": 1.0, "tanh(v/w)": friction, "v*abs(v)": drag})
    assert [s.variable for s in suspicions(end, {"x", "v"}, ())] == suspected


def test_what_holds_a_width_of_friction_stands_beside_no_other_function():
    """The width is a constant of the model that no function of another variable could be evaluated with alone."""
    end = ending({"times 1": 1.0, "times x": 0.5, "v": 1.0, "tanh(v/w)": 1.0})
    (found,) = suspicions(end, {"x", "v"}, ())
    assert (found.variable, found.reason, [t.text for t in found.beside]) == ("x", "fractions", ["1", "v"])
