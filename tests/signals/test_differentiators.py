import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from odescope.errors import InputError
from odescope.signals.cutoff import FixedCutoff, LeastRisk
from odescope.signals.differentiators import SavitzkyGolay, SmoothingSpline, Spectral

PERIOD = 0.02


def grid_cosine(count, hertz, order=0):
    """A cosine of the mirrored grid of `count` samples, or one of its derivatives."""
    wavenumber = hertz * 2 * count * PERIOD
    assert wavenumber == pytest.approx(round(wavenumber))
    phase = 2.0 * np.pi * hertz * PERIOD * (np.arange(count) + 0.5)
    return (2.0 * np.pi * hertz) ** order * np.cos(phase + order * np.pi / 2.0)


# spectral


def test_records_of_different_lengths_are_cut_at_the_same_frequency():
    low, edge, above = 1.0, 2.0, 2.5
    lengths = (200, 500, 1000)
    spectral = Spectral(FixedCutoff(edge))
    kept = spectral.derivatives([grid_cosine(n, low) + grid_cosine(n, edge) for n in lengths], PERIOD, 2).values
    for n, values in zip(lengths, kept, strict=True):
        for order in range(3):
            expected = grid_cosine(n, low, order) + grid_cosine(n, edge, order)
            assert values[order] == pytest.approx(expected, abs=1e-8 * (4 * np.pi) ** order)
    taken = spectral.derivatives([grid_cosine(n, above) for n in lengths], PERIOD, 0).values
    for values in taken:
        # What is left of it is what a cubic takes up.
        assert np.sqrt(np.mean(values[0] ** 2)) < 0.35


def test_spectral_reports_the_cutoff_it_used_and_the_noise_it_met():
    rng = np.random.default_rng(0)
    records = [np.sin(PERIOD * np.arange(n)) + 0.1 * rng.standard_normal(n) for n in (3000, 5000)]
    found = Spectral().derivatives(records, PERIOD, 2)
    assert found.cutoff == LeastRisk().hertz(records, PERIOD, 2)
    assert found.noise == pytest.approx(0.1, rel=0.05)


def test_a_record_is_filtered_as_it_would_be_alone():
    rng = np.random.default_rng(2)
    records = [np.cumsum(rng.standard_normal(n)) for n in (150, 400)]
    spectral = Spectral(FixedCutoff(1.3))
    together = spectral.derivatives(records, PERIOD, 2).values
    for samples, values in zip(records, together, strict=True):
        assert np.array_equal(spectral.derivatives([samples], PERIOD, 2).values[0], values)


# smoothing spline


def test_a_straight_line_has_no_bend_to_smooth():
    time = PERIOD * np.arange(80)
    for smoothing in (None, 1e-3, 10.0):
        values = SmoothingSpline(smoothing).derivatives([3.0 - 2.0 * time], PERIOD, 2).values[0]
        assert values[0] == pytest.approx(3.0 - 2.0 * time, abs=1e-7)
        assert values[1] == pytest.approx(np.full(80, -2.0), abs=1e-6)


def test_without_smoothing_it_is_the_natural_cubic_spline():
    samples = np.random.default_rng(1).standard_normal(60)
    time = PERIOD * np.arange(60)
    oracle = CubicSpline(time, samples, bc_type="natural")
    values = SmoothingSpline(0.0).derivatives([samples], PERIOD, 2).values[0]
    for order in range(3):
        expected = oracle(time, order)
        assert values[order] == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_cross_validation_chooses_a_smoothing_near_the_best():
    time = PERIOD * np.arange(400)
    rng = np.random.default_rng(5)
    samples = np.sin(2.0 * time) + 0.05 * rng.standard_normal(400)

    def error(smoothing):
        found = SmoothingSpline(smoothing).derivatives([samples], PERIOD, 1)
        return np.sqrt(np.mean((found.values[0][1] - 2.0 * np.cos(2.0 * time)) ** 2))

    assert error(None) < 1.5 * min(error(s) for s in np.geomspace(1e-8, 1.0, 30))
    assert SmoothingSpline().derivatives([samples], PERIOD, 1).noise == pytest.approx(0.05, rel=0.1)


