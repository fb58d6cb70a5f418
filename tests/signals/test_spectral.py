import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial, legendre

from odescope.signals.spectral import Spectrum, bin_frequencies, differentiate

PERIOD = 0.02


def wobbly(count, seed=0):
    """A record with a trend, slopes at both ends and noise: everything that a derivative filter meets."""
    time = PERIOD * np.arange(count)
    noise = 0.05 * np.random.default_rng(seed).standard_normal(count)
    return 2.0 + 0.7 * time - 0.3 * time**2 + np.sin(5.0 * time + 0.4) + noise


def mirrored_fft(samples, period, cutoff, order):
    """The derivative as (17) to (21) spell it, by a complex FFT of [x, reversed x]."""
    count = len(samples)
    transform = np.fft.fft(np.concatenate([samples, samples[::-1]]))
    wavenumber = np.round(np.fft.fftfreq(2 * count) * 2 * count)
    transform[np.abs(wavenumber) > cutoff] = 0.0
    omega = 2.0 * np.pi * wavenumber / (2 * count * period)
    return np.fft.ifft(transform * (1j * omega) ** order).real[:count]


def cosines(count, cutoff, order):
    """The k-th derivatives of the cosines of the grid, (count, cutoff + 1), written out."""
    omega = np.pi * np.arange(cutoff + 1) / (count * PERIOD)
    phase = np.outer(PERIOD * (np.arange(count) + 0.5), omega)
    wave = (np.cos, lambda a: -np.sin(a), lambda a: -np.cos(a), np.sin)[order % 4]
    return omega**order * wave(phase)


# oracles


@pytest.mark.parametrize("count", [200, 201])
@pytest.mark.parametrize("cutoff", [1, 12, 60, 150])
def test_derivatives_are_those_of_the_mirrored_fft_plus_the_cubics(count, cutoff):
    samples = wobbly(count)
    found = differentiate(samples, PERIOD, cutoff, 4)
    cubic = legendre.Legendre(np.append(0.0, Spectrum.of(samples).cubic(cutoff)), [0.0, (count - 1) * PERIOD])
    time = PERIOD * np.arange(count)
    for order in range(5):
        trend = cubic.deriv(order)(time) if order else cubic(time)
        expected = mirrored_fft(samples - cubic(time), PERIOD, cutoff, order) + trend
        assert found[order] == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("cutoff", [0, 3, 10, 25])
def test_filter_is_the_least_squares_fit_of_the_cosines_and_a_cubic(cutoff):
    samples = wobbly(300)
    time = PERIOD * np.arange(300)
    powers = [Polynomial.basis(p, domain=[0.0, time[-1]]) for p in (1, 2, 3)]
    design = np.column_stack([cosines(300, cutoff, 0), *(p(time) for p in powers)])
    weights = np.linalg.lstsq(design, samples, rcond=None)[0]
    found = differentiate(samples, PERIOD, cutoff, 3)
    for order in range(4):
        trends = [p.deriv(order)(time) if order else p(time) for p in powers]
        expected = np.column_stack([cosines(300, cutoff, order), *trends]) @ weights
        assert found[order] == pytest.approx(expected, abs=1e-7 * np.abs(expected).max())


def test_bins_are_the_frequencies_of_the_mirrored_record():
    for count in (7, 64):
        assert bin_frequencies(count, PERIOD) == pytest.approx(np.fft.rfftfreq(2 * count, PERIOD)[:count], rel=1e-14)


def test_the_cubic_leaves_less_energy_above_the_cutoff_than_its_neighbours():
    spectrum = Spectrum.of(wobbly(400))
    best = spectrum.cubic(30)
    tail = slice(31, 400)
    least = spectrum.power(best, tail).sum()
    for k in range(3):
        for step in (-0.01, 0.01):
            assert spectrum.power(best + step * np.eye(3)[k], tail).sum() > least


def test_cubics_of_many_cutoffs_are_those_of_each():
    spectrum = Spectrum.of(wobbly(257))
    cutoffs = [0, 1, 1, 9, 40, 200, 250]
    together = spectrum.cubics(cutoffs)
    for cutoff, cubic in zip(cutoffs, together, strict=True):
        # Far up the cubic is poorly determined; what it leaves there is not.
        tail = slice(cutoff + 1, 257)
        assert spectrum.power(cubic, tail).sum() == pytest.approx(
            spectrum.power(spectrum.cubic(cutoff), tail).sum(), rel=1e-9
        )


def test_power_sums_to_the_energy_of_the_record():
    samples = wobbly(150)
    total = Spectrum.of(samples).power(np.zeros(3), slice(0, 150)).sum()
    assert total == pytest.approx((samples**2).sum(), rel=1e-13)


# exactness


