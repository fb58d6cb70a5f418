import numpy as np
import pytest

from odescope.validation.agreement import VALID_ERROR, agreement, turned, valid_time

T = 0.01 * np.arange(1001)
Y = np.sin(2.0 * np.pi * T)


def test_a_perfect_prediction_the_mean_and_a_worse_one():
    assert agreement([(Y, Y)]).fit == 100.0
    assert agreement([(Y, np.full_like(Y, Y.mean()))]).fit == pytest.approx(0.0, abs=1e-9)
    off = agreement([(Y, -Y)])
    assert off.fit == pytest.approx(-100.0, abs=0.1)
    assert off.rmse == pytest.approx(2.0 * np.sqrt(np.mean(Y**2)))


def test_the_fit_is_that_of_its_definition_over_runs_with_means_of_their_own():
    rng = np.random.default_rng(0)
    runs = [(rng.standard_normal(n) + level, rng.standard_normal(n)) for n, level in ((30, 0.0), (50, 9.0))]
    errors = sum(np.sum((y - p) ** 2) for y, p in runs)
    spread = sum(np.sum((y - y.mean()) ** 2) for y, _ in runs)
    found = agreement(runs)
    assert found.fit == pytest.approx(100.0 * (1.0 - np.sqrt(errors / spread)))
    assert found.rmse == pytest.approx(np.sqrt(errors / 80))
    assert found.told("m").endswith(" m")


def test_whole_turns_of_an_angle_are_taken_off():
    shifted = Y + 4.0 * np.pi
    np.testing.assert_allclose(turned(shifted, Y), Y, atol=1e-12)
    np.testing.assert_allclose(turned(shifted + 0.3, Y), Y + 0.3, atol=1e-12)
    assert agreement([(Y, shifted)]).fit < 0.0


def test_a_constant_has_no_fit():
    found = agreement([(np.ones(5), np.zeros(5))])
    assert found.fit is None
    assert found.rmse == 1.0
    assert "constant" in found.told(None)


@pytest.mark.parametrize("level", [0.1, 0.3, 1.7e9 + 0.123, -1e-9])
def test_a_constant_whose_mean_is_rounded_has_no_fit_either(level):
    rest = np.full(1003, level)
    assert agreement([(rest, rest + 1.0)]).fit is None
    moving = (Y, Y + 0.1)
    both, alone = agreement([(rest, rest), moving]), agreement([moving])
    assert both.fit == pytest.approx(alone.fit, rel=1e-12)


def test_the_valid_time_ends_where_the_error_has_grown():
    growing = Y + 0.1 * T  # its error passes 0.3 of the standard deviation at t = 0.3 / 0.1 / sqrt(2)
    assert valid_time(T, Y, growing) == pytest.approx(VALID_ERROR * Y.std() / 0.1, abs=0.07)
    noisy = Y + 0.1 * np.random.default_rng(0).standard_normal(len(Y))
    assert valid_time(T, noisy, Y) == 10.0
    assert valid_time(T, Y, Y[:300]) == T[299]
