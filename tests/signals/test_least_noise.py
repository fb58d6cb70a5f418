"""What the noise of a channel is at least: steps of a sensor, errors of a solver."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from odescope.signals.noise import SENSOR, SOLVER, least_noise, noise_level
from odescope.signals.spectral import Spectrum

T = np.linspace(0.0, 10.0, 150)
WAVE = np.sin(T)


def test_a_solution_is_no_better_than_its_solver():
    """The white noise of what a solver returns is a hundredth of what it is off, or less."""
    found = solve_ivp(lambda _, x: 0.4 * x * (1 - x / 100) - 0.3, (0, 10), [14.3], "LSODA", T, rtol=1e-5, atol=1e-7).y[
        0
    ]
    exact = solve_ivp(lambda _, x: 0.4 * x * (1 - x / 100) - 0.3, (0, 10), [14.3], t_eval=T, rtol=1e-12, atol=1e-12).y[
        0
    ]
    white, off = noise_level([Spectrum.of(found)]), float(np.sqrt(np.mean((found - exact) ** 2)))
    assert white < 0.1 * off
    assert least_noise([found], white) > off


@pytest.mark.parametrize("part", [0.3, 3.0])
def test_a_channel_with_white_noise_was_measured(part):
    white = part * SENSOR * float(WAVE.std())
    assert least_noise([WAVE], white) == (pytest.approx(SOLVER * WAVE.std()) if part < 1.0 else 0.0)


def test_a_sensor_of_what_turns_on_and_on_is_no_solver_for_how_far_it_went():
    turned = WAVE + 1e4 * T
    assert least_noise([turned], 3.0 * SENSOR * float(WAVE.std())) == 0.0
    assert least_noise([turned], 0.0) == pytest.approx(SOLVER * turned.std())


def test_what_drifts_while_it_moves_may_be_a_solvers():
    drifting = WAVE + 2.0 * float(WAVE.std() / T.std()) * T
    white = 0.7 * SENSOR * float(drifting.std())
    assert white > SENSOR * float(WAVE.std())
    assert least_noise([drifting], white) == pytest.approx(SOLVER * drifting.std())


def test_what_records_differ_by_does_not_count_as_motion():
    assert least_noise([WAVE, WAVE + 100.0], 0.0) == pytest.approx(SOLVER * WAVE.std())


@pytest.mark.parametrize("digits", [6, 8])
def test_a_record_with_as_few_digits_as_a_logger_writes_was_measured_however_little_noise_it_has(digits):
    assert least_noise([np.round(0.1 * WAVE, digits)], 1e-7) < 1e-6
    assert least_noise([0.1 * WAVE], 1e-8) == pytest.approx(SOLVER * 0.1 * WAVE.std())


def test_a_record_in_which_a_sensor_said_nothing_has_no_part():
    assert least_noise([WAVE, np.zeros(0)], 0.0) == least_noise([WAVE], 0.0)
