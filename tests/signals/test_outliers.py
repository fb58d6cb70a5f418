"""Clipping against Huber's conditions, and what it saves of a record with outliers."""

import numpy as np
import pytest

from odescope import Coordinate, Record, Records, Spectral
from odescope.signals.outliers import BEND, clip_outliers, count_clipped, settle_clipping

PERIOD, NOISE = 0.01, 0.01
X = Coordinate("x", 2)


def record(seed, share, size=1.0):
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(3000)
    clean = np.sin(1.7 * t) + 0.4 * np.cos(4.1 * t + 1.0)
    x = clean + NOISE * rng.standard_normal(len(t))
    struck = rng.random(len(t)) < share
    x[struck] += size * rng.choice([-1.0, 1.0], int(struck.sum()))
    return t, clean, Records.of(Record(t, x[:, None], ("x",))), int(struck.sum())


def clip(records):
    """Return the records clipped, and how many samples were."""
    clipping = settle_clipping(records, [X], Spectral())
    stretches = clip_outliers(records.stretches, [X], Spectral(), clipping)
    return Records(tuple(s.record for s in stretches)), count_clipped(records.stretches, stretches, [X])


@pytest.mark.parametrize("seed", range(4))
def test_the_filtered_signal_minimises_hubers_loss(seed):
    # The filter is a projection; at the least of Huber's loss nothing of the bent residual is left in what it passes.
    _, _, records, _ = record(seed, 0.02)
    clipped, _ = clip(records)
    y = clipped.runs[0].column("x")
    smooth = Spectral().derivatives([y], PERIOD, 2)
    residual = records.runs[0].column("x") - smooth.values[0][0]
    bound = BEND * 1.4826 * np.median(np.abs(residual - np.median(residual)))
    bent = np.clip(residual, -bound, bound)
    passed = Spectral().derivatives([smooth.values[0][0] + bent], PERIOD, 2).values[0][0] - smooth.values[0][0]
    assert np.sqrt(np.mean(passed**2)) < 0.05 * NOISE


@pytest.mark.parametrize("seed", range(6))
def test_outliers_are_counted_and_cost_little(seed):
    t, _, records, struck = record(seed, 0.02)
    _, _, plain, _ = record(seed, 0.0)
    clipped, counts = clip(records)
    assert struck <= counts["x"] <= struck + 0.01 * len(t)  # 0.3 % of a normal distribution lie beyond the bend

    def errors(of):
        found = Spectral().derivatives([of.runs[0].column("x")], PERIOD, 2)
        acceleration = -(1.7**2) * np.sin(1.7 * t) - 0.4 * 4.1**2 * np.cos(4.1 * t + 1.0)
        inner = slice(150, -150)
        return found.noise, np.sqrt(np.mean((found.values[0][2] - acceleration)[inner] ** 2))

    (noise, error), (_, without), (raw, raw_error) = errors(clipped), errors(plain), errors(records)
    assert noise == pytest.approx(NOISE, rel=0.15)
    assert raw > 5.0 * NOISE
    assert error < max(2.0 * without, 0.5 * raw_error)


def test_a_quantised_record_that_is_still_is_left_alone():
    t = PERIOD * np.arange(500)
    records = Records.of(Record(t, np.zeros((500, 1)), ("x",)))
    clipped, counts = clip(records)
    assert counts == {"x": 0}
    np.testing.assert_array_equal(clipped.runs[0].values, records.runs[0].values)
