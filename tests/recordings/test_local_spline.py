import numpy as np
import pytest
from scipy.interpolate import make_lsq_spline

from odescope.recordings.local_spline import fit_smooth


def uneven(count, seed=0):
    return np.arange(count) + np.random.default_rng(seed).uniform(-0.3, 0.3, count)


def test_it_is_the_least_squares_spline_on_its_knots():
    """Against SciPy's, on the knots that were chosen."""
    t, rng = uneven(300), np.random.default_rng(1)
    y, weights = np.sin(t / 7.0) + 0.1 * rng.standard_normal(300), rng.uniform(0.5, 2.0, 300)
    found = fit_smooth(t, y, weights)
    expected = make_lsq_spline(t, y, found.t, w=np.sqrt(weights))  # SciPy weighs residuals, not their squares
    assert found(t) == pytest.approx(expected(t), abs=1e-8)


def test_the_noise_that_stays_in_a_smooth_column_is_small_and_a_clean_one_is_followed():
    t = uneven(4000)
    clean = np.sin(t / 20.0)
    noisy = clean + 0.01 * np.random.default_rng(2).standard_normal(4000)
    assert np.std(fit_smooth(t, noisy, np.ones(4000))(t) - clean) < 0.4 * 0.01
    assert np.abs(fit_smooth(t, clean, np.ones(4000))(t) - clean).max() < 1e-5


def test_bursts_of_samples_do_not_set_slopes():
    """Pairs a hundred-thousandth of a step apart, with noise: the curve between them is as quiet as they are."""
    t = np.repeat(np.arange(500.0), 2)
    t[1::2] += 1e-5
    y = 0.01 * np.random.default_rng(3).standard_normal(1000)
    assert np.abs(fit_smooth(t, y, np.ones(1000))(np.linspace(0.0, 499.0, 5000))).max() < 0.05


@pytest.mark.parametrize("at_the_end", [False, True])
def test_beyond_steps_that_grow_tenfold_as_a_solver_begins_the_curve_goes_on(at_the_end):
    t = np.concatenate([[0.0, 1e-4, 1e-3, 1e-2, 0.1], np.arange(1.0, 60.0)])
    y = np.cos(t / 4.0) + 1e-4 * np.random.default_rng(4).standard_normal(len(t))
    if at_the_end:
        t, y = (t[-1] - t)[::-1], y[::-1]
    there = np.array([-0.5, 0.0, 0.5]) if not at_the_end else t[-1] + np.array([-0.5, 0.0, 0.5])
    since = there if not at_the_end else t[-1] - there
    assert fit_smooth(t, y, np.ones(len(t)))(there) == pytest.approx(np.cos(since / 4.0), abs=0.02)


@pytest.mark.parametrize("count", range(16, 200, 2))
def test_knots_do_not_depend_on_the_unit_of_time(count):
    t, y = np.arange(count, dtype=float), np.random.default_rng(5).standard_normal(count)
    whole, *parts = (fit_smooth(unit * t, y, np.ones(count)).t / unit for unit in (1.0, 0.1, 0.01, 1.0 / 3.0))
    for knots in parts:
        assert knots == pytest.approx(whole)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_few_samples_have_a_line(count):
    t = uneven(count)
    spline = fit_smooth(t, 2.0 - 3.0 * t, np.ones(count))
    assert spline(t) == pytest.approx(2.0 - 3.0 * t)
    assert spline.derivative()(t) == pytest.approx(np.full(count, -3.0 if count > 1 else 0.0))
