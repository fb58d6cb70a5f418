"""Times of steps as further parameters of a fit: beside refits under other times, and where laws need them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope import Data, Driven, Measured, Study, identify
from odescope.likelihood.sampled_inputs import with_steps
from odescope.likelihood.timed_fit import ANYWHERE, Steps, covariance_with_times, timed_fit

PERIOD, COUNT = 0.05, 800


def staircase(rng, count, every):
    """Return steps at times in samples that are no whole numbers, about so many apart, and the levels between them."""
    times = np.cumsum(every * rng.uniform(0.7, 1.3, int(1.6 * count / every)))
    return times[times < count - 1.0], rng.uniform(-1.0, 1.0, len(times) + 1)


def driven(seed, slope, start, noise, period=PERIOD, count=COUNT, scale=1.0, every=40.0):
    """Return samples (N, n) of a system with noise, its input that steps between them, and when it does.

    Args:
        seed: of steps and noise.
        slope: of the states, from these and the input.
        start: (n,) states to begin with.
        noise: in standard deviations of each state.
        period: of the samples, in seconds.
        count: of the samples.
        scale: of the input.
        every: samples from step to step, about.
    """
    rng, x = np.random.default_rng(seed), np.array(start, dtype=float)
    times, levels = staircase(rng, count, every)
    edges, parts = np.r_[0.0, times, count], []
    for begin, end, u in zip(edges[:-1], edges[1:], scale * levels, strict=False):
        inside = np.arange(np.ceil(begin), np.ceil(end))
        run = solve_ivp(
            lambda _, x, u=u: slope(x, u), (period * begin, period * end), x, t_eval=period * np.r_[inside, end],
            rtol=1e-9, atol=1e-11,
        ).y  # fmt: skip
        parts.append(run[:, :-1])
        x = run[:, -1]
    states = np.concatenate(parts, axis=1).T
    u = scale * levels[np.searchsorted(times, np.arange(count), side="right")]
    return states + noise * states.std(axis=0) * rng.standard_normal(states.shape), u, times


@pytest.fixture(scope="module", params=[40.0, 12.0])
def vehicle(request):
    """A model of x'' = u - .6 x', the steps that it sees, and when they come in truth; up to three a segment."""
    states, u, times = driven(3, lambda x, u: [x[1], u - 0.6 * x[1]], [0.0, 0.0], 0.001, every=request.param)
    log = {"t": PERIOD * np.arange(COUNT), "x": states[:, 0], "u": u}
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    found = identify(study, log).refinement
    at = np.floor(times).astype(int)
    rise = np.diff(u)[at][:, None]
    now = 1.0 - found.space.segments.cuts[at]
    return found, at, rise, now, at + 1.0 - times


def moved(found, steps, early):
    """Return the space of a model with steps at other times."""
    segments = found.space.segments
    inputs, cuts = with_steps(segments.inputs, segments.cuts, steps.at, steps.rise, early)
    return found.space.on(replace(segments, inputs=inputs, cuts=cuts))


def refitted(found, steps, early):
    """Return the fit of a model with steps at other times, and its cost with that of the times."""
    space = moved(found, steps, early)
    width = found.space.segments.spread * found.outcome.width
    fit = space.fit(found.fit.theta, found.fit.present, found.fit.x0, width, found.fit.strength, tolerance=1e-9)
    return fit, fit.cost + ANYWHERE * float(np.sum((early - 0.5) ** 2))


def test_no_times_nearby_are_better_and_those_that_matter_are_right(vehicle):
    found, at, rise, now, truth = vehicle
    steps, _ = Steps.of(found.space, at, rise, now)
    timed = timed_fit(found.space, found.fit, steps, found.space.segments.spread * found.outcome.width)
    assert refitted(found, steps, timed.early)[1] == pytest.approx(timed.cost, abs=0.2)
    rng = np.random.default_rng(0)
    for _ in range(20):
        near = np.clip(timed.early + 0.1 * rng.standard_normal(len(at)), 0.0, 1.0)
        assert refitted(found, steps, near)[1] > timed.cost
    large = np.abs(rise[:, 0]) > 0.5
    assert np.sqrt(np.mean((timed.early - truth)[large] ** 2)) < 0.1
    assert np.sqrt(np.mean((0.5 - truth)[large] ** 2)) > 0.2


