"""Inputs that act late: the model sees u(t - delay), and the first or last sample where nothing was recorded."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.initial_state import initial_state
from odescope.model.model import Model, without_delays
from odescope.model.relation import Relation, RelationTerm
from odescope.model.simulation import drive, simulate
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record
from odescope.signals.differentiators import Spectral


def build(inputs, *terms, order=1):
    x = Coordinate("x", order)
    scope = Scope.of([*x.states, *(i.name for i in inputs)])
    rows = (RelationTerm(Product(None, parse_term(text, scope)), -c) for text, c in terms)
    return Model((x,), tuple(inputs), (Relation((RelationTerm(Product(x.target), 1.0), *rows)),))


def acting(t, column, i):
    """The input at any time, by its definition."""

    def at(time):
        seen = np.clip(time - i.delay, t[0], t[-1])
        if i.hold == "linear":
            return np.interp(seen, t, column)
        return column[max(np.searchsorted(t, seen, side="right") - 1, 0)]

    return at


def reference(slope, t, u, inputs, initial):
    """DOP853 at tight tolerance, started anew on every kink of every input."""
    kinks = np.unique(np.concatenate([t, *(t + i.delay for i in inputs)]))
    kinks = np.append(kinks[(kinks > t[0]) & (kinks < t[-1])], t[-1])
    states, now, begin = {t[0]: np.asarray(initial, float)}, np.asarray(initial, float), t[0]
    for end in kinks[np.diff(kinks, prepend=t[0]) > 1e-9]:
        # The values at two points inside say all: between kinks every input is linear.
        inside = begin + (end - begin) * np.array([0.25, 0.75])
        low, high = (np.array([acting(t, u[:, k], i)(at) for k, i in enumerate(inputs)]) for at in inside)

        def driven(time, x, low=low, high=high, inside=inside):
            return slope(x, low + (high - low) * (time - inside[0]) / (inside[1] - inside[0]))

        now = solve_ivp(driven, (begin, end), now, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        states[end], begin = now, end
    near = np.array(list(states))
    return np.array([states[near[np.argmin(np.abs(near - at))]] for at in t])


@pytest.mark.parametrize("samples", [2, 5, 11, 14, 101])
@pytest.mark.parametrize(("delay", "end"), [(0.5, 0.125), (0.0, 0.5), (-0.5, 0.875), (2.0, 0.0), (-2.0, 1.0)])
def test_a_ramp_that_acts_late(samples, delay, end):
    t = np.linspace(0.0, 1.0, samples)
    found = simulate(build([Input("u", delay=delay)], ("u", 1.0)), t, t[:, None], np.zeros(1))
    assert found.states[-1, 0] == pytest.approx(end, abs=1e-9)


@pytest.mark.parametrize(("delay", "whole"), [(0.3, 3), (0.1 + 0.2, 3), (-0.2, -2), (0.6000000000000001, 6)])
def test_a_held_input_late_by_whole_samples_is_the_input_moved(delay, whole):
    t, u = 0.1 * np.arange(40), np.random.default_rng(0).standard_normal(40)
    moved = u[np.clip(np.arange(40) - whole, 0, 39)]
    late = build([Input("u", hold="zero", delay=delay)], ("u", 1.0), ("x", -0.5))
    expected = simulate(without_delays(late), t, moved[:, None], np.zeros(1)).states
    found = simulate(late, t, u[:, None], np.zeros(1)).states
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_a_held_input_switches_between_samples():
    t, u = np.arange(6.0), np.array([0.0, 4.0, -2.0, 0.0, 1.0, 9.0])
    found = simulate(build([Input("u", hold="zero", delay=0.25)], ("u", 1.0)), t, u[:, None], np.zeros(1)).states[:, 0]
    exact = np.append(0.0, np.cumsum(0.75 * u[:-1] + 0.25 * np.append(u[0], u[:-2])))
    assert found == pytest.approx(exact, rel=1e-13, abs=1e-13)


@pytest.mark.parametrize("delay", [0.0, 0.37, -1.2])
def test_a_band_limited_input_drives_as_the_sine_does_that_was_sampled(delay):
    w, t = 2.0 * np.pi / 4.5, np.arange(300.0)
    model = build([Input("u", hold="band-limited", delay=delay)], ("u", 1.0), ("x", -0.5))
    late = build([Input("u", delay=delay)], ("u", 1.0), ("x", -0.5))
    exact = np.real(np.exp(1j * w * (t - delay)) / (0.5 + 1j * w))
    found, linear = (simulate(m, t, np.cos(w * t)[:, None], exact[:1]).states[:, 0] for m in (model, late))
    assert np.abs(found - exact)[60:-60].max() < 5e-4
    assert np.abs(linear - exact)[60:-60].max() > 0.05


@pytest.mark.parametrize("delays", [(0.3, 0.0, -0.07), (0.123, 0.321, 0.0), (-0.4, 0.25, 0.25), (1e-3, -1e-3, 50.0)])
def test_several_inputs_each_with_its_own_delay(delays):
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.05, 0.3, 40)) + 3.0
    u = rng.standard_normal((40, 3))
    inputs = [Input(n, h, delay=d) for n, h, d in zip("abc", ("linear", "zero", "linear"), delays, strict=True)]
    model = build(inputs, ("x_dot", -0.3), ("sin(x)", -4.0), ("a", 1.0), ("b*x", 0.5), ("c", 2.0), order=2)
    found = simulate(model, t, u, np.array([0.2, -0.1]), rtol=1e-10, atol=1e-12)

    def slope(x, v):
        return [x[1], -0.3 * x[1] - 4.0 * np.sin(x[0]) + v[0] + 0.5 * v[1] * x[0] + 2.0 * v[2]]

    assert found.ended is None
    assert len(found.t) == 40
    assert np.array_equal(found.t, t)
    assert found.states == pytest.approx(reference(slope, t, u, inputs, [0.2, -0.1]), abs=1e-8)


def test_a_delay_hardly_longer_than_a_sample_costs_no_more_steps_than_it_adds_kinks():
    # The sliver between a sample and a kink must not shorten the steps that follow it.
    t = 0.01 * np.arange(3000)
    model = build([Input("u", delay=0.01 + 1e-7)], ("x", -1.0), ("u", 1.0))
    assert simulate(model, t, np.sin(t)[:, None], np.zeros(1)).ended is None
    driven = drive(model.inputs, t, np.sin(t)[:, None])
    assert len(driven.t) == 2 * len(t) - 2
    assert np.all(driven.period > 0.009)


def test_delays_in_seconds_of_the_epoch():
    t = 1.7e9 + 0.01 * np.arange(200)
    late = build([Input("u", delay=0.0237)], ("u", 1.0), ("x", -1.0))
    u = np.sin(3.0 * (t - t[0]))[:, None]
    near = simulate(late, t - t[0], u, np.zeros(1)).states
    assert simulate(late, t, u, np.zeros(1)).states == pytest.approx(near, abs=1e-6)


def test_a_single_sample_is_its_own_run():
    late = build([Input("u", delay=0.3)], ("u", 1.0))
    assert np.array_equal(simulate(late, np.array([1.0]), np.ones((1, 1)), np.array([2.0])).states, [[2.0]])


def test_an_early_input_is_seen_beyond_a_short_stretch():
    # A run over the first samples alone sees what was recorded after them.
    t, u = 0.1 * np.arange(50), np.random.default_rng(1).standard_normal((50, 1))
    model = build([Input("u", delay=-0.35)], ("u", 1.0))
    driven = drive(model.inputs, t, u).part(0, 10)
    assert driven.sample[-1] == 9
    assert driven.end[-1, 0] == pytest.approx(np.interp(t[9] + 0.35, t, u[:, 0]))


def test_the_initial_state_is_found_under_a_late_input():
    rng = np.random.default_rng(2)
    t = 0.01 * np.arange(2000)
    u = np.convolve(rng.standard_normal(2000), np.hanning(60), "same")
    model = build([Input("u", delay=0.3)], ("x", -9.0), ("x_dot", -0.4), ("u", 2.0), order=2)
    truth = np.array([0.7, -1.5])
    run = simulate(model, t, u[:, None], truth)
    record = Record(t, np.column_stack([run.column("x") + 1e-4 * rng.standard_normal(2000), u]), ("x", "u"))
    found = initial_state(model, record)
    assert found == pytest.approx(truth, abs=1e-3)
    # The delay matters: without it the state that fits best is another.
    assert np.abs(initial_state(without_delays(model), record) - truth).max() > 1e-2


def test_the_initial_state_starts_from_the_differentiator_that_was_chosen():
    asked = []

    class Mine:
        def derivatives(self, records, period, order):
            asked.append(order)
            return Spectral().derivatives(records, period, order)

    t = 0.01 * np.arange(300)
    noisy = np.cos(3.0 * t) + 1e-3 * np.random.default_rng(0).standard_normal(300)
    model = build([], ("x", -9.0), order=2)
    assert initial_state(model, Record(t, noisy[:, None], ("x",)), Mine()) == pytest.approx([1.0, 0.0], abs=1e-2)
    assert asked == [2]


def test_without_delays_takes_no_more_than_the_delays():
    model = build([Input("u", "zero", "N", delay=0.3)], ("u", 1.0))
    assert without_delays(model) == replace(model, inputs=(Input("u", "zero", "N"),))
