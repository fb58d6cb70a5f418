"""The filter and the smoother of linear models, against matrix exponentials and dense Gaussian conditioning."""

import numpy as np
import pytest
from built_models import build
from scipy.linalg import expm

from odescope.observer.estimate import observed
from odescope.observer.noise import ObserverNoise
from odescope.observer.run import ReadyRecord
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record

A = np.array([[0.0, 1.0], [-4.0, -0.3]])
B = np.array([[0.0], [1.0]])
H = np.array([[1.0, 0.0]])


def oscillator(hold="zero", delay=0.0, offset=0.0):
    return build(
        [Coordinate("x", order=2, offset=offset)],
        [Input("u", hold=hold, delay=delay)],
        [("x_ddot", "1", 1.0), (None, "x", 4.0), (None, "x_dot", 0.3), (None, "u", -1.0)],
    )


def exact_step(dt, u, q):
    """Transition, the input's share and the noise added over a step, from one matrix exponential each (Van Loan)."""
    both = expm(np.block([[A, B], [np.zeros((1, 3))]]) * dt)
    van_loan = expm(np.block([[-A, np.diag([0.0, q**2])], [np.zeros((2, 2)), A.T]]) * dt)
    phi = van_loan[2:, 2:].T
    return phi, both[:2, 2] * u, phi @ van_loan[:2, 2:]


def kalman(t, y, u, sigma, q, mean, covariance, counts):
    """The textbook filter and the textbook Rauch-Tung-Striebel smoother."""
    means, spreads, before, priors, steps = [], [], [], [], []
    for j in range(len(t)):
        if j:
            phi, push, added = exact_step(t[j] - t[j - 1], u[j - 1], q)
            mean, covariance = phi @ mean + push, phi @ covariance @ phi.T + added
            steps.append(phi)
        before.append(mean)
        priors.append(covariance)
        if counts[j]:
            s = H @ covariance @ H.T + sigma**2 / counts[j]
            gain = covariance @ H.T / s
            mean = mean + (gain * (y[j] - mean[0])).ravel()
            covariance = covariance - gain @ H @ covariance
        means.append(mean)
        spreads.append(covariance)
    smooth, smooth_spread = [means[-1]], [spreads[-1]]
    for j in range(len(t) - 2, -1, -1):
        gain = spreads[j] @ steps[j].T @ np.linalg.inv(priors[j + 1])
        smooth.insert(0, means[j] + gain @ (smooth[0] - before[j + 1]))
        smooth_spread.insert(0, spreads[j] + gain @ (smooth_spread[0] - priors[j + 1]) @ gain.T)
    return [np.array(part) for part in (means, spreads, smooth, smooth_spread, before, priors)]


def irregular(seed=0, samples=200):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.01, 0.09, samples))
    counts = rng.choice([0.0, 1.0, 2.0], samples, p=[0.2, 0.7, 0.1])
    counts[60:100] = 0.0
    return t, rng.standard_normal(samples), np.sin(2.0 * t) + 0.05 * rng.standard_normal(samples), counts


@pytest.mark.parametrize("q", [0.0, 0.4])
def test_a_linear_model_is_the_textbook_filter_and_smoother(q):
    t, u, y, counts = irregular()
    start = np.array([0.3, -0.2]), np.array([[0.5, 0.1], [0.1, 2.0]])
    record = Record(t, np.column_stack([y, u]), ("x", "u"), counts=np.column_stack([counts, np.ones(len(t))]))
    prepared = ReadyRecord.of(oscillator(), record, start)
    noise = ObserverNoise({"x": 0.05}, {"x_ddot": q})
    means, spreads, smooth, smooth_spread, before, priors = kalman(t, y, u, 0.05, q, *start, counts)
    for found, mean, spread in (
        (observed([prepared], noise), means, spreads),
        (observed([prepared], noise, smooth=True), smooth, smooth_spread),
    ):
        (run,) = found.runs
        np.testing.assert_allclose(run.states, mean, rtol=0, atol=1e-8)
        np.testing.assert_allclose(run.std**2, np.diagonal(spread, axis1=1, axis2=2), rtol=0, atol=1e-8)
        assert run.settling == 0
        there = counts > 0.0
        assert np.all(np.isnan(run.innovations[~there]))
        np.testing.assert_allclose(run.innovations[there, 0], (y - before[:, 0])[there], rtol=0, atol=1e-8)
        expected = np.sqrt(priors[there, 0, 0] + 0.05**2 / counts[there])
        np.testing.assert_allclose(run.expected[there, 0], expected, rtol=1e-7)


def test_the_likelihood_is_that_of_the_readings_together():
    """Against the density of all readings at once, their joint covariance made by hand."""
    t, u, y, counts = irregular(samples=30)
    counts = np.maximum(counts, 1.0)
    start, q = (np.zeros(2), np.diag([1.0, 1.0])), 0.4
    record = Record(t, np.column_stack([y, u]), ("x", "u"), counts=np.column_stack([counts, np.ones(30)]))
    (run,) = observed([ReadyRecord.of(oscillator(), record, start)], ObserverNoise({"x": 0.05}, {"x_ddot": q})).runs
    mean, covariance = [start[0]], np.zeros((60, 60))
    covariance[:2, :2] = start[1]
    for j in range(1, 30):
        phi, push, added = exact_step(t[j] - t[j - 1], u[j - 1], q)
        mean.append(phi @ mean[-1] + push)
        now, last = slice(2 * j, 2 * j + 2), slice(2 * j - 2, 2 * j)
        covariance[now, : 2 * j] = phi @ covariance[last, : 2 * j]
        covariance[: 2 * j, now] = covariance[now, : 2 * j].T
        covariance[now, now] = phi @ covariance[last, last] @ phi.T + added
    joint = covariance[::2, ::2] + np.diag(0.05**2 / counts)
    off = y - np.array(mean)[:, 0]
    sign, log = np.linalg.slogdet(2.0 * np.pi * joint)
    assert sign > 0
    assert run.log_likelihood == pytest.approx(-0.5 * (log + off @ np.linalg.solve(joint, off)), abs=1e-6)
    assert run.squared.sum() == pytest.approx(off @ np.linalg.solve(joint, off), rel=1e-6)


def test_an_offset_and_a_delay_are_the_models():
    """A sensor that reads more and an input that acts late change nothing in the states, if the model knows."""
    t = 0.05 * np.arange(200)
    rng = np.random.default_rng(1)
    u, y = rng.standard_normal(200), rng.standard_normal(200)
    late = np.concatenate([u[:1], u[:1], u[:-2]])
    start, noise = (np.zeros(2), np.eye(2)), ObserverNoise({"x": 0.1}, {"x_ddot": 0.2})
    seen = np.ones((200, 2))
    seen[:2, 0] = 0.0  # readings while the input that acts was not recorded
    plain = Record(t, np.column_stack([y, late]), ("x", "u"), counts=seen)
    other = Record(t, np.column_stack([y + 0.7, u]), ("x", "u"))
    (expected,) = observed([ReadyRecord.of(oscillator(), plain, start)], noise).runs
    (found,) = observed([ReadyRecord.of(oscillator(delay=0.1, offset=0.7), other, start)], noise).runs
    np.testing.assert_allclose(found.states, expected.states, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.std, expected.std, rtol=0, atol=1e-9)
