"""Small systems for the tests of the likelihood: mechanisms, and the same equations written out for SciPy."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from odescope.library.mechanism import Mechanism, Part, candidate
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.program import Frame, Program
from odescope.likelihood.search import search
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments
from odescope.recordings.coordinate import Coordinate, following_states, state_names


@dataclass(frozen=True)
class System:
    """Terms as (relation, factor, text, coefficient); `targets(theta, x, u)` solves the same equations by hand."""

    coordinates: tuple[Coordinate, ...]
    inputs: tuple[str, ...]
    terms: tuple[tuple[int, int, str, float], ...]
    fixed: tuple[int, ...]
    targets: Callable

    @property
    def variables(self):
        return (*state_names(self.coordinates), *self.inputs)

    @property
    def following(self):
        return following_states(self.coordinates)

    @property
    def measured(self):
        return np.array([self.variables.index(c.name) for c in self.coordinates], dtype=np.int64)

    @property
    def theta(self):
        return np.array([c for *_, c in self.terms])

    @property
    def free(self):
        return np.array([k for k in range(len(self.terms)) if k not in self.fixed], dtype=np.int64)

    @property
    def frame(self):
        return Frame.of(self.coordinates, self.inputs)

    @property
    def held(self):
        return np.array(self.fixed, dtype=np.int64)

    @property
    def mechanisms(self):
        target = [c.target for c in self.coordinates]
        return tuple(candidate(r, self.product(f, t), target[r]) for r, f, t, _ in self.terms)

    def product(self, factor, text):
        target = None if factor < 0 else self.coordinates[factor].target
        return Product(target, parse_term(text, Scope.of(list(self.variables))))

    @property
    def program(self):
        return Program.of(self.mechanisms, self.frame)

    def slope(self, theta, x, u):
        found = self.targets(theta, x, u)
        return np.array([x[f] if f >= 0 else found[-1 - f] for f in self.following])

    def trajectory(self, theta, x0, nodes, step):
        """Return the states (len(nodes) + 1, n), the input a parabola through the three nodes of each step."""
        rows = [np.array(x0, dtype=float)]
        for first, middle, last in nodes:

            def slope(t, x, first=first, middle=middle, last=last):
                s = t / step
                u = first * (1 - s) * (1 - 2 * s) + middle * 4 * s * (1 - s) + last * s * (2 * s - 1)
                return self.slope(theta, x, u)

            run = solve_ivp(slope, (0.0, step), rows[-1], "DOP853", rtol=1e-12, atol=1e-13)
            rows.append(run.y[:, -1])
        return np.array(rows)


@dataclass(frozen=True)
class Tied:
    """A system whose terms hang together: groups of their numbers, one coefficient each; a term may be in several."""

    system: System
    groups: tuple[tuple[int, ...], ...]
    theta: np.ndarray

    @property
    def shares(self):
        """What each coefficient adds to each term, (terms, mechanisms): together the system's own coefficients."""
        member = np.array([[k in group for group in self.groups] for k in range(len(self.system.terms))], dtype=float)
        return self.system.theta[:, None] * member / member.sum(axis=1, keepdims=True) / self.theta

    @property
    def mechanisms(self):
        single = [m.parts[0] for m in self.system.mechanisms]
        return tuple(
            Mechanism(
                "tie", f"m{k}", "all", tuple(Part(single[j].relation, single[j].product, s[j]) for j in group), 1.0
            )
            for k, (group, s) in enumerate(zip(self.groups, self.shares.T, strict=True))
        )

    @property
    def program(self):
        return Program.of(self.mechanisms, self.system.frame)


def _uptake(th, x, u):
    return [-(th[2] * x[0] + th[3] + th[4] * u[0]) / (th[0] + th[1] * x[0])]


def _cart(th, x, u):
    _, phi, v, w = x
    a = np.array([[th[0], th[1] * np.cos(phi)], [th[5] * np.cos(phi), th[6]]])
    b = [th[2] * w**2 * np.sin(phi) + th[3] * v + th[4] * u[0], th[7] * np.sin(phi) + th[8] * w]
    return -np.linalg.solve(a, b)


