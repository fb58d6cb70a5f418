"""A sensor that ends: what stands at its end is told, whenever it was read and however briefly it stayed."""

import numpy as np
import pytest

from odescope.arrays import true_ranges
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.gaps import RawRun
from odescope.recordings.record import Records
from odescope.recordings.uniform import uniform
from odescope.signals.differentiators import Spectral
from odescope.signals.outliers import gate_outliers


@pytest.mark.parametrize("clock", [0.0, 0.03])
@pytest.mark.parametrize("seed", range(4))
def test_samples_at_the_end_of_a_range_are_told_and_no_others(seed, clock):
    rng, count, period = np.random.default_rng(seed), 3000, 0.01
    times = period * np.arange(count)
    true = np.sin(1.3 * times) + 0.6 * np.sin(0.47 * times + 1.0)
    read = np.minimum(true + 0.02 * rng.standard_normal(count), 1.1)
    stamps = times + clock * period * rng.standard_normal(count)
    stays = np.flatnonzero(read == 1.1)
    assert min(stop - first for first, stop in true_ranges(read == 1.1)) < 5  # brief stays are among them
    run = RawRun(stamps, read[:, None], ("x",), (None,), "", np.arange(count), ())
    record, points = uniform(run)
    (found,) = gate_outliers(Records.of(record), (Coordinate("x", 2),), Spectral())
    assert np.flatnonzero(found.counted("x") == 0.0).tolist() == points[stays].tolist()
