"""Dry friction in a free run: sticking and sliding against closed forms, and against a smooth law that comes close."""

import numpy as np
import pytest
from built_models import build
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from simulation_cases import free

from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input

BLOCK = Coordinate("x", order=2)
# A state that is the sine sin(w t) itself, so that no sampling of a force stands between the run and the closed form.
FORCE, W = Coordinate("f", order=2), 0.7
SINE = [("f_ddot", "1", 1.0), (None, "f", W**2)]


def block_under_a_sine(mass, force, friction):
    law = [("x_ddot", "1", mass), (None, "f", -force), (None, "sign(x_dot)", friction)]
    return build([BLOCK, FORCE], [], law, SINE)


def closed_form(mass, force, friction):
    """When a slide begins and ends within half a period, and how far it goes: m v' = F sin(w t) - R from v = 0."""
    begin = np.arcsin(friction / force) / W

    def speed(t):
        return (force / W * (np.cos(W * begin) - np.cos(W * t)) - friction * (t - begin)) / mass

    def way(t):
        bent = force / W * (np.cos(W * begin) * (t - begin) - (np.sin(W * t) - np.sin(W * begin)) / W)
        return (bent - friction * (t - begin) ** 2 / 2.0) / mass

    end = brentq(speed, np.pi / W - begin, begin + np.pi / W)
    return begin, end, way


@pytest.mark.parametrize("share", [0.7, 0.85, 0.97])
def test_a_block_under_a_slow_sine_sticks_and_slides_as_in_closed_form(share):
    mass, force = 2.5, 3.0
    begin, end, way = closed_form(mass, force, share * force)
    half = np.pi / W
    assert end < begin + half  # else it would never stick
    t = np.linspace(0.0, 6.0 * half, 4001)
    run = free(block_under_a_sine(mass, force, share * force), t, [0.0, 0.0, 0.0, W])
    assert run.ended is None
    x, x_dot = run.column("x"), run.column("x_dot")
    slides, phase = np.divmod(t - begin, half)  # since the last slide began; no slide before the first
    phase[slides < 0] = np.inf
    direction = np.where(slides % 2 == 0, 1.0, -1.0)
    assert np.all(x_dot[phase > end - begin + 1e-6] == 0.0)
    assert np.all((x_dot * direction)[(phase > 1e-3) & (phase < end - begin - 1e-3)] > 0.0)
    # To one side and back in turn, each slide as long as the other.
    gone = np.where(slides < 0, 0.0, way(begin + np.minimum(phase, end - begin)))
    assert x == pytest.approx(np.where(direction > 0.0, gone, way(end) - gone) * (slides >= 0), abs=1e-7)


def test_too_small_a_force_moves_nothing():
    run = free(block_under_a_sine(1.0, 0.999, 1.0), np.linspace(0.0, 50.0, 11), [0.3, 0.0, 0.0, W])
    assert np.array_equal(run.column("x"), np.full(11, 0.3))


@pytest.mark.parametrize("start", [1.05, 0.43, 0.19, 0.05])
def test_a_spring_with_dry_friction_loses_the_same_every_half_swing_and_stops(start):
    # x'' = -x - .1 sign(x'): turning points at start, -(start - .2), start - .4, ...; at rest within .1 of 0.
    model = build([BLOCK], [], [("x_ddot", "1", 1.0), (None, "x", 1.0), (None, "sign(x_dot)", 0.1)])
    t = np.pi * np.arange(9)
    sizes, swing = [start], 0
    while sizes[-1] > 0.1:
        sizes.append(sizes[-1] - 0.2)
        swing += 1
    sizes += [sizes[-1]] * (len(t) - len(sizes))
    signs = (-1.0) ** np.minimum(np.arange(len(t)), swing)
    found = free(model, t, [start, 0.0])
    assert found.column("x") == pytest.approx(signs * sizes, abs=1e-6)
    assert np.all(found.column("x_dot")[swing + 1 :] == 0.0)


def test_a_sign_that_does_not_brake_is_passed():
    # x'' = -sign(x): parabolas, a period of 4 sqrt(2).
    model = build([BLOCK], [], [("x_ddot", "1", 1.0), (None, "sign(x)", 1.0)])
    found = free(model, np.sqrt(2.0) * np.arange(41), [1.0, 0.0]).column("x")
    assert found == pytest.approx(np.tile([1.0, 0.0, -1.0, 0.0], 11)[:41], abs=1e-5)
    # and one that drives: x'' = sign(x')
    model = build([BLOCK], [], [("x_ddot", "1", 1.0), (None, "sign(x_dot)", -1.0)])
    t = np.arange(4.0)
    assert free(model, t, [0.0, -1e-3]).column("x") == pytest.approx(-1e-3 * t - t**2 / 2.0, abs=1e-8)


