from functools import cache

import numpy as np
import pytest
import scipy.fft
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from odescope.signals.cutoff import FixedCutoff, LeastRisk, NoiseCeiling
from odescope.signals.differentiators import Spectral
from odescope.signals.noise import MEDIAN_CHI_SQUARED, noise_level, noise_levels
from odescope.signals.spectral import Spectrum, bin_frequencies

# name: right-hand side, starts (one record each), duration, samples, order of the target
SYSTEMS = {
    "pendulum": (lambda t, s: [s[1], -9.0 * np.sin(s[0]) - 0.3 * s[1]], [(2.5, 4.0)], 20.0, 2000, 2),
    "van der Pol": (lambda t, s: [s[1], 3.0 * (1.0 - s[0] ** 2) * s[1] - s[0]], [(2.0, 0.0)], 20.0, 2000, 2),
    "Lorenz": (
        lambda t, s: [10.0 * (s[1] - s[0]), s[0] * (28.0 - s[2]) - s[1], s[0] * s[1] - 8.0 / 3.0 * s[2]],
        [(1.0, 1.0, 20.0), (-8.0, 7.0, 27.0)],
        4.0,
        1000,
        1,
    ),
    # Transients that start steeply and are flat for most of the record.
    "decay": (lambda t, s: [-8.0 * (s[0] - 0.2)], [(3.0,), (-1.0,)], 4.0, 800, 1),
    "Michaelis-Menten": (
        lambda t, s: [0.6 - 1.5 * s[0] / (0.3 + s[0])],
        [(3.0,), (2.0,), (1.0,), (0.05,)],
        5.0,
        500,
        1,
    ),
}
CASES = [
    ("pendulum", 0.001),
    ("pendulum", 0.01),
    ("van der Pol", 0.001),
    ("van der Pol", 0.05),
    ("Lorenz", 0.01),
    ("Lorenz", 0.05),
    ("decay", 0.01),
    ("decay", 0.05),
    ("Michaelis-Menten", 0.001),
    ("Michaelis-Menten", 0.05),
]


@cache
def simulated(name):
    """Return period, records of the first state, and its derivative of the target's order."""
    slope, starts, duration, count, order = SYSTEMS[name]
    t = np.linspace(0.0, duration, count)
    runs = [solve_ivp(slope, (0.0, duration), s, "DOP853", t, rtol=1e-10, atol=1e-10).y for s in starts]
    return t[1], [y[0] for y in runs], [np.asarray(slope(t, y)[order - 1]) for y in runs], order


def noisy(records, share, seed):
    """Add white noise of `share` of the records' standard deviation; return them and the noise's deviation."""
    rng = np.random.default_rng(seed)
    sigma = share * np.concatenate(records).std()
    return [r + sigma * rng.standard_normal(len(r)) for r in records], sigma


