from dataclasses import replace

import numpy as np
import pytest
from built_models import build
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from simulation_cases import A1, B1, BC, CART_COORDINATES, DECAY, I1, M1, MC, G, X, Y, free, lagrange

from odescope.model.linear_solve import solve_in_place
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input


def reference(slope, t, inputs, holds, initial):
    """DOP853 at tight tolerance, started anew on every sample; slope(x, u)."""
    held, states = np.array([h == "zero" for h in holds], dtype=bool), [np.asarray(initial, dtype=float)]
    for k in range(len(t) - 1):

        def driven(time, x, k=k):
            share = np.where(held, 0.0, (time - t[k]) / (t[k + 1] - t[k]))
            return slope(x, inputs[k] + share * (inputs[k + 1] - inputs[k]))

        run = solve_ivp(driven, (t[k], t[k + 1]), states[-1], "DOP853", rtol=1e-12, atol=1e-13)
        states.append(run.y[:, -1])
    return np.array(states)


def solved(hold):
    """The same, each relation with one target alone, by Cramer's rule on paper."""
    inertia, coupling, mass = I1 + M1 * A1**2, M1 * A1, MC + M1
    determinant = [("1", mass * inertia), ("cos(phi)**2", -(coupling**2))]
    x_ddot = [
        ("u", -inertia),
        ("x_dot", inertia * BC),
        ("sin(phi)*phi_dot**2", -inertia * coupling),
        ("cos(phi)*phi_dot", -coupling * B1),
        ("cos(phi)*sin(phi)", -coupling * M1 * G * A1),
    ]
    phi_ddot = [
        ("phi_dot", mass * B1),
        ("sin(phi)", mass * M1 * G * A1),
        ("cos(phi)*u", coupling),
        ("cos(phi)*x_dot", -coupling * BC),
        ("cos(phi)*sin(phi)*phi_dot**2", coupling**2),
    ]
    return build(
        CART_COORDINATES,
        [Input("u", hold=hold)],
        [*(("x_ddot", t, c) for t, c in determinant), *((None, t, c) for t, c in x_ddot)],
        [*(("phi_ddot", t, c) for t, c in determinant), *((None, t, c) for t, c in phi_ddot)],
    )


def cart_slope(x, u):
    _, phi, x_dot, phi_dot = x
    matrix = [[MC + M1, M1 * A1 * np.cos(phi)], [M1 * A1 * np.cos(phi), I1 + M1 * A1**2]]
    right = [u[0] - BC * x_dot + M1 * A1 * np.sin(phi) * phi_dot**2, -B1 * phi_dot - M1 * G * A1 * np.sin(phi)]
    return np.append([x_dot, phi_dot], np.linalg.solve(matrix, right))


def drive(seed, count, columns=1):
    return 3.0 * np.random.default_rng(seed).standard_normal((count, columns))


@pytest.mark.parametrize("hold", ["linear", "zero"])
def test_a_cart_with_a_pendulum_follows_dop853_in_either_form(hold):
    t = np.linspace(0.0, 2.0, 81)
    u, start = drive(0, 81), np.array([0.0, 2.5, 0.3, -1.0])
    expected = reference(cart_slope, t, u, [hold], start)
    for model in (lagrange(hold), solved(hold)):
        found = simulate(model, t, u, start)
        assert found.ended is None
        assert found.states == pytest.approx(expected, rel=1e-6, abs=1e-7)
        assert np.array_equal(found.column("phi_dot"), found.states[:, 3])


def test_the_two_forms_of_one_law_run_alike():
    t = np.linspace(0.0, 4.0, 401)
    u, start = drive(1, 401), np.array([0.0, 3.0, 0.0, 0.0])
    raw, explicit = (
        simulate(m, t, u, start, rtol=1e-11, atol=1e-12).states for m in (lagrange("zero"), solved("zero"))
    )
    assert raw == pytest.approx(explicit, abs=1e-7)