# Savitzky-Golay


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_local_polynomials_reproduce_polynomials_of_their_degree_up_to_the_ends(degree):
    time = np.linspace(-1.0, 1.0, 101)
    polynomial = np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.7, -1.4][: degree + 1])
    values = SavitzkyGolay(15, degree).derivatives([polynomial(time)], 0.02, 2).values[0]
    for order in range(3):
        expected = polynomial.deriv(order)(time) if order else polynomial(time)
        assert values[order] == pytest.approx(expected, abs=1e-8)


def test_local_polynomials_are_those_of_polyfit():
    samples = np.random.default_rng(3).standard_normal(90)
    values = SavitzkyGolay(21, 4).derivatives([samples], PERIOD, 2).values[0]
    for centre in (10, 40, 79):
        window = slice(centre - 10, centre + 11)
        fit = np.polynomial.Polynomial.fit(PERIOD * np.arange(-10, 11), samples[window], 4)
        for order in range(3):
            expected = fit.deriv(order)(0.0) if order else fit(0.0)
            assert values[order][centre] == pytest.approx(expected, rel=1e-8)


def test_savitzky_golay_finds_the_noise_that_its_windows_average_out():
    rng = np.random.default_rng(7)
    records = [np.sin(PERIOD * np.arange(n)) + 0.2 * rng.standard_normal(n) for n in (4000, 6000)]
    # A fit of 4 parameters to 101 samples takes about 2 % of the variance with it.
    assert SavitzkyGolay(101, 3).derivatives(records, PERIOD, 1).noise == pytest.approx(0.2, rel=0.04)


@pytest.mark.parametrize(
    ("window", "degree", "order"), [(5, 5, 1), (4, 4, 2), (7, 1, 2), (31, 3, 1)], ids=["full", "even", "order", "long"]
)
def test_windows_that_determine_no_derivative_are_refused(window, degree, order):
    with pytest.raises(
        InputError, match=rf"order <= degree < window <= samples; these are {order}, {degree}, {window}"
    ):
        SavitzkyGolay(window, degree).derivatives([np.zeros(100), np.zeros(30)], PERIOD, order)


# what filters without a cutoff of their own report


@pytest.mark.parametrize("differentiator", [SavitzkyGolay(15, 4), SmoothingSpline(1e-9)])
@pytest.mark.parametrize("hertz", [0.5, 2.0, 5.0])
def test_the_reported_cutoff_is_that_of_the_highest_derivative(differentiator, hertz):
    time = PERIOD * np.arange(1000)
    found = differentiator.derivatives([np.sin(2.0 * np.pi * hertz * time)], PERIOD, 1)
    # The window widens a line by two bins.
    assert hertz <= found.cutoff <= hertz + 2.0 / (1000 * PERIOD) + 1e-12


@pytest.mark.parametrize("differentiator", [Spectral(), SavitzkyGolay(31, 4), SmoothingSpline()])
def test_every_differentiator_recovers_a_velocity_from_noisy_positions(differentiator):
    time = PERIOD * np.arange(500)
    rng = np.random.default_rng(11)
    records = [np.sin(1.5 * time + p) + 0.01 * rng.standard_normal(500) for p in (0.0, 1.0)]
    found = differentiator.derivatives(records, PERIOD, 1).values
    plain = np.sqrt(np.mean((np.gradient(records[0], PERIOD) - 1.5 * np.cos(1.5 * time))[25:-25] ** 2))
    for values, p in zip(found, (0.0, 1.0), strict=True):
        error = np.sqrt(np.mean((values[1] - 1.5 * np.cos(1.5 * time + p))[25:-25] ** 2))
        assert error < plain / 8.0
