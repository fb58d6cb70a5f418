"""Elimination in the linear relations: the law where noise explains it, nothing where it does not."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from mechanics import scope_of
from scipy.integrate import solve_ivp
from test_mechanisms import TRUTH, cart, coefficients, named, signals_of

from odescope.library.lagrangian import lagrangian
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record
from odescope.regression.linear_elimination import explained
from odescope.regression.mechanisms import MechanismProblem

SEEDS = range(4)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("level", [2, 3])
def test_the_law_of_the_cart_is_among_few_that_are_left(level, seed):
    problem, noisy = cart(level, seed)
    found = named(problem, explained(problem, noisy))
    law = {k: v for k, v in TRUTH.items() if k != "phi_dot**2 in dissipation"}  # friction that noise hides
    assert law.keys() <= found.keys()
    assert len(found) <= len(TRUTH) + 2
    scale = found["u in force on x"]
    for name, value in law.items():
        assert found[name] / scale == pytest.approx(value, rel=0.2)


def test_what_is_known_stays_and_gives_the_scale():
    problem, noisy = cart(3)
    free = explained(problem, noisy)
    k = next(k for k, m in enumerate(problem.mechanisms) if str(m) == "u in force on x")
    held = tuple(replace(m, known=2.0) if j == k else m for j, m in enumerate(problem.mechanisms))
    found = explained(replace(problem, mechanisms=held), noisy)
    assert found[k] == 2.0
    np.testing.assert_allclose(found, free * 2.0 / free[k], rtol=1e-9)


def test_without_the_force_that_drives_it_there_is_no_law():
    problem, noisy = cart(3)
    left = tuple(m for m in problem.mechanisms if m.kind != "force")
    without = MechanismProblem.of(problem.signals, left)
    found = explained(without, noisy)
    assert found is None or np.any(coefficients(without, TRUTH)[found == 0.0])


def problem_of(coordinates, rate, begin, noise, seed, driven=MappingProxyType({})):
    """Return problem and noisy signals of 2000 samples in 20 s, with a share of noise.

    Args:
        coordinates: of order 2.
        rate: of the state, which begins with the coordinates.
        begin: the state.
        noise: of the standard deviation of each coordinate.
        seed: of the noise.
        driven: inputs as functions of the time, by name.
    """
    rng, t = np.random.default_rng(seed), 0.01 * np.arange(2000)
    states = solve_ivp(rate, (0, t[-1]), begin, t_eval=t, rtol=1e-9, atol=1e-10).y[: len(coordinates)].T
    columns, inputs = np.column_stack([states, *(u(t) for u in driven.values())]), tuple(map(Input, driven))
    run = Record(t, columns, (*(c.name for c in coordinates), *driven))
    level = np.append(noise * states.std(axis=0), np.zeros(len(driven)))
    signals, noisy = signals_of(coordinates, inputs, [run], level, rng)
    return MechanismProblem.of(signals, lagrangian(coordinates, inputs, scope_of(coordinates, inputs))), noisy


def parts_of(found, law):
    """Return the coefficients of a law among those found, in units of its first."""
    name, unit = next(iter(law.items()))
    scale = found[name] / unit
    return [found[k] / scale for k in law]


BOB = {
    "r_dot**2 in kinetic": 0.5,
    "q_dot**2*r**2 in kinetic": 0.5,
    "r in potential": -40.0,
    "r**2 in potential": 20.0,
    "r*cos(q) in potential": -9.81,
}


def bob_rate(_, x):
    r, q, v, w = x
    return v, w, r * w**2 + 9.81 * np.cos(q) - 40.0 * (r - 1.0), -(2.0 * v * w + 9.81 * np.sin(q)) / r


@pytest.mark.parametrize("seed", SEEDS)
def test_candidates_that_nearly_add_up_to_nothing_are_no_law(seed):
    # r stays between .8 and 1.6: its powers up to 4 nearly cancel.
    coordinates = Coordinate("r", 2), Coordinate("q", 2, angle=True)
    problem, noisy = problem_of(coordinates, bob_rate, [1.3, 0.8, 0.0, 0.0], 0.002, seed)
    found = named(problem, explained(problem, noisy))
    assert len(found) <= len(BOB) + 2
    assert parts_of(found, BOB) == pytest.approx(list(BOB.values()), rel=0.05)


SPRINGS = {
    "x**2 in potential": 20.0,
    "(x - y)**2 in potential": 15.0,
    "(y - z)**2 in potential": 25.0,
    "(x - y)**4 in potential": 200.0,
}


def masses_rate(_, s):
    x, y, z, *rates = s
    first, second = 30.0 * (x - y) + 800.0 * (x - y) ** 3, 50.0 * (y - z)
    return *rates, -40.0 * x - first, (first - second) / 0.7, second / 1.3


@pytest.mark.parametrize("seed", SEEDS)
def test_masses_that_move_alike_have_no_inertia_that_changes(seed):
    coordinates = Coordinate("x", 2), Coordinate("y", 2), Coordinate("z", 2)
    problem, noisy = problem_of(coordinates, masses_rate, [0.1, 0.15, 0.3, 0.0, 0.5, 0.0], 0.002, seed)
    found = named(problem, explained(problem, noisy))
    assert parts_of(found, SPRINGS) == pytest.approx(list(SPRINGS.values()), rel=0.05)
    assert len(found) <= 2 * (len(SPRINGS) + 3)  # a constant mass each


TABLE = {
    "x_dot**2 in kinetic": 0.5,
    "x**2 in potential": 20.0,
    "x_dot**2 in dissipation": 0.75,
    "u in force on x": 1.0,
}
PENDULUM = {
    "q_dot**2 in kinetic": 0.5,
    "cos(q) in potential": -9.0,
    "q_dot**2 in dissipation": 0.2,
    "w in force on q": 1.0,
}


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_coupled_to_nothing_has_a_law_of_its_own(seed):
    def rate(t, s):
        x, q, v, w = s
        return v, w, -40.0 * x - 1.5 * v + acting[0](t), -9.0 * np.sin(q) - 0.4 * w + acting[1](t)

    acting = [
        lambda t: 8.0 * np.sin(2.3 * t) + 6.0 * np.sin(7.1 * t),
        lambda t: 3.0 * np.cos(1.7 * t) * np.sin(0.4 * t),
    ]
    coordinates = Coordinate("x", 2), Coordinate("q", 2, angle=True)
    problem, noisy = problem_of(coordinates, rate, [0.2, 0.8, 0.0, 0.0], 0.001, seed, {"u": acting[0], "w": acting[1]})
    found = named(problem, explained(problem, noisy))
    assert TABLE.keys() | PENDULUM.keys() <= found.keys()
    assert len(found) <= 2 * (len(TABLE) + len(PENDULUM))
    for law in (TABLE, PENDULUM):
        assert parts_of(found, law) == pytest.approx(list(law.values()), rel=0.05)
