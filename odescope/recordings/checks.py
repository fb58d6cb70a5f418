"""Whether records, coordinates and inputs fit together."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from odescope.arrays import BoolArray, FloatArray
from odescope.errors import InputError
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.headings import is_unit, since_1970
from odescope.recordings.record import Record, Records, within

LARGEST_VALUE = 1e30  # products of a few such values would overflow
LENGTHS = frozenset(
    {"m", "dm", "cm", "mm", "um", "µm", "μm", "nm", "km", "in", "ft", "meter", "meters", "metre", "metres"}
)
UNITLESS = frozenset({"", "1", "-"})
RADIANS = UNITLESS | {"rad", "rads", "radian", "radians"}
PREFIXES = frozenset("pnumcdhkMGT")
MICRO = {ord(mu): "u" for mu in "µμ"}
DEGREES = frozenset({"deg", "degs", "degree", "degrees", "°"})
TEMPERATURES = re.compile(r"t(_?\w{1,2})?(_\w+)?|(\w+_)?temp\w*", re.IGNORECASE)  # T, T1, T_in, T1_K, temp, gas_temp
SPELLED_ALIKE = (
    ("V", "volt", "volts"),
    ("A", "amp", "amps", "ampere", "amperes"),
    ("N m", "Nm", "N*m", "N·m"),
    ("m", "meter", "meters", "metre", "metres"),
    ("degC", "°C", "C", "celsius", "Celsius"),
    ("K", "kelvin"),
    ("rad", "rads", "radian", "radians"),
    ("ohm", "Ohm", "Ω"),
    *((unit,) for unit in ("N", "Pa", "bar", "psi", "W", "J", "g", "Hz", "rpm", "%", "mol", "L")),
)
_KNOWN = {spelled: group[0] for group in SPELLED_ALIKE for spelled in group}
KELVINS = (200.0, 3000.0)  # what is called so and stays between these is in kelvins
ISOLATED = 3  # samples in a row, at most, that are taken for outliers
TO_AND_FRO = 1.5  # of its range, that what swings goes altogether: to one side and half of it back
SMALL_TURN = 0.1  # of its range: where a column turns by less, that may be noise
SAME = 1e-9  # of the range of a coordinate: what an input may differ by that is a copy of it
TURNS = 2.0  # that an angle in radians spans, from which on it may be one in degrees


def check_channels(records: Records, coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> None:
    """Refuse channels that cannot take part in an identification.

    Args:
        records: that hold a column for each.
        coordinates: what was measured.
        inputs: what drove it.

    Raises:
        InputError: a name used twice (derived names included) or without a column, a coordinate that changes in no
            recording, an input that is one constant or a copy of a coordinate, an angle in degrees or in what is no
            unit of angles, a wrapped angle that is not declared as one, values above 1e30, a recording that comes
            twice.
    """
    if not coordinates:
        raise InputError("no coordinate: expected at least one measured quantity to find an equation for")
    _check_unique(coordinates, inputs)
    _check_repeated(records)
    for name in (*(c.name for c in coordinates), *(driver.name for driver in inputs)):
        if (largest := max(float(np.abs(run.column(name)).max()) for run in records)) > LARGEST_VALUE:
            raise InputError(f"{name!r} has values as large as {largest:.3g}; give it in a larger unit")
    for coordinate in coordinates:
        columns = [run.column(coordinate.name) for run in records]
        if all(_constant(column) for column in columns):
            raise InputError(f"coordinate {coordinate.name!r} is constant in every recording; leave it out")
        if coordinate.angle:
            _check_angle(coordinate, records)
        else:
            _check_wraps(coordinate, records)
    for driver in inputs:  # constant within each run but not across them, it is a parameter and does inform
        if _constant(np.concatenate([run.column(driver.name) for run in records])):
            raise InputError(f"input {driver.name!r} is constant in all recordings together; leave it out")
        _check_copied(driver.name, coordinates, records)


def _check_copied(driver: str, coordinates: Sequence[Coordinate], records: Records) -> None:
    """Refuse an input that holds what a coordinate does: it would explain that by itself, and drives nothing."""
    own = np.concatenate([run.column(driver) for run in records])
    for c in coordinates:
        measured = np.concatenate([run.column(c.name) for run in records])
        turn = 2.0 * np.pi  # wraps of an angle are undone where it is a coordinate, and degrees are converted
        rest = [np.remainder(f * own - measured + np.pi, turn) - np.pi for f in (1.0, np.pi / 180.0) if c.angle]
        if any(float(np.abs(d).max()) <= SAME * float(np.ptp(measured)) for d in (*rest, own - measured)):
            raise InputError(
                f"input {driver!r} and coordinate {c.name!r} hold the same samples: an input is what drives the"
                f" coordinates, recorded by itself; leave out {driver!r}, or name the column that it really is in"
            )


def _check_unique(coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> None:
    owners: dict[str, str] = {}
    claims = [(name, f"coordinate {c.name!r}") for c in coordinates for name in (*c.states, c.target)]
    claims += [(driver.name, f"input {driver.name!r}") for driver in inputs]
    for name, owner in claims:
        if name in owners:
            raise InputError(f"the name {name!r} is used twice: by {owners[name]} and by {owner}; rename one of them")
        owners[name] = owner


def _check_repeated(records: Records) -> None:
    """Refuse a recording that holds the samples of another: they would count twice, and errors be too small."""
    like: dict[tuple[float, float, int], list[tuple[int, Record]]] = {}
    for number, run in enumerate(records, 1):
        before = like.setdefault((float(run.t[0]), float(run.values[0, 0]), len(run)), [])
        for first, other in before:
            if np.array_equal(run.t, other.t) and np.array_equal(run.values, other.values):
                raise InputError(
                    f"recording {number}{within(run.source)} holds the same samples as recording {first}"
                    f"{within(other.source)}: give each once, or what is known would seem twice as sure"
                )
        before.append((number, run))


def _check_angle(angle: Coordinate, records: Records) -> None:
    for unit in (angle.unit, records.runs[0].units[records.names.index(angle.name)]):  # all runs have the same
        if unit is not None and is_degrees(unit):
            raise InputError(_in_degrees(f"angle {angle.name!r} has the unit {unit!r}", angle.name))
        if unit is not None and not is_angular(unit):
            wanted = (
                "a length is no angle, leave that word out"
                if unit.strip() in LENGTHS
                else 'angles are in radians here, or in degrees with unit = "deg": convert the column'
            )
            raise InputError(f"coordinate {angle.name!r} is said to be an angle, and to be in {unit}: {wanted}")
    for run in records:
        check_radians(angle.name, run.column(angle.name), run.source)


def _check_wraps(coordinate: Coordinate, records: Records) -> None:
    """Refuse a coordinate that jumps by 2 pi and otherwise moves in small steps: an angle nobody declared.

    What has the unit of something else is none; jumps to a few samples and back are outliers or lost readings.
    """
    from scipy.ndimage import median_filter

    if not all(map(is_angular, (coordinate.unit, records.runs[0].units[records.names.index(coordinate.name)]))):
        return
    for run in records:
        column = run.column(coordinate.name)
        if not _wraps(column).any() or not (wraps := _wraps(median_filter(column, 2 * ISOLATED + 1))).any():
            continue
        raise InputError(
            f"coordinate {coordinate.name!r} jumps by about 2 pi{within(run.source)} ({int(wraps.sum())} times), so it"
            " looks like a wrapped angle: declare it with angle = true (on the command line NAME:angle), or give the"
            " unit of what it is"
        )


def _wraps(column: FloatArray) -> BoolArray:
    """Return which steps (N - 1,) of a column (N,) are about 2 pi long, none where others are long, too."""
    jumps = np.abs(np.diff(column))
    wraps: BoolArray = np.abs(jumps - 2.0 * np.pi) < 0.5
    return wraps & ~np.any(jumps[~wraps] > 0.25 * np.pi)


def check_radians(name: str, column: FloatArray, source: str) -> None:
    """Refuse an angle that wraps by 360.

    Args:
        name: of the angle.
        column: (N,) its values, in radians as it should be.
        source: where it came from, for the message.
    """
    jumps = np.abs(np.diff(column))
    rows = np.flatnonzero(np.abs(jumps - 360) < 60)
    if len(rows):
        raise InputError(
            _in_degrees(
                f"angle {name!r} jumps by about 360{within(source)} ({len(rows)} times, first from "
                f"{column[rows[0]]:.6g} to {column[rows[0] + 1]:.6g}), so it looks like degrees",
                name,
            )
        )


def _in_degrees(what: str, name: str) -> str:
    return (
        f'{what}, but angles are in radians here: give unit = "deg" in [coordinates.{name}] of a study, or multiply the'
        " column by pi/180"
    )


def is_angular(unit: str | None) -> bool:
    """Say whether what has this unit may be an angle in radians: a concentration is none, however far it moves."""
    return unit is None or unit.strip().casefold() in RADIANS


def may_be_kelvins(name: str, values: FloatArray) -> bool:
    """Say whether values (N,) are called a temperature and stay where kelvins do."""
    return bool(TEMPERATURES.fullmatch(name) and KELVINS[0] < values.min() and values.max() < KELVINS[1])


def is_degrees(unit: str | None) -> bool:
    """Return whether a unit is degrees."""
    return unit is not None and unit.strip().casefold() in DEGREES


def units_differ(headed: str | None, unit: str | None) -> bool:
    """Say whether a heading says another unit than a study.

    Single ones alone are compared: m/s and m s^-1 are spelled differently and the same.
    """
    single = [word for word in (headed, unit) if word is not None and is_unit(word) and word.isalpha()]
    return len({"deg" if is_degrees(word) else word.casefold() for word in single}) > 1


def differently_scaled(headed: str | None, unit: str | None) -> bool:
    """Say whether two units are of one kind and of other sizes for sure: by a prefix, as mm and m, or deg and rad."""
    if headed is None or unit is None:
        return False
    one, other = (word.strip().translate(MICRO) for word in (headed, unit))
    if is_degrees(one) or is_degrees(other):
        return {one.casefold(), other.casefold()} & (RADIANS - UNITLESS) != set()
    return one != other and not _bases(one).isdisjoint(_bases(other))


def of_other_kinds(headed: str | None, unit: str | None) -> bool:
    """Say whether two units are known to be of different quantities, as V and N m, or on other scales, as bar and Pa.

    Units that are not listed here, or in another spelling, are not known to be; nor is "deg", which may be of an angle
    or of a temperature.
    """
    if headed is None or unit is None:
        return False
    kinds = {_KNOWN[base] for word in (headed, unit) for base in _bases(word.strip()) if base in _KNOWN}
    return len(kinds) > 1 and all(not _KNOWN.keys().isdisjoint(_bases(word.strip())) for word in (headed, unit))


def _bases(unit: str) -> set[str]:
    """Return a unit, and without its first letter where that may be a prefix."""
    return {unit, unit[1:]} if unit[:1] in PREFIXES and len(unit) > 1 else {unit}


def check_seconds(records: Records) -> None:
    """Refuse times that are taken for seconds, as nothing says their unit, and count parts of a second since 1970."""
    start = float(records.runs[0].t[0])
    if (unit := since_1970(start)) is not None:
        raise InputError(
            f"time begins at {start:.6g}{within(records.runs[0].source)}, which looks like {unit} since 1970, and"
            f' nothing says its unit: head the column "t ({unit})", or give time_unit = "{unit}" in [data] of a study,'
            f' or --time-unit {unit}; or "s" there if these are seconds'
        )


def degrees_hints(records: Records, coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return a sentence for each angle that goes so far to and fro, within 360, that it may be in degrees.

    Args:
        records: as they were recorded.
        coordinates: what was measured; those in radians for sure have the unit "rad".
    """
    said = []
    for c in (c for c in coordinates if c.angle and c.unit is None):
        columns = [run.column(c.name) for run in records]
        spans = [float(np.ptp(y)) for y in columns]
        span, swings = max(spans), sum(map(_path, columns)) > TO_AND_FRO * sum(spans)
        if span > TURNS * 2.0 * np.pi and swings and max(float(np.abs(y).max()) for y in columns) <= 360.0:
            said.append(
                f"{c.name} goes {span / (2.0 * np.pi):.3g} turns to and fro as radians; if it is in degrees, head"
                f' the column "{c.name} (deg)" or give unit = "deg" in [coordinates.{c.name}]; if not, "rad"'
            )
    return tuple(said)


