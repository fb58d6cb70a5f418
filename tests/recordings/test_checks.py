"""An angle that nobody declared is told from a coordinate that jumps for other reasons."""

import numpy as np
import pytest

from odescope.errors import InputError
from odescope.recordings.checks import check_channels
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records

T = 0.01 * np.arange(3000)


def check(column, unit=None, angle=False):
    records = Records((Record(T, column[:, None], ("x",), (unit,)),))
    check_channels(records, [Coordinate("x", 2, angle=angle, unit=unit)], [])


@pytest.mark.parametrize("seed", range(4))
def test_an_angle_that_wraps_has_to_be_declared(seed):
    rng = np.random.default_rng(seed)
    phi = np.cumsum(0.01 * rng.uniform(0.5, 3.0) * np.ones(3000)) + rng.uniform(-3, 3) + np.sin(T)
    wrapped = np.angle(np.exp(1j * (phi + 1e-3 * rng.standard_normal(3000))))
    with pytest.raises(InputError, match=r"jumps by about 2 pi \([0-9]+ times\).*angle = true.*or give the unit"):
        check(wrapped)
    check(wrapped, unit="m")
    check(wrapped, angle=True)


@pytest.mark.parametrize("seed", range(4))
def test_lost_readings_at_two_pi_are_no_wraps(seed):
    rng = np.random.default_rng(seed)
    ph = 6.3 + 0.2 * np.sin(T) + 0.01 * rng.standard_normal(3000)
    ph[rng.choice(3000, 20, replace=False)] = 0.0
    check(ph)
