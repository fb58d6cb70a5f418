"""Steps within the layer of dry friction: as exact as tightly solved trajectories, and few where nothing sticks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.library.constants import Constant
from odescope.library.mechanism import candidate
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.likelihood.budget import Budget
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.kernel import LANES
from odescope.likelihood.layers import STABLE
from odescope.likelihood.program import Frame, Program
from odescope.likelihood.segments import Segments
from odescope.recordings.coordinate import Coordinate, state_names

STEP, WIDTH = 0.01, 5e-4
ONE, TWO = (Coordinate("q", 2),), (Coordinate("a", 2), Coordinate("b", 2))


def turning(c, x, u):
    return [-(c[1] * x[0] + c[2] * np.tanh(x[1] / WIDTH) + c[3] * u) / c[0]]


def dragged(c, x, u):
    return [-(c[1] * x[0] + c[2] * np.tanh((x[1] - u) / WIDTH)) / c[0]]


def coupled(c, x, u):
    forces = [c[2] * x[0] + c[3] * np.tanh(x[2] / WIDTH), c[6] * x[1] + c[7] * u]
    return np.linalg.solve([[c[0], c[1]], [c[5], c[4]]], -np.array(forces))


# Coordinates; relation, factor, term, coefficient; the same by hand; what slides; initial states. Of the coupled
# masses friction decays ten times as fast as its own relation says.
SYSTEMS = {
    "a joint that turns": (
        ONE,
        ((0, "q_ddot", "1", 1.0), (0, None, "q", 40.0), (0, None, "tanh(q_dot/w)", 6.0), (0, None, "u", -1.0)),
        turning,
        lambda x, u: x[1],
        [[0.1, 1.0], [0.3, -0.2], [-0.2, 0.4], [0.02, 0.0]],
    ),
    "a block on a belt": (
        ONE,
        ((0, "q_ddot", "1", 1.0), (0, None, "q", 40.0), (0, None, "tanh((q_dot - u)/w)", 6.0)),
        dragged,
        lambda x, u: x[1] - u,
        [[0.1, 1.0], [0.3, -0.2], [-0.2, 0.4], [0.02, 0.0]],
    ),
    "two masses that are coupled": (
        TWO,
        (
            (0, "a_ddot", "1", 1.0), (0, "b_ddot", "1", 0.9), (0, None, "a", 40.0), (0, None, "tanh(a_dot/w)", 1.0),
            (1, "b_ddot", "1", 0.9), (1, "a_ddot", "1", 0.9), (1, None, "b", 30.0), (1, None, "u", -1.0),
        ),
        coupled,
        lambda x, u: x[2],
        [[0.0, 0.1, 0.2, -0.3], [0.05, 0.1, 0.0, 0.1]],
    ),
}  # fmt: skip


def system(name):
    """Return the program of a system, coefficients and initial states."""
    coordinates, rows, _, _, starts = SYSTEMS[name]
    targets = [c.target for c in coordinates]
    scope = Scope.of([*state_names(coordinates), "u", "w"])
    mechanisms = [candidate(r, Product(f, parse_term(t, scope)), targets[r]) for r, f, t, _ in rows]
    frame = Frame.of(coordinates, ["u"], {"w": Constant("w", WIDTH, 300 * WIDTH, WIDTH, optional=True)})
    return Program.of(tuple(mechanisms), frame), np.array([c for *_, c in rows]), np.array(starts)


def data(name, starts, averages):
    """Return segments of that many averages each, one a start, under inputs that are linear over each average."""
    t = STEP * np.arange(averages * len(starts) + 1)
    u = 0.8 * np.sin(20.0 * t) if "belt" in name else 3.0 * np.sin(12.0 * t) + 5.0 * np.sin(31.0 * t + 1.0)
    nodes = np.stack([u[:-1], 0.5 * (u[:-1] + u[1:]), u[1:]], axis=1)[:, :, None]
    n, channels = starts.shape[1], starts.shape[1] // 2
    start, count = averages * np.arange(len(starts)), np.full(len(starts), averages)
    measured = np.zeros((averages * len(starts), channels))
    joined = np.zeros(len(starts), dtype=bool)
    noise = np.full(channels, 0.01)
    return Segments(measured, nodes, np.zeros((len(measured), n)), start, count, joined, noise, np.ones(n), STEP, 1, ())


def followed(name, theta, x0, nodes):
    """Return the state after so many averages, and whether what slides turned or stuck on the way."""
    _, _, acceleration, sliding, _ = SYSTEMS[name]
    x, n, signs = np.array(x0, dtype=float), len(x0), set()
    for first, _, last in nodes[:, :, 0]:

        def slope(t, x, first=first, last=last):
            return np.concatenate([x[n // 2 :], acceleration(theta, x, first + (last - first) * t / STEP)])

        run = solve_ivp(slope, (0.0, STEP), x, "LSODA", rtol=1e-11, atol=1e-13)
        x = run.y[:, -1]
        speed = sliding(x, last)
        signs.add(0 if abs(speed) < WIDTH else np.sign(speed))
    return x, len(signs) > 1


@pytest.mark.parametrize("name", SYSTEMS)
def test_ends_and_their_derivatives_are_those_of_tightly_solved_trajectories(name):
    program, theta, starts = system(name)
    averages, turned = 12, []
    segments, free = data(name, starts, averages), np.arange(1, len(theta))
    found = Evaluator(segments, 4).integrate(program, theta, free, starts)
    for j, x0 in enumerate(starts):
        nodes = segments.inputs[segments.start[j] : segments.start[j] + averages]
        end, turns = followed(name, theta, x0, nodes)
        turned.append(turns)
        np.testing.assert_allclose(found.last[j], end, atol=1e-5 * np.abs(end).max())
        here = np.concatenate([x0, theta[1:]])
        for k in range(len(here)):
            moved = [here + sign * 1e-6 * (np.arange(len(here)) == k) for sign in (1.0, -1.0)]
            more, less = (followed(name, [theta[0], *z[len(x0) :]], z[: len(x0)], nodes)[0] for z in moved)
            slope = (more - less) / 2e-6
            np.testing.assert_allclose(found.jacobian[j, :, k], slope, atol=0.04 * np.abs(slope).max())
    assert any(turned)


def spent(segments, program, theta, starts):
    """Return what an evaluation without parameters costs, in units of budget."""
    budget = Budget()
    Evaluator(segments, 1, budget).integrate(program, theta, np.zeros(0, dtype=np.int64), starts)
    return budget.spent


def test_steps_are_short_only_where_the_joint_is_near_standstill():
    program, theta, _ = system("a joint that turns")
    away, through, stuck = (np.array([start]) for start in ([0.0, 3.0], [0.2, 0.1], [0.02, 0.0]))
    still = replace(data("", away, 5), inputs=np.zeros((5, 3, 1)))
    costs = [spent(still, program, theta, start) for start in (away, through, stuck)]
    frictionless = theta * np.array([1.0, 1.0, 0.0, 1.0])
    assert costs[0] == spent(still, program, frictionless, stuck)
    assert costs[0] < costs[1] < 0.5 * costs[2]
    assert costs[2] == pytest.approx(costs[0] * 6.0 / WIDTH * STEP / STABLE, rel=0.1)


def test_a_segment_does_not_depend_on_the_steps_of_its_neighbours():
    program, theta, starts = system("a joint that turns")
    rng = np.random.default_rng(3)
    count = 4 * LANES
    many = starts[rng.integers(0, len(starts), count)] + 0.05 * rng.standard_normal((count, 2))
    segments = data("", many, 6)
    segments = replace(segments, count=rng.integers(2, 7, count))
    free = np.arange(1, len(theta))
    together = Evaluator(segments).integrate(program, theta, free, many)
    inner = np.zeros_like(together.inner)
    for j in range(count):
        own = replace(
            segments, start=segments.start[j : j + 1], count=segments.count[j : j + 1], joined=segments.joined[:1]
        )
        alone = Evaluator(own).integrate(program, theta, free, many[j : j + 1])
        for name in ("cost", "gradient", "hessian", "last", "jacobian"):
            one, all_ = getattr(alone, name), getattr(together, name)
            np.testing.assert_allclose(one[0], all_[j], rtol=1e-9, atol=1e-9)
        inner += alone.inner
    np.testing.assert_allclose(inner, together.inner, rtol=1e-9)
