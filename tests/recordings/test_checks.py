"""An angle that nobody declared is told from a coordinate that jumps for other reasons."""

import numpy as np
import pytest

from odescope.errors import InputError
from odescope.recordings.checks import (
    check_channels,
    check_seconds,
    degrees_hints,
    differently_scaled,
    of_other_kinds,
    units_differ,
)
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.headings import Heading
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


@pytest.mark.parametrize("unit", ["gon", "grad", "Grad", "ticks", "increments", "rev", "mrad", "my unit"])
def test_an_angle_in_what_is_neither_radians_nor_degrees_is_refused(unit):
    with pytest.raises(InputError, match=f"to be in {unit}: .*convert the column"):
        check(np.sin(T), unit=unit, angle=True)


@pytest.mark.parametrize("unit", [None, "", "rad", "Radians", "1", "-"])
def test_an_angle_in_radians_is_none_of_these(unit):
    check(np.sin(T), unit=unit, angle=True)


def test_the_heading_of_an_angle_names_units_of_encoders_and_surveyors():
    for unit in ("gon", "ticks", "Grad", "counts"):
        assert (Heading.of(f"phi [{unit}]").name, Heading.of(f"phi [{unit}]").unit) == ("phi", unit)


LET_GO = 100.0 * np.cos(3.0 * T) * np.exp(-0.2 * T)
NOISE = np.random.default_rng(0).standard_normal(len(T))


@pytest.mark.parametrize(
    ("columns", "hinted"),
    [
        ([LET_GO], True),
        ([LET_GO + 2.0 * NOISE], True),
        ([LET_GO, np.linspace(0.0, 1.0, 500)], True),
        ([170.0 * np.sin(0.9 * T)], True),
        ([3.0 * T], False),
        ([3.0 * T + 0.5 * np.sin(5.0 * T) + 0.5 * NOISE], False),
        ([100.0 * (1.0 - np.exp(-T))], False),
        ([4.0 * LET_GO], False),
    ],
)
def test_what_swings_by_many_turns_may_be_in_degrees(columns, hinted):
    records = Records(tuple(Record(T[: len(y)], y[:, None], ("x",), (None,)) for y in columns))
    assert bool(degrees_hints(records, [Coordinate("x", 2, angle=True)])) == hinted
    assert not degrees_hints(records, [Coordinate("x", 2, angle=True, unit="rad")])


def recording(seed, begin=0.0):
    x = np.random.default_rng(seed).standard_normal(50)
    return Record(begin + max(1.0, begin / 1e9) * T[:50], x[:, None], ("x",), (None,), source=f"run{seed}.csv")


def test_a_recording_that_comes_twice_is_refused():
    coordinates = [Coordinate("x")]
    check_channels(Records((recording(1), recording(2), recording(1, begin=5.0))), coordinates, [])
    with pytest.raises(InputError, match=r"recording 3 in run1.csv holds the same samples as recording 1 in run1.csv"):
        check_channels(Records((recording(1), recording(2), recording(1))), coordinates, [])


@pytest.mark.parametrize(("begin", "unit"), [(1.7e12, "ms"), (1.7e15, "us"), (1.7e18, "ns"), (1.7e9, None), (0, None)])
def test_times_since_1970_in_parts_of_a_second_are_no_seconds(begin, unit):
    records = Records((recording(1, begin=begin),))
    if unit is None:
        check_seconds(records)
        return
    with pytest.raises(InputError, match=f'looks like {unit} since 1970.*time_unit = "{unit}"'):
        check_seconds(records)


@pytest.mark.parametrize(
    ("one", "other", "differ"),
    [
        *((one, other, True) for one, other in (("mm", "m"), ("kPa", "hPa"), ("mmol/l", "mol/l"), ("N m", "kN m"))),
        *((one, other, True) for one, other in (("mW", "MW"), ("deg", "rad"), ("ms", "s"))),
        *(
            (one, other, False)
            for one, other in (("um", "µm"), ("meters", "m"), ("degC", "C"), ("hr", "h"), ("V", "A"))
        ),
        *((one, other, False) for one, other in (("sec", "s"), ("Ohm", "Ω"), ("deg", "degrees"), (None, "m"))),
    ],
)
def test_units_of_one_kind_are_of_other_sizes_by_their_prefix(one, other, differ):
    assert differently_scaled(one, other) is differently_scaled(other, one) is differ


@pytest.mark.parametrize(
    ("one", "other", "differ"),
    [
        *((one, other, True) for one, other in (("V", "N m"), ("mV", "A"), ("bar", "Pa"), ("degC", "K"), ("rad", "m"))),
        *((one, other, False) for one, other in (("Nm", "N m"), ("volts", "V"), ("kPa", "Pa"), ("meters", "mm"))),
        *((one, other, False) for one, other in (("ticks", "V"), (None, "V"), ("m/s", "V"), ("°C", "C"), ("", "m"))),
        *((one, other, False) for one, other in (("min", "in"), ("mol/l", "M"), ("deg", "degC"))),
    ],
)
def test_units_of_other_quantities_are_told_where_both_are_known(one, other, differ):
    assert of_other_kinds(one, other) is of_other_kinds(other, one) is differ


@pytest.mark.parametrize(
    ("headed", "unit", "differ"),
    [
        ("mm", "m", True),
        ("mm", "mm", False),
        ("deg", "°", False),
        ("m/s", "m s^-1", False),
        (None, "m", False),
        ("m", None, False),
    ],
)
def test_units_that_are_spelled_alike_or_not_at_all_do_not_differ(headed, unit, differ):
    assert units_differ(headed, unit) is differ


SPUN = 4.0 * T + np.sin(T)  # an angle that has wrapped and was unwrapped


@pytest.mark.parametrize(
    ("driver", "refused"),
    [
        (SPUN, True),
        (np.angle(np.exp(1j * SPUN)), True),  # the column as it was recorded
        (np.rad2deg(SPUN), True),
        (SPUN + 1e-3 * NOISE, False),  # a second sensor, or what is fed back
        (-SPUN, False),
    ],
)
def test_an_input_that_is_a_copy_of_a_coordinate_is_refused(driver, refused):
    records = Records((Record(T, np.column_stack([np.cos(T), SPUN, driver]), ("x", "phi", "u"), (None,) * 3),))
    coordinates = [Coordinate("x", 2), Coordinate("phi", 2, angle=True)]
    if refused:
        with pytest.raises(InputError, match=r"'u' and coordinate 'phi' hold the same samples: .*leave out 'u'"):
            check_channels(records, coordinates, [Input("u")])
    else:
        check_channels(records, coordinates, [Input("u")])
