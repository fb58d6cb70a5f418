import numpy as np
import pytest

from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.signals.cutoff import FixedCutoff
from odescope.signals.differentiators import Spectral
from odescope.signals.filling import filled, measured_derivatives
from odescope.signals.supported import bears_fits, supported_cutoff

PERIOD, COUNT = 1.0 / 15.0, 150
T = PERIOD * np.arange(COUNT)
X = (Coordinate("x", 1),)


def half(seed):
    """Which samples (N,) of a record were measured: half of them, the ends among these."""
    rng = np.random.default_rng(seed)
    found = np.zeros(COUNT)
    found[rng.choice(COUNT, COUNT // 2, replace=False)] = 1.0
    found[[0, -1]] = 1.0
    return found


@pytest.mark.parametrize("seed", range(6))
def test_the_cutoff_is_that_of_the_fit_that_predicts_best(seed):
    """Against the cutoff whose fit to the measured samples is nearest to the truth on all others."""
    rng, there = np.random.default_rng(seed), half(seed)
    truth = np.cos(2.0 * T) * np.exp(-0.2 * T)
    y = truth + 0.05 * rng.standard_normal(COUNT)

    def error(hertz):
        last = int(2.0 * hertz * COUNT * PERIOD * (1 + 1e-9))
        basis = np.cos(np.pi * np.outer(np.arange(COUNT) + 0.5, np.arange(last + 1)) / COUNT)
        basis = np.column_stack([basis, np.linspace(-1, 1, COUNT)[:, None] ** [1, 2, 3]])
        fit = basis @ np.linalg.lstsq(basis[there > 0], y[there > 0], rcond=1e-9)[0]
        return np.sqrt(np.mean((fit - truth) ** 2))

    best = min(error(k / (2 * COUNT * PERIOD)) for k in range(1, 40))
    assert error(supported_cutoff([y], [there], PERIOD, np.inf)) < 1.5 * best


def test_a_signal_too_fast_for_its_samples_is_not_taken_for_noise():
    fast = np.sin(2.0 * np.pi * 5.1 * T) + np.sin(2.0 * np.pi * 4.3 * T + 1.0)
    assert supported_cutoff([fast], [half(0)], PERIOD, np.inf) == np.inf


def test_fits_are_made_where_much_is_missing_of_few_samples():
    assert bears_fits([half(0)])
    assert not bears_fits([np.ones(COUNT)])
    assert not bears_fits([np.tile(half(0), 100)])


@pytest.mark.parametrize("shape", [lambda t: 5.0 * np.exp(-0.4 * t), lambda t: np.sin(1.3 * t), lambda t: 0.2 * t**2])
def test_the_noise_of_half_a_short_record_is_told(shape):
    ratios = []
    for seed in range(12):
        rng, there = np.random.default_rng(seed), half(seed)
        noise = 0.05 * np.sqrt(np.mean(shape(T) ** 2))
        x = np.interp(T, T[there > 0], (shape(T) + noise * rng.standard_normal(COUNT))[there > 0])
        records = Records((Record(T, x[:, None], ("x",), counts=there[:, None]),))
        ratios.append(measured_derivatives(filled(records, X, Spectral()), X[0], Spectral()).noise / noise)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.12)
    assert 0.6 < min(ratios) < max(ratios) < 1.4


def test_a_cutoff_set_by_hand_stays():
    there = half(3)
    records = Records((Record(T, np.sin(T)[:, None], ("x",), counts=there[:, None]),))
    assert measured_derivatives(records, X[0], Spectral(FixedCutoff(3.0))).cutoff == 3.0