def test_a_belt_carries_its_block_until_the_spring_wins():
    # x'' = -x - .5 sign(x' - .2) from rest on a belt of speed .2: carried from when it is as fast to x = .5.
    law = [("x_ddot", "1", 1.0), (None, "x", 1.0), (None, "sign(x_dot - 0.2)", 0.5)]
    t = np.linspace(0.0, 2.6, 2601)
    run = free(build([BLOCK], [], law), t, [0.0, 0.2])
    carried = t < 2.5
    assert run.column("x_dot")[carried] == pytest.approx(np.full(carried.sum(), 0.2), abs=1e-15)
    # Then x = 0.5 + d, d'' = -d from d' = .2 (the sign is now -1): behind the belt.
    assert run.column("x")[~carried] == pytest.approx(0.5 + 0.2 * np.sin(t[~carried] - 2.5), abs=1e-8)


def pair(sign):
    """Two blocks that rub against each other and each against the ground; a force on the first."""
    return build(
        [Coordinate("p", order=2), Coordinate("q", order=2)],
        [Input("u")],
        [("p_ddot", "1", 1.0), (None, "u", -1.0), (None, sign("p_dot"), 0.3), (None, sign("p_dot - q_dot"), 0.4)],
        [("q_ddot", "1", 0.8), (None, sign("q_dot"), 0.1), (None, sign("p_dot - q_dot"), -0.4)],
    )


def test_blocks_that_rub_against_each_other_follow_a_smooth_law_that_comes_close():
    t = np.linspace(0.0, 10.0, 1001)
    u = np.sin(t) + 0.3 * np.sin(2.7 * t)
    run = simulate(pair("sign({})".format), t, u[:, None], np.zeros(4))

    def smooth(now, s):
        p_dot, q_dot = s[2:]
        first, both, second = (np.tanh(1e5 * v) for v in (p_dot, p_dot - q_dot, q_dot))
        force = np.interp(now, t, u)
        return [p_dot, q_dot, force - 0.3 * first - 0.4 * both, (0.4 * both - 0.1 * second) / 0.8]

    close = solve_ivp(smooth, (0.0, 10.0), np.zeros(4), "LSODA", t_eval=t, rtol=1e-8, atol=1e-10).y.T
    assert run.ended is None
    assert run.states == pytest.approx(close, abs=5e-4)
    p_dot, q_dot = run.states[:, 2:].T
    assert np.mean((p_dot == q_dot) & (p_dot != 0.0)) > 0.3  # they go together
    assert np.mean(p_dot != q_dot) > 0.1  # and slide
    assert np.all(close[(p_dot == 0.0) & (q_dot == 0.0), 2] < 1e-4)


def test_a_force_that_is_held_and_noisy_ends_no_run():
    # Stuck and let go from sample to sample: exact between samples, since the force is constant there.
    model = build(
        [BLOCK], [Input("u", hold="zero")], [("x_ddot", "1", 1.0), (None, "u", -1.0), (None, "sign(x_dot)", 1.0)]
    )
    t = 0.01 * np.arange(3001)
    u = 1.5 * np.random.default_rng(0).standard_normal(len(t))
    run = simulate(model, t, u[:, None], np.zeros(2))
    x, v, expected = 0.0, 0.0, [0.0]
    for force, span in zip(u[:-1], np.diff(t), strict=True):
        left = span
        while left > 0.0:
            way = np.sign(v) if v != 0.0 else np.sign(force) * (abs(force) > 1.0)
            pull = force - way if way != 0.0 else 0.0
            stop = -v / pull if v * pull < 0.0 else np.inf
            part = min(left, stop)
            x, v, left = x + v * part + pull * part**2 / 2.0, 0.0 if stop <= left else v + pull * part, left - part
        expected.append(x)
    assert run.ended is None
    assert run.column("x") == pytest.approx(np.array(expected), abs=1e-7)
    assert np.mean(run.column("x_dot") == 0.0) > 0.2


def test_signs_of_anything_else_stay_as_they_are():
    # Of an input, beside another sign, in front of a target: no edge.
    model = build(
        [BLOCK, Coordinate("y", order=2)],
        [Input("u")],
        [("x_ddot", "1", 1.0), (None, "sign(u)", 1.0), (None, "sign(x_dot)*sign(y_dot)", 0.1)],
        [("y_ddot", "1", 2.0), ("y_ddot", "sign(y)", 0.5), (None, "x*sign(x - y_dot)**3", 0.1), (None, "sign(y)", 1.0)],
    )
    assert model.switched.edges.tolist() == [[1.0, 0.0, 0.0, -1.0, 0.0]]
