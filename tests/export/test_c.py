"""The exported C, compiled as strictly as compilers do, against odescope's own simulation and dense linear algebra."""

import ctypes
import itertools
import shutil
import subprocess
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from exported_models import TIMES, driven_cart, free_run, push, reactor, slider
from hand_models import MODELS, relation
from scipy.integrate import solve_ivp

from odescope.errors import InputError
from odescope.export.programs.c import to_c
from odescope.library.parse import Scope
from odescope.model.model import Model
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input

STRICT = ("-std=c99", "-pedantic-errors", "-Wall", "-Wextra", "-Werror", "-O2")
COMPILER = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
ALL = {**MODELS, "cart": driven_cart(), "slider": slider(), "reactor": reactor()}


class Compiled:
    """The shared library of a model, called with arrays."""

    def __init__(self, model, folder):
        self.model, self.n, self.m = model, len(model.states), len(model.inputs)
        folder.mkdir(exist_ok=True)
        for name, text in to_c(model, "plant").files.items():
            (folder / name).write_text(text)
        sources = [str(p) for p in folder.glob("*.c")]
        command = [COMPILER, *STRICT, "-shared", "-fPIC", "-o", str(folder / "plant.so"), *sources, "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        self.library = ctypes.CDLL(str(folder / "plant.so"))
        self.motion = ctypes.create_string_buffer(4096)

    def call(self, function, *arguments):
        def passed(a):
            if isinstance(a, np.ndarray):
                assert a.dtype == np.float64
                assert a.flags.c_contiguous
                return a.ctypes.data_as(ctypes.c_void_p)
            return ctypes.c_double(a) if isinstance(a, float) else a

        return getattr(self.library, f"plant_{function}")(*map(passed, arguments))

    def rhs(self, x, u):
        out = np.empty(self.n)
        assert self.call("rhs", np.array(x), np.array(u), out) == 0
        return out

    def jacobian(self, x, u):
        by_state, by_input = np.empty((self.n, self.n)), np.empty((self.n, self.m))
        assert self.call("jacobian", np.array(x), np.array(u), by_state, by_input) == 0
        return np.hstack([by_state, by_input])

    @property
    def state(self):
        return np.frombuffer(self.motion, dtype=np.float64, count=self.n).copy()

    def step(self, x, u0, u1, h):
        self.call("begin", self.motion, np.array(x))
        phi = np.empty((self.n, self.n))
        assert self.call("step_and_slope", self.motion, np.array(u0), np.array(u1), h, phi) == 0
        return self.state, phi

    def follow(self, start, inputs, t=TIMES, longest=1e-3):
        self.call("begin", self.motion, np.array(start, dtype=float))
        states, inputs = [self.state], np.ascontiguousarray(inputs, dtype=float)
        for k in range(len(t) - 1):
            assert self.call("follow", self.motion, t, inputs, len(t), k, longest) == 0
            states.append(self.state)
        return np.array(states)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    folder, found = tmp_path_factory.mktemp("c"), {}
    number = itertools.count()

    def get(model):
        if id(model) not in found:
            found[id(model)] = (model, Compiled(model, folder / str(next(number))))
        return found[id(model)][1]

    return get


def differences(function, x, step=1e-6):
    """Return the Jacobian of a function at x by central differences."""
    return np.array([(function(x + step * e) - function(x - step * e)) / (2.0 * step) for e in np.eye(len(x))]).T


def dense(model, values):
    """Return the derivative of the states, from the text of the terms and a solver that odescope does not use."""
    functions = {f: getattr(np, f) for f in ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sign", "tanh")}
    names = functions | dict(zip(model.variables, values, strict=True))
    a, b = np.zeros((len(model.targets),) * 2), np.zeros(len(model.targets))
    for row, r in enumerate(model.relations):
        for t in r.terms:
            worth = t.coefficient * eval(t.term.text, {"__builtins__": {}}, names)  # noqa: S307 (our own text)
            if t.factor is None:
                b[row] -= worth
            else:
                a[row, model.targets.index(t.factor)] += worth
    known = names | dict(zip(model.targets, np.linalg.solve(a, b), strict=True))
    following = {c.derivative(k): c.derivative(k + 1) for c in model.coordinates for k in range(c.order)}
    return np.array([known[following[s]] for s in model.states])


@needs_compiler
def test_a_compiler_takes_it_as_it_is_set(tmp_path):
    """Without an option for the dialect, where libraries declare names of their own beside those of C."""
    for name in ("cart", "slider", "reactor"):
        for file, text in to_c(ALL[name], "plant").files.items():
            (tmp_path / file).write_text(text)
        sources = [str(path) for path in tmp_path.glob("*.c")]
        done = subprocess.run([COMPILER, "-fsyntax-only", *sources], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


@needs_compiler
@pytest.mark.parametrize("name", ALL)
def test_the_right_hand_side_and_its_jacobian_are_those_of_the_relations(name, compiled):
    model, rng = ALL[name], np.random.default_rng(3)
    plant = compiled(model)
    for _ in range(5):
        at = rng.uniform(0.3, 1.3, len(model.variables))
        x, u = at[: plant.n], at[plant.n :]
        assert np.allclose(plant.rhs(x, u), dense(model, at), rtol=1e-12, atol=1e-12)
        exact = plant.jacobian(x, u)
        size = np.abs(exact).max()
        assert np.allclose(exact, differences(lambda z: dense(model, z), at), rtol=1e-6, atol=1e-6 * size)


@needs_compiler
@pytest.mark.parametrize("name", ALL)
def test_the_slope_of_a_step_is_the_derivative_of_the_step(name, compiled):
    model, rng = ALL[name], np.random.default_rng(4)
    plant = compiled(model)
    at = rng.uniform(0.3, 1.3, len(model.variables))
    u0, u1 = at[plant.n :], at[plant.n :] + 0.1
    _, phi = plant.step(at[: plant.n], u0, u1, 0.01)
    found = differences(lambda x: plant.step(x, u0, u1, 0.01)[0], at[: plant.n])
    assert np.allclose(phi, found, rtol=1e-7, atol=1e-8)
    assert np.abs(phi - np.eye(plant.n)).max() > 1e-3


@needs_compiler
@pytest.mark.parametrize(("hold", "delay"), [("linear", 0.0), ("zero", 0.0), ("linear", 0.0234), ("zero", -0.017)])
def test_ten_seconds_of_regular_motion_agree_with_the_free_run(hold, delay, compiled):
    model, start = driven_cart(hold, delay), [0.1, 0.4, 0.0, -0.2]
    exact = free_run(model, push(), start)
    found = compiled(model).follow(start, push())
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()
    assert np.ptp(exact, axis=0).min() > 0.3


@needs_compiler
@pytest.mark.parametrize("delay", [0.0, 0.0234])
def test_a_band_limited_input_is_the_same_polygon(delay, compiled):
    t, model = 0.05 * np.arange(201), driven_cart("band-limited", delay)
    force, start = 8.0 * np.sin(14.0 * t + 0.3)[:, None], [0.1, 0.4, 0.0, -0.2]
    exact, found = free_run(model, force, start, t), compiled(model).follow(start, force, t)
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()
    straight = free_run(driven_cart("linear", delay), force, start, t)
    assert np.abs(straight - exact).max() > 1e-3


@needs_compiler
def test_inputs_of_different_holds_and_delays_act_together(compiled):
    inputs = tuple(
        msgspec.structs.replace(i, delay=d) for i, d in zip(MODELS["rational"].inputs, (0.013, 0.004), strict=True)
    )
    model = replace(MODELS["rational"], inputs=inputs)
    t = np.sort(np.random.default_rng(2).uniform(0.0, 0.3, 31))
    u = np.column_stack([np.sin(7.0 * t), np.where(t < 0.1, 0.5, 1.0)])
    start = [0.2, 0.4, 0.6, 0.8]
    assert np.allclose(compiled(model).follow(start, u, t, 2e-4), free_run(model, u, start, t), rtol=1e-8, atol=1e-9)


@needs_compiler
def test_masses_on_a_rough_table_stick_and_slide_as_in_the_free_run(compiled):
    force, start = 2.2 * np.sin(1.3 * TIMES)[:, None], [0.3, -0.2, 0.0, 0.0]
    exact, found = free_run(slider(), force, start), compiled(slider()).follow(start, force)
    assert np.abs(found - exact).max() < 1e-6
    for rate in (2, 3):
        still = np.abs(exact[:, rate]) < 1e-12
        assert 0.05 < np.mean(still) < 0.95
        assert np.all(np.abs(found[still, rate]) < 1e-9)


@needs_compiler
def test_at_standstill_the_right_hand_side_has_what_keeps_it_there(compiled):
    plant = compiled(slider())
    assert np.array_equal(plant.rhs([0.1, 0.1, 0.0, 0.0], [0.2]), np.zeros(4))
    moved = plant.rhs([0.0, 0.0, 0.0, 0.0], [5.0])
    assert moved[2] > 3.0


@needs_compiler
@pytest.mark.parametrize("start", [[1e-9], [-2.0]])
def test_a_run_that_leaves_the_numbers_is_said(start, compiled):
    scope = Scope.of(["x"])
    model = Model((Coordinate("x"),), (), (relation(scope, ("x_dot", "1", 1.0), (None, "log(x)", -1e300)),))
    plant = compiled(model)
    plant.call("begin", plant.motion, np.array(start))
    assert plant.call("step", plant.motion, None, None, 1e9) == 1


def batch(p, x, y, r, offset, rows):
    """The update of a Kalman filter in one go, by dense algebra."""
    h = np.eye(len(x))[rows]
    s = h @ p @ h.T + np.diag(r)
    e = y - offset - h @ x
    gain = p @ h.T @ np.linalg.inv(s)
    return x + gain @ e, (np.eye(len(x)) - gain @ h) @ p, e @ np.linalg.solve(s, e)


def spread(model, x, q, inputs, h):
    """The covariance that noise makes of none in h seconds: P' = F P + P F' + diag(q), integrated beside the state."""
    n = len(x)

    def rates(t, z):
        u = inputs[0] + (inputs[1] - inputs[0]) * t / h
        moved = differences(lambda x: dense(model, [*x, *u]), z[:n]) @ z[n:].reshape(n, n)
        return np.concatenate([dense(model, [*z[:n], *u]), (moved + moved.T + np.diag(q)).ravel()])

    start = np.concatenate([x, np.zeros(n * n)])
    return solve_ivp(rates, (0.0, h), start, rtol=1e-9, atol=1e-12).y[n:, -1].reshape(n, n)


@needs_compiler
def test_the_filter_predicts_and_updates_as_dense_algebra_does(compiled):
    model, rng = driven_cart(), np.random.default_rng(5)
    plant, n = compiled(model), 4
    root = rng.normal(size=(n, n))
    x, p, q, r = rng.normal(size=n), root @ root.T + np.eye(n), rng.uniform(0.1, 1.0, n), rng.uniform(0.1, 0.2, 2)
    filtered = ctypes.create_string_buffer(4096)
    held = np.frombuffer(filtered, dtype=np.float64, count=n + n * n)  # no friction: mean, then covariance
    plant.call("kalman_begin", filtered, x, p)
    u0, u1 = np.array([1.0]), np.array([2.0])
    assert plant.call("kalman_predict", filtered, u0, u1, 0.01, q) == 0
    ahead, phi = plant.step(x, u0, u1, 0.01)
    predicted = held[n:].reshape(n, n).copy()
    assert np.allclose(held[:n], ahead, rtol=1e-14)
    added, exact = predicted - phi @ p @ phi.T, spread(model, x, q, (u0, u1), 0.01)
    assert np.abs(added - exact).max() < 1e-8
    halves = 0.005 * np.diag(q)
    assert np.abs(phi @ halves @ phi.T + halves - exact).max() > 1e-6
    y, e, s = np.array([0.7, -0.3]), np.empty(2), np.empty(2)
    turned = y + np.array([0.0, 6.0 * np.pi])  # the second is an angle, of which sensors lose count
    assert plant.call("kalman_update", filtered, turned, r, e, s) == 0
    mean, covariance, nis = batch(predicted, ahead, y, r, np.array([0.125, 0.125]), [0, 1])
    assert np.allclose(held[:n], mean, rtol=1e-12)
    assert np.allclose(held[n:].reshape(n, n), covariance, rtol=1e-10, atol=1e-12)
    assert np.sum(e**2 / s) == pytest.approx(nis, rel=1e-12)
    before = held.copy()
    assert plant.call("kalman_update", filtered, np.array([np.nan, np.nan]), r, None, None) == 0
    assert np.array_equal(held, before)
    assert plant.call("kalman_update", filtered, np.array([0.5, np.nan]), r, None, None) == 0
    only, _, _ = batch(covariance, mean, y[:1] * 0 + 0.5, r[:1], np.array([0.125]), [0])
    assert np.allclose(held[:n], only, rtol=1e-10)


@needs_compiler
@pytest.mark.parametrize("which", ["cart", "slider"])
def test_the_filter_finds_the_states_of_a_noisy_record_and_knows_how_well(which, compiled):
    model = ALL[which]
    plant, rng, n = compiled(model), np.random.default_rng(6), 4
    u = push() if which == "cart" else 2.2 * np.sin(1.3 * TIMES)[:, None]
    t, start, q = TIMES[:601], np.array([0.1, 0.4, 0.0, -0.2]), np.full(n, 1e-6)
    states = simulate(model, t, u[:601], start).states
    offset = np.array([c.offset for c in model.coordinates])
    noise = 0.01
    y = states[:, :2] + offset + noise * rng.normal(size=(601, 2))
    filtered = ctypes.create_string_buffer(8192)
    plant.call("kalman_begin", filtered, np.zeros(n), np.diag([0.1, 0.1, 1.0, 1.0]))
    mean = np.frombuffer(filtered, dtype=np.float64, count=n)
    found, nis, e, s = [], [], np.empty(2), np.empty(2)
    for k in range(601):
        if k:
            assert plant.call("kalman_predict", filtered, u[k - 1], u[k], 0.01, q) == 0
        assert plant.call("kalman_update", filtered, y[k], np.full(2, noise**2), e, s) == 0
        found.append(mean.copy())
        nis.append(np.sum(e**2 / s))
    error = np.array(found) - states
    assert np.sqrt(np.mean(error[100:, :2] ** 2)) < 0.5 * noise
    assert np.sqrt(np.mean(error[100:, 2:] ** 2)) < 0.1 * states[:, 2:].std()
    assert np.mean(nis[100:]) == pytest.approx(2.0, abs=0.35)  # chi-squared of two readings, 500 times


def test_every_digit_is_there_and_reserved_names_are_said():
    text = to_c(MODELS["rational"]).files["plant.c"]
    for value in (0.1 + 0.2, 1 / 3, 1e-17, 5.55, 3.0):
        assert repr(value) in text
    program = to_c(MODELS["hostile"])
    for note in ("float is written float_", "_np is written v_np"):
        assert note in program.notes
        assert note in program.files["plant.h"]


@pytest.mark.parametrize("name", ["2nd", "a-b", "while", "_x", ""])
def test_a_name_that_functions_cannot_begin_with_is_refused(name):
    with pytest.raises(InputError, match="name"):
        to_c(MODELS["coupled"], name)


@needs_compiler
def test_units_and_notes_cannot_end_the_comment_that_holds_them(compiled):
    model = replace(
        slider(),
        coordinates=(Coordinate("p", 2, unit="*/ int i[-1]; /* \\\n"), Coordinate("q", 2, offset=-0.5)),
        inputs=(Input("f", "linear", '"N*/'),),
    )
    assert np.array_equal(compiled(model).rhs([0.1, 0.1, 0.0, 0.0], [0.2]), np.zeros(4))