def _path(column: FloatArray) -> float:
    """Return how far a column (N,) goes from turn to turn; turns that are small beside its range may be noise."""
    from scipy.signal import find_peaks

    prominence = SMALL_TURN * float(np.ptp(column))
    if prominence == 0.0:
        return 0.0
    turns = [find_peaks(y, prominence=prominence)[0] for y in (column, -column)]
    at = np.unique(np.concatenate([[0, int(column.argmin()), int(column.argmax()), len(column) - 1], *turns]))
    return float(np.abs(np.diff(column[at])).sum())


def order_hints(coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
    """Return a sentence for each coordinate that may be a position, though its equation is of order 1.

    Args:
        coordinates: what was measured; those with a unit of lengths, and angles, are positions.
    """
    return tuple(
        f"the equation of {c.name}, {'an angle' if c.angle else f'in {c.unit}'}, is of order 1: if it is a position"
        f" that forces move, give order = 2 in [coordinates.{c.name}], or --order 2"
        for c in coordinates
        if c.order == 1 and (c.angle or (c.unit or "").strip() in LENGTHS)
    )


def _constant(column: FloatArray) -> bool:
    """Constant up to rounding: resampling a constant leaves errors in the last digit."""
    return float(np.ptp(column)) <= 1e-12 * float(np.abs(column).max())