@pytest.mark.slow
@pytest.mark.parametrize(("name", "share"), CASES)
def test_least_risk_comes_close_to_the_best_cutoff_there_is(name, share):
    period, records, truth, order = simulated(name)
    inner = slice(len(truth[0]) // 20, -(len(truth[0]) // 20))

    def error(channel, hertz):
        found = Spectral(FixedCutoff(hertz)).derivatives(channel, period, order).values
        misses = [(f[order] - d)[inner] for f, d in zip(found, truth, strict=True)]
        return np.sqrt(np.mean(np.concatenate(misses) ** 2))

    ratios = []
    for seed in range(7):
        channel, _ = noisy(records, share, seed)
        grid = np.geomspace(1.0 / SYSTEMS[name][2], min(0.45 / period, 40.0), 30)
        ratios.append(error(channel, LeastRisk().hertz(channel, period, order)) / min(error(channel, h) for h in grid))
    # One draw in forty has a cluster of loud bins that no criterion on one record can tell from a signal.
    assert np.median(ratios) < 1.3
    assert np.quantile(ratios, 0.8) < 1.5


@pytest.mark.parametrize(("name", "share"), CASES)
def test_the_noise_is_found_within_five_per_cent(name, share):
    _, records, _, _ = simulated(name)
    ratios = []
    for seed in range(7):
        channel, sigma = noisy(records, share, seed)
        ratios.append(noise_level([Spectrum.of(s) for s in channel]) / sigma)
    # One record of 1 000 upper bins scatters by 1.17 / sqrt(1 000): the draws together tell a bias of 5 %.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_the_noise_of_one_long_record_is_found_within_five_per_cent():
    for seed in range(5):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(20_000)
        wave = np.sin(np.linspace(0.0, 60.0, 20_000))
        assert noise_level([Spectrum.of(wave + noise)]) == pytest.approx(0.3, rel=0.05)


# properties


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), exponent=st.integers(-20, 20), offset=st.floats(-5, 5))
def test_units_and_offsets_change_the_noise_in_proportion_and_the_cutoff_not_at_all(seed, exponent, offset):
    time = np.linspace(0.0, 6.0, 400)
    samples = np.sin(time) + 0.05 * np.random.default_rng(seed).standard_normal(400)
    scaled = 2.0**exponent * (samples + offset)
    level = noise_level([Spectrum.of(samples)])
    assert noise_level([Spectrum.of(scaled)]) == pytest.approx(2.0**exponent * level, rel=1e-7)
    for cutoff in (LeastRisk(), NoiseCeiling()):
        assert cutoff.hertz([scaled], 0.01, 2) == pytest.approx(cutoff.hertz([samples], 0.01, 2), rel=1e-12)


def test_a_clock_in_other_units_gives_the_cutoff_in_those():
    channel, _ = noisy(simulated("pendulum")[1], 0.01, 1)
    for cutoff in (LeastRisk(), NoiseCeiling()):
        assert cutoff.hertz(channel, 10.0, 2) * 1000.0 == pytest.approx(cutoff.hertz(channel, 0.01, 2), rel=1e-9)


@pytest.mark.parametrize("name", ["Lorenz", "Michaelis-Menten"])
def test_records_are_pooled_whatever_their_sequence_and_however_often_they_come(name):
    period, records, _, order = simulated(name)
    channel, _ = noisy(records, 0.02, 3)
    once = LeastRisk().hertz(channel, period, order)
    assert LeastRisk().hertz(channel[::-1], period, order) == pytest.approx(once, rel=1e-12)
    assert LeastRisk().hertz([*channel, *channel], period, order) == pytest.approx(once, rel=1e-12)
    spectra = [Spectrum.of(s) for s in channel]
    assert noise_level([*spectra, *spectra]) == pytest.approx(noise_level(spectra), rel=1e-12)


