import numpy as np
import pytest

from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import SavitzkyGolay, Spectral
from odescope.signals.filling import filled, measured_derivatives
from odescope.signals.spectral import differentiate, last_bin

PERIOD, COUNT, NOISE = 0.01, 4000, 0.01
T = PERIOD * np.arange(COUNT)
TRUTH = np.sin(3.0 * T) + 0.5 * np.cos(7.3 * T + 1.0)
X = (Coordinate("x", 2),)


def record(measured, filling=0.0, seed=0):
    """Samples where `measured` says how many there are (N,); the truth off by `filling` where there are none."""
    rng = np.random.default_rng(seed)
    deviation = NOISE / np.sqrt(np.maximum(measured, 1))
    x = np.where(measured > 0, TRUTH + deviation * rng.standard_normal(COUNT), TRUTH + filling)
    return Record(T, x[:, None], ("x",), counts=np.asarray(measured, dtype=float)[:, None])


LOST = (np.random.default_rng(1).random(COUNT) > 0.1).astype(float)
GAP = np.where((np.arange(COUNT) >= 2000) & (np.arange(COUNT) < 2012), 0.0, 1.0)


@pytest.mark.parametrize("measured", [LOST, GAP, LOST * GAP])
def test_what_is_filled_in_is_the_filtered_signal_and_what_was_measured_stays(measured):
    run = record(measured, filling=3.0 * NOISE)
    (found,) = filled(Records((run,)), X, Spectral())
    missing = measured == 0.0
    assert np.array_equal(found.values[~missing], run.values[~missing])
    cutoff = measured_derivatives(Records((run,)), X[0], Spectral()).cutoff
    smooth = differentiate(found.column("x"), PERIOD, last_bin(COUNT, PERIOD, cutoff), 0)[0]
    assert np.abs(found.column("x") - smooth)[missing].max() < 0.1 * NOISE
    assert np.abs(found.column("x") - TRUTH)[missing].max() < 1.5 * NOISE


def test_filling_comes_to_the_least_squares_fit_of_the_measured_samples():
    """Against a dense fit of the cosines below the cutoff and the cubic to the measured samples alone."""
    count, measured = 300, np.random.default_rng(2).random(300) > 0.3
    x = np.sin(3.0 * T[:count]) + NOISE * np.random.default_rng(3).standard_normal(count)
    run = Record(T[:count], np.where(measured, x, 0.0)[:, None], ("x",), counts=measured[:, None].astype(float))
    (found,) = filled(Records((run,)), X, Spectral())
    last = last_bin(count, PERIOD, measured_derivatives(Records((run,)), X[0], Spectral()).cutoff)
    assert last < 40
    basis = np.cos(np.pi * np.outer(np.arange(count) + 0.5, np.arange(last + 1)) / count)
    basis = np.column_stack([basis, np.linspace(-1, 1, count)[:, None] ** [1, 2, 3]])
    fit = basis @ np.linalg.lstsq(basis[measured], x[measured], rcond=None)[0]
    inner = ~measured & (np.arange(count) > 20) & (np.arange(count) < 280)
    assert np.abs(found.column("x") - fit)[inner].max() < 0.5 * NOISE


def test_records_without_missing_cells_are_left_alone():
    records = Records((record(np.ones(COUNT)), record(np.full(COUNT, 2.0))))
    assert filled(records, X, Spectral()) is records


DENSITIES = {
    "lost": [LOST],
    "half rate": [(np.arange(COUNT) % 2 == 0) * 1.0],
    "pairs": [1.0 + (np.arange(COUNT) % 3 == 0)],
    "one of them slow": [np.ones(COUNT), (np.arange(COUNT) % 10 == 0) * 1.0],
}


@pytest.mark.parametrize("name", DENSITIES)
def test_the_noise_is_that_of_a_measured_sample(name):
    records = Records(tuple(record(n, seed=k) for k, n in enumerate(DENSITIES[name])))
    found = measured_derivatives(filled(records, X, Spectral()), X[0], Spectral())
    assert found.noise == pytest.approx(NOISE, rel=0.08)
    assert found.cutoff < 5.0
    for values in found.values:
        assert values.shape == (3, COUNT)
        assert np.sqrt(np.mean((values[0] - TRUTH) ** 2)) < NOISE


def test_other_differentiators_fill_too():
    run = record(LOST, filling=10.0 * NOISE)
    (found,) = filled(Records((run,)), X, SavitzkyGolay(window=21))
    assert np.abs(found.column("x") - TRUTH)[LOST == 0.0].max() < 3.0 * NOISE
