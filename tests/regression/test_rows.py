from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.recordings.coordinate import Coordinate
from odescope.regression.factor import factorise
from odescope.regression.rows import FOLDS, CosineRows, NoiseWeighted, PlainRows, cut_blocks
from odescope.signals.estimate import Channel, Signals

repeatable = settings(derandomize=True, deadline=None, max_examples=60)


def signals_of(columns, period=0.01, cutoffs=(5.0,)):
    """Signals of one first-order coordinate, straight from arrays of x and x_dot."""
    channels = tuple(Channel("x", 0.1, cutoff) for cutoff in cutoffs)
    names, coordinates = ("x", "x_dot"), (Coordinate("x"),)
    return Signals(names, tuple(columns), (0.0,) * len(columns), period, channels, coordinates, ())


def cosine_rows(cutoff=5.0, period=0.01, frequency=(0.0, 100.0), weight=(1.0, 1.0)):
    return CosineRows(period, cutoff, np.array(frequency), np.array(weight))


def colored(rng, count, period, deviation):
    """Noise whose cosine at frequency f has the standard deviation `deviation(f)`."""
    from scipy.fft import idct

    return idct(rng.standard_normal(count) * deviation(np.arange(count) / (2 * count * period)), norm="ortho")


# blocks


@repeatable
@given(st.lists(st.integers(2, 3000), min_size=1, max_size=12), st.floats(0.5, 45.0))
def test_blocks_cover_every_sample_once(lengths, cutoff):
    signals = signals_of([np.zeros((2, n)) for n in lengths], cutoffs=(cutoff, 2 * cutoff))
    seen = [np.zeros(n, dtype=int) for n in lengths]
    for block in cut_blocks(signals):
        assert block.stop > block.start
        seen[block.record][block.start : block.stop] += 1
    for count in seen:
        np.testing.assert_array_equal(count, 1)


@repeatable
@given(st.lists(st.integers(2, 3000), min_size=1, max_size=12), st.floats(0.5, 45.0))
def test_folds_are_numbered_without_a_hole_and_hold_enough_cosines(lengths, cutoff):
    blocks = cut_blocks(signals_of([np.zeros((2, n)) for n in lengths], cutoffs=(cutoff,)))
    folds = {b.fold for b in blocks}
    assert folds == set(range(len(folds)))
    assert len(folds) == min(FOLDS, len(blocks))
    for block in blocks:
        if block.stop - block.start < lengths[block.record]:  # a piece of a record, not all of it
            assert 2 * (block.stop - block.start + 1) * 0.01 * cutoff >= 40


def test_a_long_record_is_held_out_in_five_parts_of_one_size():
    blocks = cut_blocks(signals_of([np.zeros((2, 10_003))]))
    assert [b.fold for b in blocks] == [0, 1, 2, 3, 4]
    assert {b.stop - b.start for b in blocks} <= {2000, 2001}
    assert all(a.stop == b.start for a, b in pairwise(blocks))


def test_the_lowest_cutoff_decides_how_far_a_record_is_cut():
    columns = [np.zeros((2, 1000))]
    assert len(cut_blocks(signals_of(columns, cutoffs=(20.0, 4.0)))) == 2
    assert len(cut_blocks(signals_of(columns, cutoffs=(20.0, 20.0)))) == 5


# cosines


@repeatable
@given(st.integers(0, 2**32 - 1), st.integers(12, 700), st.floats(0.5, 45.0))
def test_cosine_rows_are_linear_and_keep_relations(seed, count, cutoff):
    rng = np.random.default_rng(seed)
    first, second = rng.standard_normal((2, 3, count))
    rows = cosine_rows(cutoff, frequency=(0.0, 10.0, 50.0), weight=(1.0, 0.3, 0.7))
    a, b = rows.rows(first), rows.rows(second)
    both = rows.rows(2.0 * first - 0.5 * second)
    np.testing.assert_allclose(both, 2.0 * a - 0.5 * b, atol=1e-12)
    # A relation that holds at every sample holds in every row.
    related = np.vstack([first, 3.0 * first[0] - first[2]])
    mapped = rows.rows(related)
    np.testing.assert_allclose(mapped @ [3.0, 0.0, -1.0, -1.0], 0.0, atol=1e-12)


