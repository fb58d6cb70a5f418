"""Sines of the time beside the terms of a relation, compared with least squares on them."""

from dataclasses import replace

import numpy as np
import pytest
from process_cases import space
from small_systems import SPRING, SPRING_STEP, System, drive, shots

from odescope.likelihood.periodic import PRICE, TERMS, periodic
from odescope.likelihood.smoothed_targets import rates
from odescope.recordings.coordinate import Coordinate

SPREAD = np.array([1e-3, 5e-3])


def unrecorded(rate, runs=None):
    """Return the space of the spring under one sine, which is not recorded: its input is another."""
    count = len(drive()) * 3
    t = SPRING_STEP * (np.arange(count)[:, None] + np.array([0.0, 0.5, 1.0]))
    states = SPRING.trajectory(SPRING.theta, [0.5, 0.0], 2.0 * np.sin(rate * t + 0.3)[:-1, :, None], SPRING_STEP)
    other = np.random.default_rng(1).standard_normal((count, 3, 1))
    data = shots(states, other, SPRING_STEP, 1e-3, np.random.default_rng(0), SPREAD)
    return space(SPRING, data if runs is None else replace(data, runs=tuple(runs(count))))


def forward(columns, target, fixed, terms):
    """Return the squares that a forward selection by least squares leaves of a target beside fixed columns."""
    chosen = [*fixed]

    def left(more):
        every = np.array([*chosen, *more]).T
        every /= np.linalg.norm(every, axis=0)
        return float(np.sum((target - every @ np.linalg.lstsq(every, target, rcond=1e-12)[0]) ** 2))

    for _ in range(terms):
        best = min(columns, key=lambda c: left([c]))
        chosen.append(best)
        columns = [c for c in columns if c is not best]
    return left([])


@pytest.mark.parametrize("rate", [1.3, pytest.param(2.9, marks=pytest.mark.slow)])
@pytest.mark.parametrize("runs", [None, lambda n: [(0, n // 3), (n // 3, n)]], ids=["one recording", "two recordings"])
def test_the_rate_of_a_forcing_and_the_share_that_goes_with_it(rate, runs):
    it = unrecorded(rate, runs)
    line = periodic(it)
    assert abs(line.rate - rate) < 0.5 * line.width
    products = [m.parts[0].product for m in it.mechanisms]
    terms = [p.term for p in products if p.factor is None and p.text != "1"]
    columns = [*it.evaluated(terms, np.zeros(len(it.mechanisms)))]
    fixed, waves = [], []
    for low, high in it.segments.runs:
        here = np.zeros(len(columns[0]))
        here[low:high] = 1.0
        t = it.segments.step * np.arange(len(here))
        fixed.append(here)
        waves += [here * np.sin(line.rate * t), here * np.cos(line.rate * t)]
    target = rates(it)[0]
    count = min(TERMS + PRICE, len(columns))
    share = 1.0 - forward(columns, target, [*fixed, *waves], TERMS) / forward(columns, target, fixed, count)
    assert line.share == pytest.approx(share, abs=1e-6)


PUMPED = System(
    (Coordinate("x", 2),),
    ("u",),
    ((0, 0, "1", 1.0), (0, -1, "x_dot", 0.2), (0, -1, "u", 0.0), (0, -1, "x", 1.5), (0, -1, "x**2", 0.0)),
    (0,),
    lambda th, x, u: [-(th[1] * x[1] + (th[3] + u[0]) * x[0])],
)


def pumped(rate):
    """Return the space of a spring whose stiffness goes to and fro, which is not recorded: its input is another."""
    t = SPRING_STEP * (np.arange(3 * len(drive()))[:, None] + np.array([0.0, 0.5, 1.0]))
    stiffness = 0.5 * np.cos(rate * t + 0.3)[:-1, :, None]
    states = PUMPED.trajectory(PUMPED.theta, [0.5, 0.0], stiffness, SPRING_STEP)
    other = np.random.default_rng(1).standard_normal((len(t), 3, 1))
    return space(PUMPED, shots(states, other, SPRING_STEP, 1e-4, np.random.default_rng(0), SPREAD))


def test_a_coefficient_that_goes_to_and_fro_is_told_with_what_it_multiplies():
    it = pumped(1.7)
    line = periodic(it)
    assert (line.variable, line.relation, line.beside.text) == (None, 0, "x")
    assert abs(line.rate - 1.7) < 0.5 * line.width
    products = [m.parts[0].product for m in it.mechanisms]
    terms = [p.term for p in products if p.factor is None and p.text != "1"]
    columns = [*it.evaluated(terms, np.zeros(len(it.mechanisms)))]
    t = it.segments.step * np.arange(len(columns[0]))
    swinging = columns[[term.text for term in terms].index("x")]
    waves = [swinging * np.cos(line.rate * t), swinging * np.sin(line.rate * t)]
    target, fixed, count = rates(it)[0], [np.ones(len(t))], len(columns)
    share = 1.0 - forward(columns, target, [*fixed, *waves], count) / forward(columns, target, fixed, count)
    assert line.share == pytest.approx(share, abs=1e-6)


def test_a_forcing_that_is_recorded_is_no_suspicion():
    states = SPRING.trajectory(SPRING.theta, [0.5, 0.0], drive()[:-1], SPRING_STEP)
    assert periodic(space(SPRING, shots(states, drive(), SPRING_STEP, 1e-3, np.random.default_rng(0), SPREAD))) is None


def test_a_recording_too_short_for_three_periods_of_eight_averages_says_nothing():
    it = unrecorded(2.9)
    lines = {few: periodic(it.on(replace(it.segments, runs=((0, few),)))) for few in (22, 400)}
    assert lines[22] is None
    assert lines[400] is not None


COG = 7.0  # rad a unit of x
COGGED = System(
    (Coordinate("x", 2),),
    ("u",),
    ((0, 0, "1", 1.0), (0, -1, "x_dot", 0.8), (0, -1, "u", -1.0), (0, -1, "x", 1.5), (0, -1, "x**2", 0.0)),
    (0,),
    lambda th, x, u: [-(th[1] * x[1] + th[2] * u[0] + th[3] * x[0]) - 2.0 * np.sin(COG * x[0] + 0.4)],
)


def cogged(runs=None):
    nodes = 2.0 * drive(step=0.25 * SPRING_STEP)
    states = COGGED.trajectory(COGGED.theta, [0.5, 0.0], nodes[:-1], 0.25 * SPRING_STEP)
    data = shots(states, nodes, 0.25 * SPRING_STEP, 1e-3, np.random.default_rng(0), SPREAD)
    return space(COGGED, data if runs is None else replace(data, runs=tuple(runs(len(states)))))


@pytest.mark.parametrize("runs", [None, lambda n: [(0, n // 3), (n // 3, n)]], ids=["one recording", "two recordings"])
def test_what_repeats_along_a_position_is_told_with_its_rate(runs):
    it = cogged(runs)
    line = periodic(it, ["x"])
    assert (line.variable, line.relation) == ("x", 0)
    assert abs(line.rate - COG) < 0.5 * line.width
    assert line.width == pytest.approx(2.0 * np.pi / np.ptp(it.segments.filtered[:, 0]), rel=0.05)


def test_a_position_that_rests_repeats_nothing():
    it = cogged()
    at_rest = replace(it.segments, filtered=np.zeros_like(it.segments.filtered))
    assert periodic(it.on(at_rest), ["x"]) is None
