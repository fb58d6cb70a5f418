"""The inputs that a model is tried with."""

import numpy as np
import pytest

pytest.importorskip("nicegui")

from odescope.errors import InputError
from odescope.workbench.excitation import Excitation, sample_times

T = np.linspace(0.0, 10.0, 100_001)


def test_a_step_and_a_constant():
    step = Excitation("step", 3.0, begin=2.0).values(T)
    assert set(np.unique(step)) == {0.0, 3.0}
    assert T[step > 0.0][0] == 2.0
    assert np.all(Excitation("constant", -1.5).values(T) == -1.5)


def test_a_sine_has_its_frequency():
    power = np.abs(np.fft.rfft(Excitation("sine", 2.0, frequency=3.0).values(T[:-1])))
    assert np.fft.rfftfreq(100_000, 1e-4)[power.argmax()] == pytest.approx(3.0)
    assert power.max() == pytest.approx(100_000.0, rel=1e-6)


def test_a_chirp_goes_from_one_frequency_to_the_other():
    """Its phase, unwrapped by counting, has the derivative that is asked for."""
    chirp = Excitation("chirp", 1.0, frequency=1.0, last_frequency=6.0)
    crossings = T[1:][np.diff(np.sign(chirp.values(T))) > 0.0]
    seen = 1.0 / np.diff(crossings)
    middle = 0.5 * (crossings[1:] + crossings[:-1])
    np.testing.assert_allclose(seen, 1.0 + 0.5 * middle, rtol=0.02)
    assert chirp.highest == 6.0


def test_times_are_near_enough_for_every_input():
    t = sample_times(10.0, [Excitation("step"), Excitation("sine", frequency=20.0)])
    assert (t[0], t[-1]) == (0.0, 10.0)
    assert np.diff(t).max() <= 1.0 / (20.0 * 40.0) + 1e-12
    for duration, frequency in ((0.0, 1.0), (-1.0, 1.0), (np.inf, 1.0), (np.nan, 1.0), (10.0, 1e6)):
        with pytest.raises(InputError):
            sample_times(duration, [Excitation("sine", frequency=frequency)])