@pytest.mark.parametrize("count", [40, 97, 128, 211])  # 97 and 211 are padded to a length that transforms fast
def test_cosine_rows_are_the_sums_they_say(count):
    import scipy.fft

    period, cutoff = 0.02, 9.0
    x = np.random.default_rng(count).standard_normal(count)
    rows = cosine_rows(cutoff, period, (0.0, 4.0, 25.0), (2.0, 1.0, 0.5))
    length = scipy.fft.next_fast_len(count, real=True)
    ramp = round(min(2.0 / (cutoff * period), count / 10))
    taper = np.minimum(1.0, np.sin(0.5 * np.pi * np.minimum(1.0, (np.arange(count) + 0.5) / ramp)) ** 2)
    taper = taper * taper[::-1]
    expected = []
    for k in range(length):
        hertz = k / (2 * length * period)
        if hertz <= cutoff:
            wave = np.cos(np.pi * k * (2 * np.arange(count) + 1) / (2 * length))
            scale = np.sqrt((1 if k == 0 else 2) / length)
            expected.append(np.interp(hertz, [0.0, 4.0, 25.0], [2.0, 1.0, 0.5]) * scale * np.sum(taper * x * wave))
    np.testing.assert_allclose(rows.rows(x[None])[:, 0], expected, atol=1e-12)


def test_what_lies_above_the_cutoff_leaves_the_rows():
    t = 0.01 * np.arange(2000)
    below, above = cosine_rows(5.0).rows(np.array([np.sin(2 * np.pi * 3 * t), np.sin(2 * np.pi * 9 * t)])).T
    assert np.sum(below**2) == pytest.approx(1000, rel=0.05)  # the energy of a sine, less the tapers
    assert np.sum(above**2) < 1e-4 * np.sum(below**2)


def test_plain_rows_are_the_samples():
    signals = signals_of([np.zeros((2, 30))])
    columns = np.random.default_rng(0).standard_normal((4, 30))
    rows = PlainRows().row_map(signals, 2, cut_blocks(signals), [columns], 0)
    np.testing.assert_array_equal(rows.rows(columns), columns.T)


# weights


@pytest.mark.parametrize("order", [1, 2, 3])
def test_without_passes_the_weight_is_that_of_a_derivative_of_white_noise(order):
    signals = signals_of([np.zeros((2, 4000))])
    rows = NoiseWeighted(passes=0).row_map(signals, order, cut_blocks(signals), [np.ones((2, 4000))], 0)
    at = np.interp([1.0, 2.0, 4.0], rows.frequency, rows.weight)
    np.testing.assert_allclose(at[:-1] / at[1:], 2.0**order, rtol=0.05 * order)