def test_what_times_leave_open_is_in_the_covariance(vehicle):
    """Beside differences between refits: of the least cost at given times, and of the coefficients there."""
    found, at, rise, now, _ = vehicle
    steps, _ = Steps.of(found.space, at[4:7], rise[4:7], now[4:7])
    inside, h = np.clip(steps.now, 0.2, 0.8), 0.05
    there, _ = refitted(found, steps, inside)
    found, steps = replace(found, space=moved(found, steps, inside), fit=there), replace(steps, now=inside)
    unit = h * np.eye(len(inside))

    def fits(change):
        fit, cost = refitted(found, steps, steps.now + change)
        return fit.theta[there.free], cost

    slopes = np.array([(fits(e)[0] - fits(-e)[0]) / (2.0 * h) for e in unit]).T
    bends = [[fits(a + b)[1] - fits(a - b)[1] - fits(b - a)[1] + fits(-a - b)[1] for b in unit] for a in unit]
    times = np.linalg.inv(0.5 * np.array(bends) / (4.0 * h**2))
    width = found.space.segments.spread * found.outcome.width
    known = covariance_with_times(found.space, there, steps, width)
    np.testing.assert_allclose(known, there.covariance + slopes @ times @ slopes.T, rtol=0.02)
    assert np.all(np.diag(known) > there.variances)


@pytest.mark.parametrize("seed", [13, 16, *(pytest.param(s, marks=pytest.mark.slow) for s in range(13))])
def test_a_vehicle_whose_drive_steps_between_samples_has_its_law_and_right_errors(seed):
    """Without times of the joined record 17 of 24 such logs had further terms, and errors of 5 standard errors."""
    states, u, _ = driven(seed, lambda x, u: [x[1], u - 0.6 * x[1]], [0.0, 0.0], 0.002)
    log = {"t": PERIOD * np.arange(COUNT), "x": states[:, 0], "u": u}
    study = Study(data=Data(time="t"), coordinates={"x": Measured(order=2)}, inputs={"u": Driven()})
    terms = {t.text: t for t in identify(study, log).model.relations[0].terms}
    assert set(terms) == {"x_ddot", "x_dot", "u"}
    for name, truth in {"x_dot": 0.6, "u": -1.0}.items():
        assert abs(terms[name].coefficient - truth) < 3.5 * terms[name].std_error < 0.02


def crane(x, force, mass=22.0, load=14.0, length=3.1):
    """Return the rates of place, angle, and their rates, of a load on a rope below a trolley."""
    _, angle, v, rate = x
    sine, cosine = np.sin(angle), np.cos(angle)
    slowed = 9.81 * sine + 0.02 * length * rate
    push = (force - 18.0 * v + load * (length * rate**2 * sine + slowed * cosine)) / (mass + load * sine**2)
    return [v, rate, push, -(push * cosine + slowed) / length]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_crane_whose_force_steps_between_samples_has_its_potential_energy(seed):
    """What times too poor had left asked for cos(2 phi) and phi^2 in the place of cos(phi)."""
    logs = []
    for begin, own in ((0.05, 2 * seed), (0.7, 2 * seed + 1)):
        states, u, _ = driven(own, crane, [0.0, begin, 0.0, 0.0], 0.005, period=0.04, count=1000, scale=90.0)
        logs.append({"t": 0.04 * np.arange(1000), "x": states[:, 0], "phi": states[:, 1], "F": u})
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2, cyclic=True), "phi": Measured(order=2, angle=True)},
        inputs={"F": Driven()},
    )
    found = {(m.kind, m.term): m.coefficient for m in identify(study, logs).model.mechanisms}
    truth = {
        ("kinetic", "x_dot**2"): 18.0,
        ("kinetic", "phi_dot*x_dot*cos(phi)"): 43.4,
        ("kinetic", "phi_dot**2"): 67.27,
        ("potential", "cos(phi)"): -425.75,
        ("dissipation", "x_dot**2"): 9.0,
        ("dissipation", "phi_dot**2"): 1.345,
        ("force", "F"): 1.0,
    }
    assert found.keys() == truth.keys()
    for mechanism, value in truth.items():
        assert found[mechanism] == pytest.approx(value, rel=0.05)
