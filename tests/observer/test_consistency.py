"""Whether innovations are judged rightly: on numbers of known distribution, and by direct sums."""

import numpy as np
import pytest
from scipy.stats import chi2

from odescope.observer.consistency import LAGS, consistency


def judged(*runs):
    """Innovations (N, c) of unit variance by assumption."""
    return consistency(["x", "y"], runs, [np.ones_like(r) for r in runs], [np.nansum(r**2, axis=1) for r in runs])


def test_white_innovations_are_consistent_as_often_as_the_level_says():
    rng = np.random.default_rng(0)
    found = [judged(rng.standard_normal((400, 2))) for _ in range(200)]
    size = np.mean([f.band[0] <= f.squared <= f.band[1] for f in found])
    white = np.mean([w.white for f in found for w in f.coordinates])
    inside = np.mean([f.inside for f in found])
    assert 0.90 < size < 0.99
    assert 0.92 < white < 0.98
    assert inside == pytest.approx(0.95, abs=0.005)


def test_the_numbers_are_those_of_direct_sums():
    rng = np.random.default_rng(1)
    first, second = rng.standard_normal((60, 2)), rng.standard_normal((50, 2))
    first[10:15, 1] = np.nan
    found = judged(first, second)
    terms = np.concatenate([first.ravel(), second.ravel()])
    terms = terms[np.isfinite(terms)]
    assert found.squared == pytest.approx(np.mean(terms**2))
    np.testing.assert_allclose(np.array(found.band) * len(terms), chi2.ppf([0.025, 0.975], len(terms)))
    y = found.coordinates[1]
    pairs = [(r[k, 1], r[k - 1, 1]) for r in (first, second) for k in range(1, len(r))]
    there = np.array([p for p in pairs if np.all(np.isfinite(p))])
    samples = np.concatenate([first[:, 1], second[:, 1]])
    samples = samples[np.isfinite(samples)]
    assert y.samples == len(samples) == 105
    assert y.first == pytest.approx(
        there[:, 0] @ there[:, 1] / np.linalg.norm(there[:, 0]) / np.linalg.norm(there[:, 1])
    )
    assert y.limit == pytest.approx(chi2.ppf(0.95, LAGS))


def test_innovations_that_go_together_and_such_as_are_too_large_are_told():
    rng = np.random.default_rng(2)
    noise = rng.standard_normal((2001, 2))
    smeared = (noise[1:] + 0.5 * noise[:-1]) / np.sqrt(1.25)
    coloured = judged(smeared)
    assert not any(w.white for w in coloured.coordinates)
    assert coloured.coordinates[0].lag == 1
    assert coloured.coordinates[0].first == pytest.approx(0.4, abs=0.05)
    large = judged(1.2 * noise)
    assert large.squared == pytest.approx(1.44, rel=0.05)
    assert not large.consistent
    assert all(w.white for w in large.coordinates)
    assert "not white" in coloured.lines[1]


def test_no_correlation_of_a_short_log_passes_one_and_pairs_far_apart_do_not_count():
    """Of 19 samples there are two pairs at 17 samples: their product says nothing, and was more than the variance."""
    found = [judged(np.random.default_rng(seed).standard_normal((19, 2))) for seed in range(300)]
    channels = [w for f in found for w in f.coordinates]
    assert max(w.lag for w in channels) == 4
    assert max(abs(w.largest) for w in channels) < 1.0
    assert 0.90 < np.mean([w.white for w in channels]) < 0.98
    assert judged(np.full((2, 2), 1.0)).coordinates[0].lag == 1


def test_innovations_that_are_too_small_are_within_their_intervals_and_told():
    small = judged(0.03 * np.random.default_rng(3).standard_normal((500, 2)))
    assert small.inside == 1.0
    assert not small.consistent
    assert "100 % of 500 samples within their 95 % intervals" in small.lines[0]
    assert "innovations are 0.03 times as large as expected: the noise" in small.lines[1]
    few = judged(np.full((2, 2), 1e-9))  # of which the start was fitted
    assert few.inside == 1.0
    assert not any("times as large" in line for line in few.lines)
    expected = judged(np.random.default_rng(3).standard_normal((500, 2)))
    assert not any("times as large" in line for line in expected.lines)
    one = judged(np.array([[1.95, np.nan], [1.97, np.nan]]))  # of one reading, the interval of a normal distribution
    assert one.inside == 0.5