def planted(seed, deviation, records=3, count=1500):
    """Blocks of columns x, z, and y = 2 x - z + noise of the spectrum `deviation`."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(records):
        x, z = (colored(rng, count, 0.01, lambda f: f < 8.0) for _ in range(2))
        found.append(np.array([x, z, 2.0 * x - z + colored(rng, count, 0.01, deviation)]))
    return found


def deviation(f):
    return np.where(f < 2.0, 0.02, 0.4) * (f < 8.0)


def test_the_weight_learns_the_spectrum_of_the_noise():
    columns = planted(0, lambda f: np.where(f < 2.0, 0.1, 0.4) * (f < 8.0))
    signals = signals_of([c[:2] for c in columns], cutoffs=(7.0,))
    blocks = cut_blocks(signals)
    values = [columns[b.record][:, b.start : b.stop] for b in blocks]
    rows = NoiseWeighted().row_map(signals, 1, blocks, values, 2)
    assert rows.weight.max() == 1.0
    bands = (np.linspace(0.3, 1.2, 50), np.linspace(3.0, 6.5, 50))
    low, high = (np.median(np.interp(band, rows.frequency, rows.weight)) for band in bands)
    assert low / high == pytest.approx(4.0, rel=0.15)


def test_noise_weighted_rows_estimate_better_than_samples():
    errors = {"samples": [], "weighted": []}
    for seed in range(8):
        columns = planted(seed, deviation)
        signals = signals_of([c[:2] for c in columns], cutoffs=(7.0,))
        blocks = cut_blocks(signals)
        values = [columns[b.record][:, b.start : b.stop] for b in blocks]
        for name, choice in (("samples", PlainRows()), ("weighted", NoiseWeighted())):
            rows = choice.row_map(signals, 1, blocks, values, 2)
            factor = factorise(rows.rows(v) for v in values)
            xi = factor.solve((0, 1, 2), 2)
            errors[name].append(np.hypot(xi[0] + 2.0, xi[1] - 1.0))
    assert np.median(errors["weighted"]) < 0.3 * np.median(errors["samples"])


def test_more_columns_than_cosines_still_leave_a_residual_to_learn_from():
    rng = np.random.default_rng(3)
    columns = np.vstack([colored(rng, 400, 0.01, lambda f: f < 5.0) for _ in range(60)])
    columns = np.vstack([columns, columns[7] - columns[11] + colored(rng, 400, 0.01, lambda f: 0.1 * (f < 5.0))])
    signals = signals_of([columns[:2]])
    blocks = cut_blocks(signals)
    assert len(blocks) == 1  # 40 cosines for 61 columns
    rows = NoiseWeighted().row_map(signals, 1, blocks, [columns], 60)
    # A fit on all columns would leave rounding, and its weights would be those of rounding: huge and ragged.
    inside = np.interp(np.linspace(0.5, 4.5, 40), rows.frequency, rows.weight)
    assert inside.min() > 0.1


def test_the_noise_is_learnt_where_a_fit_on_all_columns_would_leave_none():
    rng = np.random.default_rng(4)
    columns = planted(4, lambda f: np.where(f < 2.0, 0.1, 0.4) * (f < 8.0), count=900)
    columns = [np.vstack([c, rng.standard_normal((400, c.shape[1]))]) for c in columns]
    signals = signals_of([c[:2] for c in columns], cutoffs=(7.0,))
    blocks = cut_blocks(signals)
    values = [columns[b.record][:, b.start : b.stop] for b in blocks]
    rows = NoiseWeighted().row_map(signals, 1, blocks, values, 2)
    assert sum(len(rows.rows(v)) for v in values) < 403
    bands = (np.linspace(0.3, 1.2, 50), np.linspace(3.0, 6.5, 50))
    low, high = (np.median(np.interp(band, rows.frequency, rows.weight)) for band in bands)
    assert 3.0 < low / high < 10.0  # 4, and what a pursuit among so many columns fits of the noise


def test_nothing_above_the_lowest_cutoff_is_fitted():
    columns = [c[:2] for c in planted(2, deviation)]
    signals = signals_of(columns, cutoffs=(6.0, 20.0))
    blocks = cut_blocks(signals)
    values = [columns[b.record][:, b.start : b.stop] for b in blocks]
    rows = NoiseWeighted().row_map(signals, 1, blocks, values, 0)
    waves = np.sin(2 * np.pi * np.array([[4.0], [9.0]]) * 0.01 * np.arange(values[0].shape[1]))
    below, above = np.sum(rows.rows(waves) ** 2, axis=0)
    assert above < 1e-3 * below


def test_an_exact_relation_leaves_weights_that_can_be_used():
    columns = planted(1, lambda f: 0.0 * f)
    signals = signals_of([c[:2] for c in columns], cutoffs=(7.0,))
    blocks = cut_blocks(signals)
    values = [columns[b.record][:, b.start : b.stop] for b in blocks]
    rows = NoiseWeighted(passes=2).row_map(signals, 1, blocks, values, 2)
    factor = factorise(rows.rows(v) for v in values)
    np.testing.assert_allclose(factor.solve((0, 1, 2), 2), [-2.0, 1.0, 1.0], rtol=1e-9)