@pytest.mark.parametrize("holds", [("linear", "zero"), ("zero", "linear")])
def test_orders_one_two_and_three_coupled_follow_dop853(holds):
    # a_dddot + .5 b_ddot = ...; b_ddot - .3 c_dot * a = ...; c_dot (2 + sin(b)) + .2 a_dddot = ...
    model = build(
        [Coordinate("a", order=3), Coordinate("b", order=2), Coordinate("c")],
        [Input("u", hold=holds[0]), Input("v", hold=holds[1])],
        [
            ("a_dddot", "1", 1.0),
            ("b_ddot", "1", 0.5),
            (None, "a", 1.0),
            (None, "a_dot", 2.0),
            (None, "a_ddot", 2.5),
            (None, "u", -1.0),
        ],
        [("b_ddot", "1", 1.0), ("c_dot", "a", -0.3), (None, "b_dot", 0.4), (None, "b", 3.0), (None, "v", -1.0)],
        [
            ("c_dot", "1", 2.0),
            ("c_dot", "sin(b)", 1.0),
            ("a_dddot", "1", 0.2),
            (None, "c", 1.5),
            (None, "tanh(v)", 1.0),
        ],
    )

    def slope(x, u):
        a, b, c, a_dot, b_dot, a_ddot = x
        matrix = [[1.0, 0.5, 0.0], [0.0, 1.0, -0.3 * a], [0.2, 0.0, 2.0 + np.sin(b)]]
        right = [
            u[0] - a - 2.0 * a_dot - 2.5 * a_ddot,
            u[1] - 0.4 * b_dot - 3.0 * b,
            -1.5 * c - np.tanh(u[1]),
        ]
        a_dddot, b_ddot, c_dot = np.linalg.solve(matrix, right)
        return [a_dot, b_dot, c_dot, a_ddot, b_ddot, a_dddot]

    assert model.states == ("a", "b", "c", "a_dot", "b_dot", "a_ddot")
    t = np.sort(np.random.default_rng(5).uniform(0.0, 6.0, 60))
    u, start = drive(2, 60, 2), np.array([0.5, -0.4, 1.0, 0.2, 0.0, -0.3])
    found = simulate(model, t, u, start, rtol=1e-10, atol=1e-12)
    assert found.states == pytest.approx(reference(slope, t, u, holds, start), rel=1e-8, abs=1e-8)


def test_rational_kinetics_and_every_function_follow_dop853():
    model = build(
        [X, Y],
        [],
        [("x_dot", "1", 0.3), ("x_dot", "x", 1.0), (None, "x", 0.9), (None, "1", -0.18), (None, "exp(-y)", -0.1)],
        [
            ("y_dot", "1", 1.0),
            (None, "log(1 + x)*cos(y)", -1.0),
            (None, "sqrt(x)*tanh(y)", 0.5),
            (None, "abs(y)**1.5", 0.2),
            (None, "tan(0.3*x)", -0.4),
            (None, "sign(y)*x**-2", -0.01),
        ],
    )

    def slope(s, _):
        x, y = s
        dx = (0.18 - 0.9 * x + 0.1 * np.exp(-y)) / (0.3 + x)
        dy = np.log(1 + x) * np.cos(y) - 0.5 * np.sqrt(x) * np.tanh(y) - 0.2 * abs(y) ** 1.5
        return [dx, dy + 0.4 * np.tan(0.3 * x) + 0.01 * np.sign(y) / x**2]

    t = np.linspace(0.0, 5.0, 21)
    expected = reference(slope, t, np.empty((21, 0)), [], [2.0, 0.5])
    assert free(model, t, [2.0, 0.5]).states == pytest.approx(expected, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_the_small_solver_agrees_with_lapack_whatever_needs_pivoting(size):
    rng = np.random.default_rng(size)
    for _ in range(20):
        a, b = rng.standard_normal((size, size)), rng.standard_normal(size)
        if size > 1:
            a[0, 0] = 0.0
        expected, found = np.linalg.solve(a, b), b.copy()
        solve_in_place(a.copy(), found[:, None])
        assert found == pytest.approx(expected, rel=1e-8, abs=1e-10)
    singular, found = np.ones((size, size)), np.arange(1.0, size + 1.0)
    singular[0, 0] = 1.0 if size > 1 else 0.0
    solve_in_place(singular, found[:, None])
    assert not np.all(np.isfinite(found))


@pytest.mark.parametrize("rtol", [1e-8, 1e9])
def test_a_held_input_that_switches_is_exact(rtol):
    # x' = u, held: the states are sums, whatever the steps.
    model = build([X], [Input("u", hold="zero")], [("x_dot", "1", 1.0), (None, "u", -1.0)])
    t = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.3, 50))
    u = np.where(np.arange(50) % 7 < 3, 5.0, -2.0)[:, None]
    expected = 1.0 + np.append(0.0, np.cumsum(u[:-1, 0] * np.diff(t)))
    found = simulate(model, t, u, np.array([1.0]), rtol=rtol).states[:, 0]
    assert found == pytest.approx(expected, rel=1e-13, abs=1e-13)