@pytest.mark.parametrize("count", [128, 129])
@pytest.mark.parametrize("wavenumber", [1, 2, 7, 20])
def test_cosines_of_the_grid_are_differentiated_exactly(count, wavenumber):
    samples = cosines(count, wavenumber, 0)[:, wavenumber]
    found = differentiate(samples, PERIOD, 20, 5)
    for order in range(6):
        expected = cosines(count, wavenumber, order)[:, wavenumber]
        scale = (np.pi * 20 / (count * PERIOD)) ** order
        assert found[order] == pytest.approx(expected, abs=1e-9 * scale)


@pytest.mark.parametrize("cutoff", [0, 1, 5, 20])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_cubics_are_differentiated_exactly(cutoff, degree):
    time = np.linspace(-1.0, 1.0, 250)
    polynomial = Polynomial([0.4, -1.1, 0.8, 1.7][: degree + 1])
    found = differentiate(polynomial(time), time[1] - time[0], cutoff, 4)
    for order in range(5):
        expected = polynomial.deriv(order)(time) if order else polynomial(time)
        scale = (np.pi * max(cutoff, 1) / 2.0) ** order
        assert found[order] == pytest.approx(expected, abs=1e-8 * scale)


def test_cosines_above_the_cutoff_are_taken_out_where_no_cubic_meets_them():
    # Two cosines far above the cutoff look like no cubic; what leaks into the fit is the cubic's own tail there.
    count = 2000
    high = cosines(count, 900, 0)[:, 900]
    assert np.sqrt(np.mean(differentiate(high, PERIOD, 30, 0)[0] ** 2)) < 1e-3


# properties


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(30, 300),
    share=st.floats(0.0, 0.5),
    weights=st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
)
def test_linearity(seed, count, share, weights):
    first, second = np.random.default_rng(seed).standard_normal((2, count))
    cutoff = int(share * count)
    combined = differentiate(weights[0] * first + weights[1] * second, 1.0, cutoff, 3)
    apart = [differentiate(s, 1.0, cutoff, 3) for s in (first, second)]
    scale = max(np.abs(a).max() for a in apart)
    assert combined == pytest.approx(weights[0] * apart[0] + weights[1] * apart[1], abs=1e-8 * scale)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(30, 300), share=st.floats(0.0, 0.4))
def test_filtering_twice_changes_nothing(seed, count, share):
    cutoff = int(share * count)
    once = differentiate(wobbly(count, seed), PERIOD, cutoff, 0)[0]
    twice = differentiate(once, PERIOD, cutoff, 0)[0]
    assert twice == pytest.approx(once, abs=1e-7)


@pytest.mark.parametrize("cutoff", [2, 10, 40])
def test_second_derivative_of_the_second_derivative_is_the_fourth(cutoff):
    # The second derivative of cosines and a cubic is again cosines and a line.
    samples = wobbly(320)
    twice = differentiate(differentiate(samples, PERIOD, cutoff, 2)[2], PERIOD, cutoff, 2)[2]
    fourth = differentiate(samples, PERIOD, cutoff, 4)[4]
    assert twice == pytest.approx(fourth, abs=1e-6 * np.abs(fourth).max())


@pytest.mark.parametrize("count", [150, 151])
def test_time_reversed_turns_the_sign_of_odd_derivatives(count):
    samples = wobbly(count)
    forth = differentiate(samples, PERIOD, 15, 3)
    back = differentiate(samples[::-1].copy(), PERIOD, 15, 3)
    for order in range(4):
        scale = np.abs(forth[order]).max()
        assert back[order, ::-1] == pytest.approx((-1.0) ** order * forth[order], abs=1e-9 * scale)


def test_a_slower_clock_divides_each_derivative_by_its_power():
    samples = wobbly(100)
    fast, slow = (differentiate(samples, period, 12, 3) for period in (PERIOD, 8.0 * PERIOD))
    assert slow * 8.0 ** np.arange(4)[:, None] == pytest.approx(fast, rel=1e-12, abs=1e-10)


@pytest.mark.parametrize("count", [16, 33, 64, 101])
def test_the_filter_takes_no_more_than_the_energy_above_the_cutoff(count):
    samples = wobbly(count)
    power = Spectrum.of(samples).power(np.zeros(3), slice(0, count))
    for cutoff in range(count):
        taken = np.sum((samples - differentiate(samples, PERIOD, cutoff, 0)[0]) ** 2)
        assert taken <= power[cutoff + 1 :].sum() * (1 + 1e-9) + 1e-18 * power.sum()


@pytest.mark.parametrize("count", [16, 33, 64, 101])
def test_a_cutoff_near_half_the_sampling_rate_stays_bounded(count):
    # Too few bins are left there to fit a cubic; rounding once made one of 1e15.
    samples = wobbly(count)
    energy = np.sum(samples**2)
    for cutoff in range(count - 4, count):
        slopes = differentiate(samples, PERIOD, cutoff, 1)[1]
        assert np.sum(slopes**2) <= (np.pi / PERIOD) ** 2 * energy
