import itertools

import numpy as np
import pytest
from scipy.integrate import quad

from odescope.likelihood.sampled_inputs import SampledInputs, _parabola
from odescope.likelihood.segments import cut_segments
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.estimate import Channel, Signals
from odescope.signals.spectral import bin_frequencies, differentiate

PERIOD = 0.002


def record(t, noise=0.0, seed=0, hold_u=None):
    x = np.sin(2 * np.pi * 1.3 * t) + 0.5 * np.cos(2 * np.pi * 0.37 * t + 1) + 0.3 * t
    u = np.cos(2 * np.pi * 0.9 * t) if hold_u is None else hold_u
    rng = np.random.default_rng(seed)
    return Record(t, np.column_stack([x + noise * rng.standard_normal(len(t)), u]), ("x", "u"))


def cut(runs, noise=1e-3, cutoff=4.0, hold="linear", white=1.0):
    channel = Channel("x", noise, cutoff, white=white)
    found = Signals((), (), (), PERIOD, (channel,), (Coordinate("x", 2),), (Input("u", hold),))
    return cut_segments(Records(tuple(runs)), found, Spectral())


def centres(data, first=0.0):
    return first + PERIOD * ((data.block - 1) / 2 + data.block * np.arange(len(data.measured)))


def test_averages_without_noise_are_the_exact_values_at_the_centres():
    t = PERIOD * np.arange(6001)
    data = cut([record(t)])
    at = centres(data)
    exact = record(at).values[:, 0]
    plain = record(t).values[: len(at) * data.block, 0].reshape(-1, data.block).mean(axis=1)
    inner = (at > 1.0) & (at < at[-1] - 1.0)
    assert data.block >= 11
    assert np.abs(plain - exact)[inner].max() > 1e-3
    assert np.abs(data.measured[:, 0] - exact)[inner].max() < 1e-5
    assert np.abs(data.measured[:, 0] - exact).max() < 1e-3


def test_averages_carry_white_noise_of_the_stated_size():
    t = PERIOD * np.arange(40001)
    data = cut([record(t, 0.05)], noise=0.05)
    error = data.measured[:, 0] - record(centres(data)).values[:, 0]
    assert np.std(error) == pytest.approx(data.noise[0], rel=0.06)
    assert data.noise[0] == pytest.approx(0.05 / np.sqrt(data.block))
    # The filtered signal's error cancels over a block, so neighbours are not correlated.
    assert abs(np.corrcoef(error[:-1], error[1:])[0, 1]) < 0.1


@pytest.mark.parametrize(("cutoff", "eight", "samples"), [(20.0, 3, 5), (8.0, 7, 9), (60.0, 1, 1)])
def test_averages_are_over_what_a_sensor_smoothed_but_at_least_four_a_period(cutoff, eight, samples):
    runs = [record(PERIOD * np.arange(4001))]
    assert cut(runs, cutoff=cutoff).block == eight
    assert cut(runs, cutoff=cutoff, white=0.11).block == samples
    assert cut(runs, cutoff=cutoff, white=0.11, hold="zero").block == 1


def test_averages_of_smoothed_noise_have_white_noise_of_the_density_below_its_corner():
    t, rng = PERIOD * np.arange(40_001), np.random.default_rng(4)
    smoothed = np.convolve(rng.standard_normal(len(t)), np.full(9, 1.0 / 9.0), "same")
    runs = [Record(t, record(t).values + np.outer(0.05 * smoothed, [1.0, 0.0]), ("x", "u"))]
    data = cut(runs, noise=0.05, cutoff=10.0, white=0.11)
    error = data.measured[:, 0] - record(centres(data)).values[:, 0]
    assert abs(np.corrcoef(error[:-1], error[1:])[0, 1]) < 0.25
    plain = cut(runs, noise=0.05, cutoff=25.0)
    rest = plain.measured[:, 0] - record(centres(plain)).values[:, 0]
    assert np.corrcoef(rest[:-1], rest[1:])[0, 1] > 0.5


def test_spread_is_the_scatter_of_filtered_white_noise():
    count, cutoff = 20001, 4.0
    data = cut([record(PERIOD * np.arange(count))], noise=0.05, cutoff=cutoff)
    noise = 0.05 * np.random.default_rng(3).standard_normal(count)
    last = int(np.searchsorted(bin_frequencies(count, PERIOD), cutoff, "right")) - 1
    values = differentiate(noise, PERIOD, last, 1)
    for k in range(2):
        assert np.std(values[k][2000:-2000]) == pytest.approx(data.spread[k], rel=0.15)


