"""The inputs that a model is tried with."""

import numpy as np
import pytest

pytest.importorskip("nicegui")

from odescope.errors import InputError
from odescope.workbench.excitation import Excitation, sample_times, suggested

T = np.linspace(0.0, 10.0, 100_001)


def test_a_step_and_a_constant():
    step = Excitation("step", 1.5, 3.0, begin=2.0).values(T)
    assert set(np.unique(step)) == {1.5, 3.0}
    assert T[step > 1.5][0] == 2.0
    assert np.all(Excitation("constant", -1.5).values(T) == -1.5)


@pytest.mark.parametrize(
    ("low", "high", "level", "goal", "amplitude"),
    [
        (0.0, 10.0, 5.0, 8.0, 3.0),
        (-1.0, 1.0, 0.0, 0.5, 0.5),
        (295.23, 299.71, 297.0, 299.0, 1.0),
        (1.23e-9, 4.56e-9, 2.9e-9, 3.7e-9, 8e-10),
        (-7312.0, -4111.0, -5700.0, -4900.0, 800.0),
    ],
)
def test_what_is_suggested_is_short_and_within_the_data(low, high, level, goal, amplitude):
    found = suggested(low, high, 20.0)
    assert (found.shape, found.level, found.goal, found.amplitude) == ("step", level, goal, amplitude)
    assert (found.begin, found.frequency, found.last_frequency) == (2.0, 0.25, 1.2)


def test_no_range_is_left_and_no_step_is_none():
    rng = np.random.default_rng(0)
    for _ in range(2000):
        low = rng.normal() * 10.0 ** rng.integers(-6, 6)
        high = low + rng.random() * 10.0 ** rng.integers(-6, 6)
        found = suggested(low, high, 1.0)
        assert low <= found.level - found.amplitude < found.level < found.goal <= high
        assert found.level + found.amplitude <= high


@pytest.mark.parametrize(("low", "high"), [(2.5, 2.5), (1e20, 1e20), (0.0, np.inf)])
def test_an_input_at_rest_stays_where_it_is(low, high):
    assert np.all(suggested(low, high, 3.0).values(T) == low)


def test_a_sine_has_its_frequency():
    power = np.abs(np.fft.rfft(Excitation("sine", 7.0, amplitude=2.0, frequency=3.0).values(T[:-1]) - 7.0))
    assert np.fft.rfftfreq(100_000, 1e-4)[power.argmax()] == pytest.approx(3.0)
    assert power.max() == pytest.approx(100_000.0, rel=1e-6)


def test_a_chirp_goes_from_one_frequency_to_the_other():
    """Its phase, unwrapped by counting, has the derivative that is asked for."""
    chirp = Excitation("chirp", 0.0, frequency=1.0, last_frequency=6.0)
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
