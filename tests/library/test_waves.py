import numpy as np
import pytest

from odescope.library.waves import FAR, QUARTER, QUARTER_END, QUARTER_REST, waves


def found(z, ahead):
    work = np.stack([z, np.empty_like(z)])
    waves(work, 0, 1, len(z), ahead)
    return work[1]


@pytest.mark.parametrize(("function", "ahead"), [(np.sin, 0.0), (np.cos, 1.0)])
@pytest.mark.parametrize("reach", [1e-3, 1.0, 100.0, 0.999 * FAR, 1e3 * FAR])
def test_values_are_those_of_the_c_library_to_rounding(function, ahead, reach):
    z = np.random.default_rng(int(reach)).uniform(-reach, reach, 20_001)
    np.testing.assert_allclose(found(z, ahead), function(z), rtol=0.0, atol=1.5e-16)
    np.testing.assert_allclose(found(z, ahead), function(z), rtol=1e-9)  # also where they pass zero


def test_about_whole_quarters_a_sine_keeps_its_digits():
    quarters = np.arange(-200_000, 200_000, 997) * (0.5 * np.pi)
    for z in (quarters, np.nextafter(quarters, np.inf), np.nextafter(quarters, -np.inf)):
        np.testing.assert_allclose(found(z, 0.0), np.sin(z), rtol=1e-6, atol=1e-16)
        np.testing.assert_allclose(found(z, 1.0), np.cos(z), rtol=1e-6, atol=1e-16)


def test_what_is_no_angle_has_no_sine():
    z = np.array([np.nan, np.inf, -np.inf, 0.0])
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(found(z, 0.0), [np.nan, np.nan, np.nan, 0.0])
        np.testing.assert_array_equal(found(z, 1.0), [np.nan, np.nan, np.nan, 1.0])


def test_the_quarter_of_a_turn_is_exact_in_its_parts():
    from fractions import Fraction

    parts = sum(map(Fraction, (QUARTER, QUARTER_REST, QUARTER_END)))
    quarter = Fraction(157079632679489661923132169163975144209858469968755291, 10**53)
    assert abs(parts - quarter) < Fraction(1, 10**36)
    for part in (QUARTER, QUARTER_REST):
        assert float(part).as_integer_ratio()[0].bit_length() <= 33