def test_a_linear_input_is_integrated_to_trapezoids():
    model = build([X], [Input("u")], [("x_dot", "1", 1.0), (None, "u", -1.0)])
    t = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.3, 50))
    u = drive(3, 50)
    expected = 1.0 + np.append(0.0, np.cumsum((u[1:, 0] + u[:-1, 0]) / 2.0 * np.diff(t)))
    assert simulate(model, t, u, np.array([1.0])).states[:, 0] == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_a_linear_system_under_a_switched_input_is_its_matrix_exponential():
    # x'' + .6 x' + 9 x = u, u = +-4 held: x[k + 1] = F x[k] + G u[k].
    model = build(
        [Coordinate("x", order=2)],
        [Input("u", hold="zero")],
        [("x_ddot", "1", 1.0), (None, "x_dot", 0.6), (None, "x", 9.0), (None, "u", -1.0)],
    )
    t = 0.2 * np.arange(100)
    u = np.where(np.sin(1.3 * t) > 0.2, 4.0, -4.0)[:, None]
    block = expm(0.2 * np.array([[0.0, 1.0, 0.0], [-9.0, -0.6, 1.0], [0.0, 0.0, 0.0]]))
    states = [np.array([0.3, -1.0])]
    for k in range(99):
        states.append(block[:2, :2] @ states[-1] + block[:2, 2] * u[k])
    found = simulate(model, t, u, states[0], rtol=1e-10, atol=1e-12)
    assert found.states == pytest.approx(np.array(states), abs=1e-8)