def test_segments_cover_every_record_and_never_cross_from_one_to_the_next():
    runs = [record(PERIOD * np.arange(n) + first) for n, first in ((2001, 0.0), (3500, 10.0), (900, 40.0))]
    data = cut(runs)
    ends = np.cumsum([len(r) // data.block for r in runs])
    assert data.start[0] == 0
    assert np.array_equal(data.start[1:], (data.start + data.count)[:-1])
    assert data.start[-1] + data.count[-1] == ends[-1]
    assert sorted((data.start + data.count)[~data.joined]) == sorted(ends)
    np.testing.assert_array_equal(data.initial, data.filtered[data.start])
    single = [cut([r]) for r in runs]
    assert {s.block for s in single} == {data.block}
    np.testing.assert_allclose(data.measured, np.concatenate([s.measured for s in single]))
    np.testing.assert_allclose(data.inputs, np.concatenate([s.inputs for s in single]))


@pytest.mark.parametrize("block", [1, 2, 5, 12])
@pytest.mark.parametrize("hold", ["linear", "zero"])
@pytest.mark.parametrize("late", [0.0, 0.3, 0.97])
def test_the_parabola_is_the_least_squares_one(block, hold, late):
    samples = np.random.default_rng(block).standard_normal(block + 2)

    def value(s):
        k = min(int(s - late + 1), block)
        return samples[k] + (s - late + 1 - k) * (samples[k + 1] - samples[k]) * (hold == "linear")

    s = np.unique([0.0, *np.arange(block + 1.0), *(np.arange(block) + late)])
    gram = np.array([[block ** (i + j + 1) / (i + j + 1) for j in range(3)] for i in range(3)])
    right = [
        sum(
            quad(lambda s, i=i: s**i * value(s), a + 1e-12, b - 1e-12, epsabs=1e-13)[0]
            for a, b in itertools.pairwise(s)
        )
        for i in range(3)
    ]
    nearest = np.polynomial.Polynomial(np.linalg.solve(gram, right))
    nodes = _parabola(block, hold == "zero", late) @ samples
    np.testing.assert_allclose(nodes, nearest(np.array([0.0, 0.5, 1.0]) * block), rtol=1e-6, atol=1e-8)
    middle = 0.5 * (s[:-1] + s[1:])
    mean = sum(value(m) * d for m, d in zip(middle, np.diff(s), strict=True)) / block
    assert nodes @ [1 / 6, 4 / 6, 1 / 6] == pytest.approx(mean, abs=1e-12)


def test_the_parabola_reproduces_lines_exactly_and_parabolas_to_the_error_of_linear_interpolation():
    for block in (1, 3, 10):
        s = np.arange(-1.0, block + 1)
        at = np.array([0.0, 0.5, 1.0]) * block
        np.testing.assert_allclose(_parabola(block, False, 0.0) @ (2 - 3 * s), 2 - 3 * at, atol=1e-12 * block)
        # Between samples linear interpolation of s^2 is too high by 1/6 on average.
        shift = _parabola(block, False, 0.0) @ s**2 - at**2
        assert shift @ [1 / 6, 4 / 6, 1 / 6] == pytest.approx(1 / 6, abs=1e-11)
        assert np.abs(shift).max() < 0.3
    np.testing.assert_allclose(_parabola(1, True, 0.0) @ [9.0, 2.0, 5.0], 2.0)
    np.testing.assert_allclose(_parabola(1, False, 0.0) @ [9.0, 2.0, 5.0], [2.0, 3.5, 5.0])


def test_inputs_are_those_of_the_step_from_centre_to_centre():
    data = cut([record(PERIOD * np.arange(4001))])
    at = centres(data)[:-1, None] + np.array([0.0, 0.5, 1.0]) * data.step
    np.testing.assert_allclose(data.inputs[:-1, :, 0], np.cos(2 * np.pi * 0.9 * at), atol=1e-3)


@pytest.mark.parametrize("delay", [0.0037, -0.0112, 0.25])
def test_late_inputs_are_those_of_so_much_earlier_and_gain_what_their_slope_says(delay):
    data = cut([record(PERIOD * np.arange(4001))])
    inside = slice(30, -30)
    at = centres(data)[inside, None] + np.array([0.0, 0.5, 1.0]) * data.step - delay
    late = data.late([delay])[0][inside]
    np.testing.assert_allclose(late[:, :, 0], np.cos(2 * np.pi * 0.9 * at), atol=1e-3)
    np.testing.assert_allclose(late[:, :, 1], 1.8 * np.pi * np.sin(2 * np.pi * 0.9 * at), atol=0.02)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_delay_beyond_the_record_is_one_of_its_end(sign):
    data = cut([record(PERIOD * np.arange(401))])
    nodes, _ = data.late([sign * 1e30])
    beyond = data.driven.samples[0 if sign > 0.0 else -1, 0]
    np.testing.assert_allclose(nodes, np.broadcast_to([beyond, 0.0], nodes.shape), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("block", "late"), [(1, 0.0), (1, 0.37), (1, -2.6), (3, 0.0), (5, 1.45)])
def test_nodes_of_a_band_limited_input_are_those_of_its_fourier_series(block, late):
    count, rng = 600, np.random.default_rng(block)
    numbers = np.arange(1, 220)  # of the lines, up to 0.73 of half the sampling rate
    weights = rng.standard_normal((2, len(numbers))) / np.sqrt(len(numbers))

    def u(at):
        phase = 2.0 * np.pi * np.multiply.outer(at, numbers) / count
        return np.cos(phase) @ weights[0] + np.sin(phase) @ weights[1]

    at = 100 + np.arange(0, 400, block)
    whole = np.zeros(len(at), dtype=np.int64)
    samples = u(np.arange(count))[:, None]
    nodes = SampledInputs(samples, ("band-limited",), at, whole, whole + count - 1, block, PERIOD).nodes([late])
    points, share = np.polynomial.legendre.leggauss(12 * block)
    values = u(at[:, None] + 0.5 * block * (points + 1.0) - late)
    powers = np.polynomial.legendre.legvander(points, 2)
    nearest = (values * share) @ powers * np.array([0.5, 1.5, 2.5])
    expected = nearest @ np.polynomial.legendre.legvander(np.array([-1.0, 0.0, 1.0]), 2).T
    np.testing.assert_allclose(nodes[:, :, 0], expected, atol=0.01)
    linear = SampledInputs(samples, ("linear",), at, whole, whole + count - 1, block, PERIOD).nodes([late])
    assert np.abs(linear[:, :, 0] - expected).max() > 0.2


def test_a_late_held_input_keeps_its_mean_over_every_step():
    t = PERIOD * np.arange(1001)
    held = np.repeat(np.random.default_rng(2).standard_normal(101), 10)[: len(t)]
    data = cut([record(t, hold_u=held)], hold="zero")
    mean = data.late([0.4 * PERIOD])[0][1:-1, :, 0] @ [1 / 6, 4 / 6, 1 / 6]
    np.testing.assert_allclose(mean, 0.4 * held[:-2] + 0.6 * held[1:-1], atol=1e-12)


def test_a_held_input_is_not_averaged():
    t = PERIOD * np.arange(1001)
    held = np.repeat(np.random.default_rng(2).standard_normal(101), 10)[: len(t)]
    data = cut([record(t, hold_u=held)], hold="zero")
    assert data.block == 1
    np.testing.assert_allclose(data.inputs[:-1, :, 0], np.repeat(held[:-1, None], 3, axis=1), atol=1e-12)


def test_the_same_averages_are_cut_into_shorter_segments():
    data = cut([record(PERIOD * np.arange(6001)), record(PERIOD * np.arange(3001))])
    short = data.cut_anew(6)
    assert short.measured is data.measured
    assert set(short.count) <= {5, 6, 7}
    assert short.count.sum() == data.count.sum()
    assert np.count_nonzero(~short.joined) == np.count_nonzero(~data.joined) == 2


def thinned(run, missing, doubled=()):
    """The record with samples that were not measured: their values are wrong, as those of a filling might be."""
    counts, values = np.ones((len(run), 2)), run.values.copy()
    counts[missing, 0], counts[doubled, 0] = 0.0, 2.0
    return Record(run.t, values, run.names, counts=counts)


def test_averages_of_fewer_samples_scatter_as_their_weights_say():
    """Over many records: noise / weight is the scatter about the truth, whatever share of a block was measured."""
    t, rng = PERIOD * np.arange(4001), np.random.default_rng(5)
    missing, errors = np.flatnonzero(rng.random(len(t)) < 0.4), []
    filled = record(t).values[missing, 0]
    for seed in range(60):
        run = record(t, 0.05, seed)
        values = run.values.copy()
        values[missing, 0] = filled
        data = cut([thinned(Record(t, values, run.names), missing)], noise=0.05)
        errors.append((data.measured - record(centres(data)).values[:, :1]) * data.weight)
    assert data.weight.min() < 0.6 < 0.9 < data.weight.max()
    scatter = np.std(errors, axis=0)[5:-5] / data.noise[0]
    assert scatter.mean() == pytest.approx(1.0, abs=0.03)
    few = data.weight[5:-5] < np.median(data.weight)
    assert scatter[few].mean() == pytest.approx(scatter[~few].mean(), abs=0.06)


def test_counts_of_one_throughout_are_as_no_counts():
    run = record(PERIOD * np.arange(2001), 0.01)
    bare, counted = cut([run]), cut([thinned(run, [])])
    assert counted.weight is None
    assert np.array_equal(bare.measured, counted.measured)


def test_a_mean_of_two_counts_twice():
    data = cut([thinned(record(PERIOD * np.arange(2001)), [], doubled=range(100, 100 + 2 * 11))])
    assert data.weight.max() ** 2 == pytest.approx(2.0, abs=1e-12)


@pytest.mark.parametrize(("length", "least"), [(1, 1), (2, 2), (6, 4), (25, 4)])
def test_every_segment_holds_measured_averages_enough(length, least):
    run = record(PERIOD * np.arange(9001))
    missing = np.concatenate([np.arange(700, 3000), np.arange(3011, 3300), np.arange(8700, 9001)])
    data = cut([thinned(run, missing), run]).cut_anew(length)
    there = data.weight[:, 0] > 0.0
    held = [there[s : s + n].sum() for s, n in zip(data.start, data.count, strict=True)]
    assert min(held) >= least
    assert np.median(held) == length
    assert data.samples == there.sum()
    assert np.array_equal(data.start[1:], (data.start + data.count)[:-1])
    assert data.count.sum() == len(data.measured)
    assert np.flatnonzero(~data.joined).tolist() == [np.searchsorted(data.start, data.runs[1][0]) - 1, len(held) - 1]