def _ring(th, x, u):
    p, q, r = x
    a = np.array([[0.0, th[0], th[1] * p], [th[4], th[5] * np.cos(r), th[3]], [th[12], th[8], th[9] * p * q]])
    b = [th[2] * p * r + th[10] * u[0], th[6] * q + th[11] * u[1], th[7] * np.sin(r)]
    return -np.linalg.solve(a, b)


def _row(th, x, u):
    p, q, r = x
    a = [th[0] + th[1] * p**2, th[5], th[8] + th[9] * np.cos(q)]
    b = [th[2] * p + th[3] * q + th[4] * u[0], th[6] * q + th[7] * p * r, th[10] * r + th[11] * u[1]]
    return -np.array(b) / a


# x_dot (1 + 3.3 x) = 0.6 - 2 x + 0.5 u: order 1, rational.
UPTAKE = System(
    (Coordinate("x", 1),),
    ("u",),
    ((0, 0, "1", 1.0), (0, 0, "x", 3.3), (0, -1, "x", 2.0), (0, -1, "1", -0.6), (0, -1, "u", -0.5)),
    (0,),
    _uptake,
)
# Lagrange's equations of a pendulum on a cart as they stand: A is not diagonal.
CART = System(
    (Coordinate("x", 2, cyclic=True), Coordinate("phi", 2, angle=True)),
    ("u",),
    (
        (0, 0, "1", 1.0),
        (0, 1, "cos(phi)", 0.4),
        (0, -1, "phi_dot**2*sin(phi)", -0.4),
        (0, -1, "x_dot", 1.5),
        (0, -1, "u", -0.8),
        (1, 0, "cos(phi)", 0.9),
        (1, 1, "1", 1.0),
        (1, -1, "sin(phi)", 8.8),
        (1, -1, "phi_dot", 0.2),
    ),
    (0, 6),
    _cart,
)
# Three targets tied in a ring; the first relation lacks its own, so A needs rows exchanged.
RING = System(
    (Coordinate("p", 1), Coordinate("q", 1), Coordinate("r", 1)),
    ("u", "v"),
    (
        (0, 1, "1", 1.0),
        (0, 2, "p", 0.3),
        (0, -1, "p*r", 0.7),
        (1, 2, "1", 1.0),
        (1, 0, "1", -0.4),
        (1, 1, "cos(r)", 0.5),
        (1, -1, "q", 1.1),
        (2, -1, "sin(r)", -0.9),
        (2, 1, "1", 0.2),
        (2, 2, "p*q", 0.35),
        (0, -1, "u", 0.6),
        (1, -1, "v", -0.8),
        (2, 0, "1", 1.0),
    ),
    (0, 3, 12),
    _ring,
)
# Three targets, no relation with that of another: A is diagonal, and depends on the states.
ROW = System(
    RING.coordinates,
    ("u", "v"),
    (
        (0, 0, "1", 1.0),
        (0, 0, "p**2", 0.4),
        (0, -1, "p", 0.8),
        (0, -1, "q", -0.5),
        (0, -1, "u", -0.6),
        (1, 1, "1", 2.0),
        (1, -1, "q", 0.7),
        (1, -1, "p*r", -0.9),
        (2, 2, "1", 1.0),
        (2, 2, "cos(q)", 0.3),
        (2, -1, "r", 0.5),
        (2, -1, "v", -0.4),
    ),
    (0, 5, 8),
    _row,
)

# The pendulum's cart with one coefficient for what couples both relations, and friction of both.
TIED_CART = Tied(CART, ((0,), (1, 2, 5), (3, 8), (4,), (6,), (7,)), np.array([1.0, 0.4, -0.7, 2.0, 1.0, 8.8]))
# Coefficients over all three relations; some terms are sums of several.
TIED_RING = Tied(
    RING, ((0, 4, 11), (1, 5, 9, 2), (2, 6, 7, 12), (3, 8), (10, 0), (12,)), np.array([0.5, -1.3, 0.9, 2.0, 0.6, 1.0])
)