def test_the_formula_is_of_order_five():
    # So loose a tolerance accepts every step, and no run is longer than one.
    model = lagrange("linear")
    start, errors = np.array([0.0, 1.0, 0.0, 2.0]), []
    exact = solve_ivp(lambda _, x: cart_slope(x, [0.0]), (0.0, 1.0), start, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    counts = (20, 40, 80, 160)
    for count in counts:
        end = start
        for _ in range(count):
            end = simulate(model, [0.0, 1.0 / count], np.zeros((2, 1)), end, rtol=1e9).states[-1]
        errors.append(np.linalg.norm(end - exact))
    slopes = np.diff(np.log(errors)) / np.diff(np.log(counts))
    assert slopes == pytest.approx([-5.0] * 3, abs=0.5)


def test_samples_that_a_step_passes_over_are_as_exact_as_its_end():
    model = build([Coordinate("phi", order=2)], [], [("phi_ddot", "1", 1.0), (None, "sin(phi)", 9.0)])
    t = np.linspace(0.0, 10.0, 4001)

    def slope(_, s):
        return [s[1], -9.0 * np.sin(s[0])]

    exact = solve_ivp(slope, (0.0, 10.0), [2.0, 0.1], "DOP853", rtol=1e-13, atol=1e-14, t_eval=t).y.T
    tolerances = 10.0 ** -np.arange(4.0, 11.0)
    for rtol in tolerances:
        off = np.abs(free(model, t, [2.0, 0.1], rtol=rtol, atol=1e-3 * rtol).states - exact).max()
        ends = np.abs(free(model, t[::500], [2.0, 0.1], rtol=rtol, atol=1e-3 * rtol).states - exact[::500]).max()
        assert off < min(4.0 * ends, 1000.0 * rtol)


def test_a_finely_sampled_run_is_far_more_exact_than_its_tolerance():
    # The samples that a step passes over had shown it what it misses: their number must not cost the run its digits.
    model = build([Coordinate("phi", order=2)], [], [("phi_ddot", "1", 1.0), (None, "sin(phi)", 9.0)])
    t = np.linspace(0.0, 10.0, 4001)
    exact = solve_ivp(
        lambda _, s: [s[1], -9.0 * np.sin(s[0])], (0.0, 10.0), [2.0, 0.1], "DOP853", rtol=1e-13, atol=1e-14, t_eval=t
    ).y.T
    assert np.abs(free(model, t, [2.0, 0.1]).states - exact).max() < 3e-8


def test_an_input_is_followed_wherever_it_bends_between_long_stretches_of_one_value():
    # x' = u: its integral, whatever the length of the steps.
    model = build([Coordinate("x")], [Input("u", hold="zero")], [("x_dot", "1", 1.0), (None, "u", -1.0)])
    t = np.sort(np.random.default_rng(8).uniform(0.0, 9.0, 400))
    u = np.where((t > 3.0) & (t < 3.4), 5.0, np.where(t > 7.0, t, -1.0))
    exact = np.append(0.0, np.cumsum(u[:-1] * np.diff(t)))
    assert simulate(model, t, u, np.zeros(1)).states[:, 0] == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize("samples", [2, 9])
def test_a_tighter_tolerance_reduces_the_error_in_proportion(samples):
    model = build(
        [Coordinate("x", order=2)],
        [],
        [("x_ddot", "1", 1.0), (None, "x_dot", -1.0), (None, "x**2*x_dot", 1.0), (None, "x", 1.0)],
    )
    t = np.linspace(0.0, 12.0, samples)
    exact = solve_ivp(
        lambda _, s: [s[1], (1.0 - s[0] ** 2) * s[1] - s[0]], (0.0, 12.0), [2.0, 0.0], "DOP853", rtol=1e-13, atol=1e-14
    ).y[:, -1]
    tolerances = 10.0 ** -np.arange(3.0, 11.0)
    errors = [np.linalg.norm(free(model, t, [2.0, 0.0], rtol=r, atol=1e-3 * r).states[-1] - exact) for r in tolerances]
    assert np.all(np.diff(errors) < 0.0)
    assert np.all(errors < 300.0 * tolerances)
    assert errors[0] / errors[-1] > 1e5


def test_a_run_cut_in_two_is_the_run():
    t = np.linspace(0.0, 3.0, 151)
    u, start = drive(4, 151), np.array([0.1, 1.0, 0.0, 0.0])
    whole = simulate(lagrange("linear"), t, u, start).states
    first = simulate(lagrange("linear"), t[:76], u[:76], start).states
    second = simulate(lagrange("linear"), t[75:], u[75:], first[-1]).states
    assert np.array_equal(whole[:76], first)
    assert second == pytest.approx(whole[75:], abs=1e-7)


def test_a_run_is_printed_in_a_line():
    t = 0.02 * np.arange(151)
    run = simulate(lagrange("linear"), t, drive(4, 151), np.array([0.1, 1.0, 0.0, 0.0]))
    assert repr(run) == f"Trajectory of {', '.join(run.names)}: 151 samples, 0 to 3 s"
    assert repr(replace(run, ended="it ran away")).endswith("; it ran away")


def test_neither_the_origin_of_time_nor_an_unused_later_input_matters():
    t = 0.05 * np.arange(60)
    u, start = drive(6, 60), np.array([0.0, 1.0, 0.0, 0.0])
    plain = simulate(lagrange("zero"), t, u, start).states
    assert simulate(lagrange("zero"), t + 1024.0, u, start).states == pytest.approx(plain, abs=1e-8)
    # The last held value begins where the run ends.
    u[-1] = 1e6
    assert np.array_equal(simulate(lagrange("zero"), t, u, start).states, plain)


def test_energy_of_an_undamped_pendulum_stays():
    model = build([Coordinate("phi", order=2)], [], [("phi_ddot", "1", 1.0), (None, "sin(phi)", 9.0)])
    phi, phi_dot = free(model, np.linspace(0.0, 20.0, 101), [3.0, 0.1], rtol=1e-10, atol=1e-12).states.T
    energy = phi_dot**2 / 2.0 - 9.0 * np.cos(phi)
    assert energy == pytest.approx(np.full(101, energy[0]), abs=1e-6)


def test_a_state_that_passes_zero_costs_no_small_steps():
    # x' = -x, started at 1: relative to the run, e^-40 is nothing; relative to itself it would fall short of 1e-10.
    states = free(DECAY, np.linspace(0.0, 40.0, 5), [1.0]).states[:, 0]
    assert states == pytest.approx(np.exp(-np.linspace(0.0, 40.0, 5)), abs=1e-7)
