"""Elimination in the linear relations: the law where noise explains it, nothing where it does not."""

from dataclasses import replace

import numpy as np
import pytest
from mechanics import scope_of
from scipy.integrate import solve_ivp
from test_mechanisms import TRUTH, cart, coefficients, named, signals_of

from odescope.library.lagrangian import lagrangian
from odescope.recordings.coordinate import Coordinate
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


BOB = (Coordinate("r", 2), Coordinate("q", 2, angle=True))
BOB_TRUTH = {
    "r_dot**2 in kinetic": 0.5,
    "q_dot**2*r**2 in kinetic": 0.5,
    "r in potential": -40.0,
    "r**2 in potential": 20.0,
    "r*cos(q) in potential": -9.81,
}


def bob(seed):
    """A bob on a spring, without friction, and its candidates; r stays between .8 and 1.6."""
    rng, t = np.random.default_rng(seed), 0.01 * np.arange(2000)

    def rate(_, x):
        r, q, v, w = x
        return v, w, r * w**2 + 9.81 * np.cos(q) - 40.0 * (r - 1.0), -(2.0 * v * w + 9.81 * np.sin(q)) / r

    begin = [*(np.array([1.3, 0.8]) + 0.1 * rng.uniform(-1, 1, 2)), 0.0, 0.0]
    states = solve_ivp(rate, (0, t[-1]), begin, t_eval=t, rtol=1e-9, atol=1e-10).y[:2].T
    signals, noisy = signals_of(BOB, (), [Record(t, states, ("r", "q"))], 0.002 * states.std(axis=0), rng)
    return MechanismProblem.of(signals, lagrangian(BOB, (), scope_of(BOB, ()))), noisy


@pytest.mark.parametrize("seed", SEEDS)
def test_candidates_that_nearly_add_up_to_nothing_are_no_law(seed):
    problem, noisy = bob(seed)
    found = named(problem, explained(problem, noisy))
    assert len(found) <= len(BOB_TRUTH) + 2
    scale = found["r_dot**2 in kinetic"] / 0.5
    for name, value in BOB_TRUTH.items():
        assert found[name] / scale == pytest.approx(value, rel=0.05)
