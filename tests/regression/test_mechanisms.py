"""Regression on mechanisms: derivatives, the scale that is no matter, least squares, and what is proposed."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from mechanics import CART, scope_of
from scipy.integrate import solve_ivp

from odescope.commands.demo import NOISE, simulate_log
from odescope.library.lagrangian import lagrangian
from odescope.library.reactions import reactions
from odescope.library.ties import tied
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record, Records
from odescope.regression.mechanisms import MechanismProblem, eliminated, proposed, weights
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import estimate_signals, signals_like

FORCE = (Input("u"),)
CART_TERMS = lagrangian(CART, FORCE, scope_of(CART, FORCE))
# In units of the force. The joint friction is that of the paper.
TRUTH = {
    "x_dot**2 in kinetic": 0.9,
    "phi_dot*x_dot*cos(phi) in kinetic": 0.18,
    "phi_dot**2 in kinetic": 0.02754,
    "cos(phi) in potential": -1.7658,
    "x_dot**2 in dissipation": 5.0,
    "phi_dot**2 in dissipation": 0.005,
    "u in force on x": 1.0,
}


def signals_of(coordinates, inputs, runs, noise, rng):
    """Return the signals of runs with noise, and those of the same with as much noise once more."""
    first, twice = [], []
    for run in runs:
        draws = rng.standard_normal((2, *run.values.shape)) * noise
        first.append(replace(run, values=run.values + draws[0]))
        twice.append(replace(run, values=run.values + draws.sum(axis=0)))
    signals = estimate_signals(Records(tuple(first)), coordinates, inputs, Spectral())
    return signals, signals_like(signals, Records(tuple(twice)).stretches, Spectral())


def cart(level, seed=0, every=1):
    """Return problem and noisy signals of the paper's log at a level of noise."""
    log = simulate_log(seed, level)
    run = Record(log.t[::every], np.column_stack([log.states[:, :2], log.force])[::every], ("x", "phi", "u"))
    noise = np.array([*NOISE[level], 0.0])
    signals, noisy = signals_of(CART, FORCE, [run], noise, np.random.default_rng(seed))
    return MechanismProblem.of(signals, CART_TERMS), noisy


def named(problem, theta):
    return {str(problem.mechanisms[k]): float(theta[k]) for k in np.flatnonzero(theta)}


def coefficients(problem, values):
    return np.array([values.get(str(m), 0.0) for m in problem.mechanisms])


@pytest.fixture(scope="module")
def clear():
    return cart(1, every=5)


# derivatives


def near(problem, rng):
    """Return coefficients near the truth, and some that are wrong among them."""
    theta = coefficients(problem, TRUTH)
    return theta * (1.0 + 0.05 * rng.standard_normal(len(theta))) + 1e-3 * rng.standard_normal(len(theta))


def test_half_the_gradient_is_that_of_finite_differences(clear):
    problem, _ = clear
    theta, free = near(problem, np.random.default_rng(0)), np.arange(len(problem.mechanisms))
    here = problem.linearised(theta, free)
    for k in free:
        step = np.zeros(len(theta))
        step[k] = 1e-6 * max(abs(theta[k]), 1e-2)
        above, below = (problem.linearised(theta + s, free).cost for s in (step, -step))
        expected = (above - below) / (4.0 * step[k])
        size = np.sqrt(here.information[k, k] * here.cost)
        assert here.gradient[k] == pytest.approx(expected, abs=1e-6 * size)


def test_the_information_is_the_curvature_where_only_noise_is_left(clear):
    problem, _ = clear
    free = np.flatnonzero(coefficients(problem, TRUTH))
    theta, here = problem.settle(coefficients(problem, TRUTH), free)
    rng = np.random.default_rng(1)
    for _ in range(5):
        step = np.zeros(len(theta))
        step[free] = rng.standard_normal(len(free)) / np.sqrt(np.diag(here.information))
        step *= 30.0  # residuals times second derivatives drown
        expected = here.cost + step[free] @ (2.0 * here.gradient + here.information @ step[free])
        assert expected > here.cost + 500.0
        rise = problem.linearised(theta + step, free).cost - here.cost
        assert rise == pytest.approx(expected - here.cost, rel=0.02)


def test_derivatives_of_some_are_those_among_all(clear):
    problem, _ = clear
    theta, some = near(problem, np.random.default_rng(2)), np.array([1, 4, 9, 20])
    whole = problem.linearised(theta, np.arange(len(theta)))
    part = problem.linearised(theta, some)
    assert part.rows == whole.rows
    np.testing.assert_allclose(part.cost, whole.cost, rtol=1e-12)
    np.testing.assert_allclose(part.gradient, whole.gradient[some], rtol=1e-9)
    np.testing.assert_allclose(part.information, whole.information[np.ix_(some, some)], rtol=1e-9)


# the scale


