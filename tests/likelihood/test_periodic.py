"""Periodic residuals, compared with least squares on a sine and a cosine."""

from dataclasses import replace

import numpy as np
import pytest
from process_cases import space
from small_systems import SPRING, SPRING_STEP, drive, shots

from odescope.likelihood.periodic import periodic
from odescope.likelihood.suspicion import rates

SPREAD = np.array([1e-3, 5e-3])
INPUT = 4  # the term of it


def run(rate, runs=None):
    """Return the space of the spring driven by one sine that its model does not have, and the model."""
    count = len(drive()) * 3
    t = SPRING_STEP * (np.arange(count)[:, None] + np.array([0.0, 0.5, 1.0]))
    nodes = 2.0 * np.sin(rate * t + 0.3)[:, :, None]
    states = SPRING.trajectory(SPRING.theta, [0.5, 0.0], nodes[:-1], SPRING_STEP)
    data = shots(states, nodes, SPRING_STEP, 1e-3, np.random.default_rng(0), SPREAD)
    it = space(SPRING, data if runs is None else replace(data, runs=tuple(runs(count))))
    theta = np.where(np.arange(len(SPRING.theta)) == INPUT, 0.0, SPRING.theta)
    return it, it.fit(theta, np.flatnonzero(theta), it.segments.initial, SPREAD * np.inf, iterations=0)


def left(columns, target):
    """Return the squares that columns (k, N) leave of a target (N,)."""
    scaled = (columns / np.linalg.norm(columns, axis=1)[:, None]).T
    return float(np.sum((target - scaled @ np.linalg.lstsq(scaled, target, rcond=None)[0]) ** 2))


@pytest.mark.parametrize("rate", [1.3, 2.9])
@pytest.mark.parametrize("runs", [None, lambda n: [(0, n // 2), (n // 2, n)]], ids=["one recording", "two recordings"])
def test_the_rate_of_a_forcing_and_the_share_that_goes_with_it(rate, runs):
    it, model = run(rate, runs)
    line = periodic(it, model)
    assert abs(line.rate - rate) < line.width
    before = after = 0.0
    for low, high in it.segments.runs:
        x, v = it.segments.filtered[low:high].T
        known = np.array([np.ones_like(x), x, v, x**3])
        t = it.segments.step * np.arange(high - low)
        target = rates(it)[0, low:high]
        before += left(known, target)
        after += left(np.vstack([known, np.sin(line.rate * t), np.cos(line.rate * t)]), target)
    assert line.share == pytest.approx(1.0 - after / before, abs=1e-6)


def test_the_residual_of_the_law_itself_is_not_periodic():
    it, model = run(1.3)
    assert periodic(it, replace(model, theta=SPRING.theta, present=np.flatnonzero(SPRING.theta))) is None


def test_a_recording_too_short_for_three_periods_of_eight_averages_says_nothing():
    it, model = run(2.9)
    lines = {few: periodic(it.on(replace(it.segments, runs=((0, few),))), model) for few in (22, 400)}
    assert lines[22] is None
    assert lines[400] is not None
