"""The Kalman filter in C along the demo's log, beside `odescope filter`, which integrates by error control."""

import ctypes

import numpy as np
import pytest
from test_c import Compiled, needs_compiler

from odescope.commands.demo import NOISE, cart_pendulum, simulate_log
from odescope.observer.noise import ObserverNoise
from odescope.observer.run import ReadyRecord, run_filter
from odescope.recordings.record import Record

SAMPLES = 8001  # of 65 001


@pytest.fixture(scope="module")
def along(tmp_path_factory):
    """Return the states of both filters (N, 4) for process noise on every target, and steps a sample."""
    model, log = cart_pendulum(), simulate_log(seed=0)
    plant = Compiled(model, tmp_path_factory.mktemp("filter"))
    t, force, read = log.t[:SAMPLES], log.force[:SAMPLES, None], log.measured[:SAMPLES]
    ready = ReadyRecord.of(model, Record(t, np.column_stack([read, force]), ("x", "phi", "u"), (None,) * 3))

    def run(process, steps):
        noise = ObserverNoise(dict(zip(("x", "phi"), NOISE[1], strict=True)), dict.fromkeys(model.targets, process))
        q, r = np.array([0.0, 0.0, process**2, process**2]), np.array(NOISE[1]) ** 2
        filtered, found = ctypes.create_string_buffer(4096), []
        mean = np.frombuffer(filtered, dtype=np.float64, count=4)
        plant.call("kalman_begin", filtered, ready.first.mean.copy(), np.array(ready.first.covariance))
        for k in range(SAMPLES):
            for part in range(steps if k else 0):
                u0, u1 = (force[k - 1] + (force[k] - force[k - 1]) * (part + side) / steps for side in (0, 1))
                assert plant.call("kalman_predict", filtered, u0, u1, float(t[k] - t[k - 1]) / steps, q) == 0
            assert plant.call("kalman_update", filtered, read[k].copy(), r, None, None) == 0
            found.append(mean.copy())
        return np.array(found), run_filter(ready, noise).states

    return run


@needs_compiler
@pytest.mark.parametrize("process", [0.0, 0.1])
def test_it_has_the_states_of_the_python_filter_at_every_sample(process, along):
    found, exact = along(process, 1)
    assert np.all(np.abs(found - exact) < 1e-9 * np.abs(exact).max(axis=0))
    assert np.ptp(exact, axis=0).min() > 1.0
    if process:
        assert np.abs(exact - along(0.0, 1)[1]).max() > 1e-4


@needs_compiler
def test_in_two_steps_a_sample_it_has_them_to_nine_places(along):
    found, exact = along(0.1, 2)
    assert np.abs(found - exact).max() < 1e-9


@needs_compiler
def test_noise_from_nothing_gives_a_covariance(tmp_path):
    plant, filtered = Compiled(cart_pendulum(), tmp_path), ctypes.create_string_buffer(4096)
    plant.call("kalman_begin", filtered, np.array([0.0, 2.0, 1.0, 5.0]), np.zeros((4, 4)))
    for _ in range(3):
        q, force = np.array([0.0, 0.0, 1e-2, 1e-2]), np.array([1.0])
        assert plant.call("kalman_predict", filtered, force, force, 0.01, q) == 0
        p = np.frombuffer(filtered, dtype=np.float64, count=20)[4:].reshape(4, 4)
        assert np.linalg.eigvalsh(p).min() > 0.0