@pytest.mark.parametrize("scale", [-1.0, 1e-8, 3e5])
def test_the_cost_is_the_same_along_the_coefficients(clear, scale):
    problem, _ = clear
    theta, free = near(problem, np.random.default_rng(3)), np.arange(len(problem.mechanisms))
    here, there = problem.linearised(theta, free), problem.linearised(scale * theta, free)
    assert there.cost == pytest.approx(here.cost, rel=1e-9)
    np.testing.assert_allclose(there.gradient, here.gradient / scale, rtol=1e-6)
    sizes = np.sqrt(np.diag(here.information)) * np.abs(theta)
    assert abs(here.gradient @ theta) < 1e-9 * sizes.sum() * np.sqrt(here.cost)
    assert theta @ here.information @ theta < 1e-15 * sizes.sum() ** 2


def test_steps_from_afar_end_where_those_from_the_truth_do_but_for_the_scale(clear):
    problem, _ = clear
    truth = coefficients(problem, TRUTH)
    free = np.flatnonzero(truth)
    good, least = problem.settle(truth, free)
    other, cost = problem.settle(-7.0 * truth * (1.0 + 0.1 * np.cos(np.arange(len(truth)))), free)
    assert cost.cost == pytest.approx(least.cost, rel=1e-6)
    np.testing.assert_allclose(other[free] / other[free[0]], good[free] / good[free[0]], rtol=1e-3)


def test_what_does_not_determine_the_targets_has_no_derivatives(clear):
    problem, _ = clear
    theta = coefficients(problem, TRUTH | {"phi_dot**2 in kinetic": 0.0, "phi_dot*x_dot*cos(phi) in kinetic": 0.0})
    assert problem.linearised(theta, np.arange(3)) is None
    assert problem.settle(theta, np.arange(3)) is None


# what is proposed


# By how much coefficients may be off, and what is too much may make of the force.
LEVELS = {1: (0.005, 0.002), 2: (0.03, 0.01), 3: (0.15, 0.05)}


@pytest.mark.parametrize("level", LEVELS)
def test_the_cart_is_proposed(level):
    problem, noisy = cart(level)
    theta = proposed(problem, noisy)
    (force,) = (k for k, m in enumerate(problem.mechanisms) if str(m) == "u in force on x")
    found = named(problem, theta / theta[force])
    accuracy, too_much = LEVELS[level]
    for name, truth in TRUTH.items():
        assert found[name] == pytest.approx(truth, rel=accuracy), name
    # Whatever else there is hardly moves anything, at an inertia of 0.9 and a rate of rotation of some 6 rad/s.
    rows = np.concatenate(problem.raw(problem.signals))
    sizes = np.sqrt(np.mean(rows**2, axis=0)) * np.abs(theta)
    others = [k for k in np.flatnonzero(theta) if str(problem.mechanisms[k]) not in TRUTH]
    assert len(others) <= len(TRUTH)
    assert all(sizes[k] < too_much * sizes[force] for k in others)


def test_elimination_ends_with_what_matters_most_and_names_the_law_on_the_way(clear):
    problem, noisy = clear
    start = proposed(problem, noisy)
    extra = coefficients(problem, {"x_dot**2*cos(2*phi) in kinetic": 1e-3, "abs(x_dot) in dissipation": 1e-3})
    path = list(eliminated(problem, start + extra))
    sizes = [np.count_nonzero(theta) for theta, _ in path]
    assert sizes == list(range(sizes[0], sizes[-1] - 1, -1))
    assert any(named(problem, theta).keys() == TRUTH.keys() for theta, _ in path)
    costs = [here.cost for _, here in path]
    assert all(later >= earlier * (1.0 - 1e-6) for earlier, later in pairwise(costs))


def test_what_is_known_stays_and_gives_the_others_their_scale(clear):
    _, noisy = clear
    mass = tied(CART_TERMS, ("x_dot**2 in kinetic = 1.8",), scope_of(CART, FORCE))
    problem = MechanismProblem.of(clear[0].signals, mass)
    found = named(problem, proposed(problem, noisy))
    assert found["x_dot**2 in kinetic"] == 1.8
    for name, truth in TRUTH.items():
        assert found[name] == pytest.approx(2.0 * truth, rel=0.02), name


# two groups of relations


BOTH = (Coordinate("x", 2), Coordinate("y", 2))
SPRINGS = lagrangian(
    BOTH, (), scope_of(BOTH),
    kinetic=("x_dot**2", "y_dot**2"),
    potential=("x**2", "y**2", "x**4", "y**4"),
    dissipation=("x_dot**2", "y_dot**2"),
)  # fmt: skip


@pytest.fixture(scope="module")
def springs():
    """Two oscillators that know nothing of each other: x'' = -4 x - .2 x', y'' = -9 y - .1 y' - .8 y^3."""
    t = 0.02 * np.arange(3000)

    def slope(_, s):
        return [s[2], s[3], -4.0 * s[0] - 0.2 * s[2], -9.0 * s[1] - 0.1 * s[3] - 0.8 * s[1] ** 3]

    run = solve_ivp(slope, (0.0, t[-1]), [1.0, 2.0, 0.0, 0.5], t_eval=t, rtol=1e-9, atol=1e-11)
    noise = np.array([0.002, 0.004])
    signals, _ = signals_of(BOTH, (), [Record(t, run.y[:2].T, ("x", "y"))], noise, np.random.default_rng(0))
    return MechanismProblem.of(signals, SPRINGS)