# x_ddot = -4 x - 0.5 x_dot - 0.8 x^3 + u, and terms that it lacks.
SPRING = System(
    (Coordinate("x", 2),),
    ("u",),
    (
        (0, 0, "1", 1.0),
        (0, -1, "x", 4.0),
        (0, -1, "x_dot", 0.5),
        (0, -1, "x**3", 0.8),
        (0, -1, "u", -1.0),
        (0, -1, "x**2", 0.0),
        (0, -1, "x_dot**2", 0.0),
        (0, -1, "1", 0.0),
        (0, 0, "x**2", 0.0),
        (0, -1, "x*u", 0.0),
    ),
    (0,),
    lambda th, x, u: [
        -(
            th[1] * x[0] + th[2] * x[1] + th[3] * x[0] ** 3 + th[4] * u[0] + th[5] * x[0] ** 2
            + th[6] * x[1] ** 2 + th[7] + th[9] * x[0] * u[0]
        ) / (th[0] + th[8] * x[0] ** 2)
    ],
)  # fmt: skip
SPRING_PRESENT = np.array([0, 1, 2, 3, 4])
SPRING_TERMS = SPRING_PRESENT[1:]
SPRING_STEP, SPRING_COUNT = 0.05, 600


def drive(count=SPRING_COUNT, step=SPRING_STEP, inputs=1):
    """Three sines and their values on the nodes of each step, (count, 3, inputs)."""
    t = step * (np.arange(count)[:, None] + np.array([0.0, 0.5, 1.0]))
    one = 3 * np.sin(1.9 * t) + 2 * np.cos(0.7 * t + 1) + 1.5 * np.sin(3.1 * t)
    return np.stack([one * (-0.7) ** k for k in range(inputs)], axis=-1)


def spring_run(theta=SPRING.theta):
    """Return states (N, 2) of the spring, without noise."""
    return SPRING.trajectory(theta, [0.5, 0.0], drive()[:-1], SPRING_STEP)


def shots(states, nodes, step, noise, rng, spread, length=25):
    """Return segments of one record of positions, the first column of the states, with white noise."""
    count = len(states)
    edges = np.linspace(0, count, count // length + 1).astype(np.int64)
    joined = np.arange(len(edges) - 1) < len(edges) - 2
    measured = states[:, :1] + noise * rng.standard_normal((count, 1))
    return Segments(
        measured, nodes, states, edges[:-1], np.diff(edges), joined, np.array([noise]), spread, step, 1, ((0, count),)
    )  # fmt: skip


def spring_search():
    """Return the space of a record of the spring, and the end of a search in it that begins at the truth."""
    spread = np.array([1e-3, 5e-3])
    data = shots(spring_run(), drive(), SPRING_STEP, 2e-3, np.random.default_rng(1), spread)
    space = SearchSpace(Evaluator(data, 2), SPRING.mechanisms, SPRING.frame)
    return space, search(space, SPRING.theta)


@dataclass(frozen=True)
class Bare:
    """What a fit says where every bare target is 1: theta and errors (mechanisms,), covariance, zero where absent."""

    theta: np.ndarray
    covariance: np.ndarray

    @property
    def errors(self):
        return np.sqrt(np.diag(self.covariance))


def in_bare_gauge(space, found, covariance=None):
    """Return a fit, whatever it holds, where every bare target is 1: all candidates are plain, and those present.

    Errors are to first order, by hand: of theta_k / theta_bare.
    """
    own = [m.parts[0].relation for m in space.mechanisms]
    bare = {r: k for k, r in enumerate(own) if space.frame.own(space.mechanisms[k])}
    count = len(own)
    whole, slopes = np.zeros((count, count)), np.zeros((count, count))
    whole[np.ix_(found.free, found.free)] = found.covariance if covariance is None else covariance
    theta = np.array([found.theta[k] / found.theta[bare[r]] for k, r in enumerate(own)])
    for k, r in enumerate(own):
        slopes[k, k] += 1.0 / found.theta[bare[r]]
        slopes[k, bare[r]] -= theta[k] / found.theta[bare[r]]
    return Bare(theta, slopes @ whole @ slopes.T)