@pytest.mark.parametrize("times", [2.0, 4.0, 10.0])
@pytest.mark.parametrize("name", ["Lorenz", "Michaelis-Menten"])
def test_a_recording_that_is_noisier_than_another_has_a_noise_of_its_own(name, times):
    period, records, _, order = simulated(name)
    records = [r for r in records for _ in range(2)]
    sigma = 0.01 * np.concatenate(records).std()
    levels = np.tile([sigma, times * sigma], len(records) // 2)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        channel = [r + own * rng.standard_normal(len(r)) for r, own in zip(records, levels, strict=True)]
        found = noise_levels([Spectrum.of(s) for s in channel])
        assert np.abs(np.log(found / levels)).max() < np.log(1.3)
        assert np.mean(found / levels) == pytest.approx(1.0, abs=0.07)
        together = noise_level([Spectrum.of(s) for s in channel])
        assert together == pytest.approx(np.sqrt(np.mean(levels**2)), rel=0.2)
        # The noise of the louder one is not taken for a signal, whatever the other one's is.
        loud = [r + times * sigma * rng.standard_normal(len(r)) for r in records]
        assert LeastRisk().hertz(channel, period, order) < 3.0 * LeastRisk().hertz(loud, period, order)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("highest", [20, 40, 150])
def test_least_risk_cuts_above_all_that_stands_out_of_the_noise_and_not_far_above(order, highest):
    count, period = 1200, 0.01
    phase = np.pi * (np.arange(count) + 0.5) / count
    wave = np.sum([np.cos(v * phase) for v in range(1, highest + 1)], axis=0)
    for seed in range(6):
        # A cosine of amplitude 1 has power count / 2 in its bin, 600 times that of this noise squared.
        samples = wave + np.random.default_rng(seed).standard_normal(count)
        hertz = LeastRisk().hertz([samples], period, order)
        frequency = bin_frequencies(count, period)
        assert frequency[highest] <= hertz * (1 + 1e-12)
        assert hertz <= 1.15 * frequency[highest]


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("far", [120, 201])
def test_a_far_line_is_kept_where_it_outweighs_the_noise_up_to_it(order, far):
    # A spectrum by hand: a strong band, noise of variance exactly 1, and one line. Keeping the line costs the noise
    # between, sum of w^2k, and gains its own power; the walk in bands charges it the noise to the end of its band too.
    rng = np.random.default_rng(order)
    bins = np.arange(1000)
    between = np.sum((bins[11:far] / far) ** (2 * order))
    for share, expected in ((0.8, 10), (2.0, far)):
        size = np.where(bins < 500, 1.0, np.sqrt(MEDIAN_CHI_SQUARED))
        size[1:11], size[far] = 100.0, np.sqrt(2.0 + share * between)
        samples = scipy.fft.idct(size * rng.choice([-1.0, 1.0], 1000), norm="ortho")
        hertz = LeastRisk().hertz([samples], 0.01, order)
        assert hertz == pytest.approx(bin_frequencies(1000, 0.01)[expected], rel=1e-9)


def test_noise_alone_is_cut_at_the_bottom():
    for seed in range(10):
        noise = np.random.default_rng(seed).standard_normal(1000)
        assert LeastRisk().hertz([noise], 0.01, 2) < 1.0  # of 50 hertz


# the paper's noise ceiling and the fixed cutoff


def tone(hertz, seed):
    time = 0.01 * np.arange(4096)
    return np.sin(2.0 * np.pi * hertz * time) + 0.1 * np.random.default_rng(seed).standard_normal(4096)


@pytest.mark.parametrize("hertz", [2.0, 7.5, 20.0])
def test_noise_ceiling_finds_the_edge_of_a_band(hertz):
    # A band filled up to its edge: the smoothed periodogram first drops to the ceiling just above it.
    rng = np.random.default_rng(4)
    time = 0.01 * np.arange(4096)
    tones = np.arange(0.05, hertz, 0.05)
    band = np.sum([np.sin(2.0 * np.pi * f * time + rng.uniform(0, 6.28)) for f in tones], axis=0)
    found = NoiseCeiling().hertz([band + 0.1 * rng.standard_normal(4096)], 0.01, 2)
    assert hertz - 0.05 <= found <= hertz + 0.3


def test_the_offset_of_the_noise_ceiling_is_taken_off_down_to_the_first_bin():
    channel = [tone(0.05, 5)]
    plain = NoiseCeiling().hertz(channel, 0.01, 2)
    assert NoiseCeiling(offset=0.1 * plain).hertz(channel, 0.01, 2) == pytest.approx(0.9 * plain, rel=1e-12)
    assert NoiseCeiling(offset=1e3).hertz(channel, 0.01, 2) == pytest.approx(1.0 / (4096 * 0.01), rel=1e-12)


def test_a_higher_ceiling_never_cuts_higher():
    channel, _ = noisy(simulated("van der Pol")[1], 0.01, 2)
    found = [NoiseCeiling(z=z).hertz(channel, 0.01, 2) for z in (0.5, 1.0, 2.0, 4.0, 8.0, 64.0)]
    assert found == sorted(found, reverse=True)
    assert found[0] > found[-1]


def test_a_fixed_cutoff_stays_below_half_the_sampling_rate():
    assert FixedCutoff(3.0).hertz([np.zeros(100)], 0.01, 2) == 3.0
    assert FixedCutoff(80.0).hertz([np.zeros(100)], 0.01, 2) == pytest.approx(47.5)