def test_relations_apart_have_a_scale_each_and_weights_do_not_see_them(springs):
    theta = coefficients(
        springs,
        {"x_dot**2 in kinetic": 0.5, "y_dot**2 in kinetic": 5.0, "x**2 in potential": 2.0, "y**2 in potential": 45.0,
         "y**4 in potential": 2.0, "x_dot**2 in dissipation": 0.1, "y_dot**2 in dissipation": 0.5,
         "x**4 in potential": 0.01},
    )  # fmt: skip
    free = np.flatnonzero(theta)
    theta, here = springs.settle(theta, free)
    scales = springs.scales(theta, free)
    assert len(scales) == 2
    np.testing.assert_allclose(scales.sum(axis=0), theta[free])
    found = weights(here, theta[free], scales)
    assert_weights(springs, theta, free, here, found, rel=0.15)


def assert_weights(problem, theta, free, here, found, rel):
    """Compare weights with what refits say, of what is dispensable: they hold to first order."""
    compared = 0
    for k, weight in zip(free, found, strict=True):
        without = theta.copy()
        without[k] = 0.0
        refitted = problem.settle(without, np.setdiff1d(free, [k]))
        rise = np.inf if refitted is None else refitted[1].cost - here.cost
        assert weight > 0.0
        if weight < 0.1 * here.cost:
            assert rise == pytest.approx(weight, rel=rel, abs=1e-3 * here.cost)
            compared += 1
        else:
            assert rise > 0.05 * here.cost
    assert compared > 0


def test_relations_apart_are_eliminated_in_the_order_of_what_they_lack(springs):
    theta = coefficients(
        springs, {str(m): 1.0 for m in SPRINGS} | {"x**2 in potential": 4.0, "y**2 in potential": 9.0, "x**4": 0.01}
    )
    path = list(eliminated(springs, theta))
    gone = [min(named(springs, a).keys() - named(springs, b).keys()) for (a, _), (b, _) in pairwise(path)]
    assert gone[0] == "x**4 in potential"
    # Friction and the cube before the springs.
    assert set(gone[1:4]) == {"y**4 in potential", "x_dot**2 in dissipation", "y_dot**2 in dissipation"}


# reactions: the targets are known, and all else is plain least squares


SPECIES = tuple(Coordinate(name) for name in "SECP")
ENZYME = reactions(SPECIES, (), named=None, composition={"S": "s", "E": "e", "C": "s e", "P": "s"})
RATES = {"S + E -> C": 2.0, "C -> S + E": 0.5, "C -> E + P": 1.0}


def enzyme(seed, noise):
    """Return problem and noisy signals of three runs of S + E <-> C -> E + P."""

    def slope(_, y):
        bind, split = 2.0 * y[0] * y[1] - 0.5 * y[2], y[2]
        return [-bind, split - bind, bind - split, split]

    t, runs = 0.02 * np.arange(400), []
    for s, e in ((1.0, 0.5), (2.0, 0.3), (0.6, 0.8)):
        run = solve_ivp(slope, (0.0, t[-1]), [s, e, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-11)
        runs.append(Record(t, run.y.T, tuple("SECP")))
    signals, noisy = signals_of(SPECIES, (), runs, noise, np.random.default_rng(seed))
    return MechanismProblem.of(signals, ENZYME), noisy


def test_reactions_with_known_targets_are_plain_least_squares():
    problem, _ = enzyme(0, 0.005)
    rows, targets = np.concatenate(problem.raw(problem.signals)), np.array([m.known is not None for m in ENZYME])
    names = [m.name for m in ENZYME]
    rng = np.random.default_rng(0)
    for chosen in (list(RATES), ["S -> P", "C -> E + P", "S + E -> C", "E + P -> C"], names[4:8]):
        free = np.array([names.index(name) for name in chosen])
        expected, (cost,), *_ = np.linalg.lstsq(rows[:, free], -rows[:, targets].sum(axis=1))
        start = targets.astype(float)
        start[free] = 3.0 * rng.standard_normal(len(free))
        theta, here = problem.settle(start, np.sort(free))
        np.testing.assert_allclose(theta[free], expected, rtol=1e-6)
        assert here.cost == pytest.approx(cost, rel=1e-9)
        assert np.all(theta[targets] == 1.0)
        assert not len(problem.scales(theta, free))
        kept = np.sort(free)
        for k, weight in zip(kept, weights(here, theta[kept], problem.scales(theta, kept)), strict=True):
            (without,) = np.linalg.lstsq(rows[:, np.setdiff1d(kept, [k])], -rows[:, targets].sum(axis=1))[1]
            assert weight == pytest.approx(without - cost, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_reactions_of_more_than_one_molecule_are_proposed(seed):
    problem, noisy = enzyme(seed, 0.002)
    theta = proposed(problem, noisy)
    found = {ENZYME[k].name: float(theta[k]) for k in np.flatnonzero(theta) if ENZYME[k].known is None}
    for name, rate in RATES.items():
        assert found[name] == pytest.approx(rate, rel=0.05)
    assert all(abs(rate) < 0.02 for name, rate in found.items() if name not in RATES)
