"""A look at the channels of a log that nobody has described: which may be coordinates, which inputs, which neither."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.checks import degrees_hints, is_degrees, may_be_kelvins
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.headings import Heading
from odescope.recordings.record import Records
from odescope.signals.differentiators import Spectral
from odescope.signals.filling import measured_derivatives
from odescope.signals.first_order import rate_explained
from odescope.signals.rates import slope_and_share
from odescope.signals.slow_sensors import is_slow

Role = Literal["coordinate", "input", "neither"]
Filtered: TypeAlias = Mapping[str, Sequence[FloatArray]]

FLAT = 1e-12  # of the largest value: what rounds on the way to a uniform grid
SAME = 1e-9  # of the variance: what two columns may differ by that hold the same
A_RATE = 0.9  # of its variance: what a column explains of another's rate that holds that rate, noise and all
NEAR_ONE = 0.1  # the slope of a rate whose unit is that of the log
AN_AMOUNT = 0.95  # of the variance of its rate: what amounts explain of that, held out
INSIDE = slice(32, -32)  # samples of filtered signals, whose ends are the worst
FOLLOWS = 0.5  # of the variance: steps of white values have twice that of the values, those of a motion little
HELD = 0.5  # of the samples repeat the one before: a command that is held
WRAPS = (2.0 * np.pi, 360.0)
NEAR_WRAP = 0.1  # of a turn: what a jump may differ from it
BIG = 0.25  # of a turn: steps of an angle that no wrap explains
COMMANDS = re.compile(
    r"(u|f|force|tau|torque|input|pwm|duty|voltage|valve|pump|throttle|heater|excitation)(_.*|\d.*)?", re.IGNORECASE
)
# A word of a name by which a column drives whatever is asked of it: nothing that is explained by the others.
WANTED = frozenset({"cmd", "command", "commanded", "ref", "reference", "setpoint", "ambient", "outdoor", "disturbance"})
WHITE, WHITE_FROM = 1.8, 256  # times its variance: steps of what is noise from sample to sample; samples that tell it
POSITIONS = re.compile(
    r"(x|z|q|r|s|pos|position|disp|displacement|elongation|height)(_?\d+|_[a-z]{1,3})?", re.IGNORECASE
)
SPECIES = re.compile(r"[A-Z](_?\d+|_[A-Za-z]{1,3})?")  # one capital, as chemists and biologists call an amount
ANGLES = re.compile(r".*(theta|phi|psi|angle|winkel|yaw|pitch|roll|heading)(_?\d+|_[a-z]{1,3})?", re.IGNORECASE)
LEVELS = re.compile(r"(.*_)?(level|filling|liquid|water)(_.*|\d.*)?", re.IGNORECASE)  # of a tank: lengths, no positions
LENGTHS = frozenset({"m", "mm", "cm", "um", "µm", "μm", "nm", "km", "in", "ft", "meter", "metre", "meters", "metres"})
FORCES = re.compile(r"[kmM]?N\s?[*·.]?\s?(m|cm|mm)?|lbf")
SWINGS = 1.5  # times its range: a smooth column that goes so far in all has turned back
NOISE = "noise from sample to sample, as an excitation may be; what drives nothing is to be removed"
A_CONDITION = "constant within each recording, not across them"
AN_UNKNOWN = "an amount? order 2 for a position; what drives goes to [inputs]"
A_TEMPERATURE = "a temperature in kelvins, by its name and size; what drives goes to [inputs]"
BY_NAME = "a position, by its name; order 1 for an amount"
A_LEVEL = "the level of a liquid, by its name; order 2 for a position"
A_SPEED = "a speed, by its unit: it may have dry friction"
A_SPECIES = "an amount, by its capital; order 2 for a position"
VELOCITIES = re.compile(r"(.*_)?(v|vel|velocity|speed|omega|rate|dot)(_?\d+|_[a-z]{1,3})?", re.IGNORECASE)
A_TIME = re.compile(r".*(/ ?(s|sec|min|h|hr|d|day)|\b(s|min|h|d)(\^?-1|⁻¹)|rpm|Hz)")
SPEEDS = frozenset({"m/s", "mm/s", "km/h", "rad/s", "deg/s", "°/s", "rpm", "1/min"})


@dataclass(frozen=True)
class Seen:
    """What a column looks like.

    Attributes:
        name: for formulae.
        heading: its label, taken apart.
        role: what it may be.
        why: in words, what that rests on.
        order: of the equation of a coordinate.
        angle: whether it is one.
        degrees: whether it is in degrees.
        held: whether an input is held between samples.
    """

    name: str
    heading: Heading
    role: Role
    why: str
    order: int = 1
    angle: bool = False
    degrees: bool = False
    held: bool = False


def look(records: Records, headings: Mapping[str, Heading]) -> tuple[Seen, ...]:
    """Return what each column of records looks like, in their order.

    Args:
        records: uniformly sampled, with all columns that hold numbers.
        headings: of the columns, by their names in the records.
    """
    columns = {name: [run.column(name) for run in records] for name in records.names}
    useless = {name: why for name in columns if (why := _useless(name, columns, headings))}
    moving = {name: own for name, own in columns.items() if name not in useless}
    turns = {name: _wraps(own) for name, own in moving.items()}
    conditions = {name for name, own in moving.items() if _is_condition(own)}
    held = {name for name, own in moving.items() if name in conditions or _held(own)}
    wanted = {name for name in moving if WANTED & set(headings[name].name.casefold().split("_"))}
    named = wanted | {name for name in moving if COMMANDS.fullmatch(headings[name].name)}
    geometric = {name for name in moving if turns[name] is not None or _is_geometric(headings[name])}
    driving = {name for name in moving if _drives(headings[name])}
    white = {name for name, own in moving.items() if _is_white(own)} - held
    # Where a rig rests for long its position does, too, and goes on from there; a command goes anywhere.
    jumps = conditions | {name for name in held - conditions if turns[name] is None and not _follows(moving[name])}
    commands = ((held | named | driving) - geometric) | wanted | white | jumps
    if not set(moving) - commands:  # something is to be explained: what nothing but its heading makes a command
        commands = held
    smooth = [name for name in moving if name not in commands and turns[name] is None]
    filtered = _filtered(records, smooth)
    rates = _rates(filtered, headings)
    found = []
    for name in columns:
        heading = headings[name]
        if name in useless:
            found.append(Seen(name, heading, "neither", useless[name]))
        elif name in rates:
            found.append(Seen(name, heading, "neither", f"the rate of {rates[name]}, which is found from it"))
        elif name in commands:
            by_heading = "a command, by its name" if name in named else "a force or torque, by its unit"
            why = NOISE if name in white - named - driving else by_heading
            why = "held between its samples, as a command is" if name in held else why
            why = A_CONDITION if name in conditions else why
            found.append(Seen(name, heading, "input", why, held=name in held))
        else:
            seen = _coordinate(name, heading, turns[name], set(rates.values()))
            if seen.why == BY_NAME and name not in filtered and SPECIES.fullmatch(heading.name):
                seen = replace(seen, order=1, why=A_SPECIES)
            elif seen.why == BY_NAME and _is_amount(name, filtered, rates):
                seen = replace(seen, order=1, why="an amount: its rate follows from the values; order 2 for a position")
            if seen.why == AN_UNKNOWN and len(moving) == 1 and _swings(name, filtered):
                seen = replace(seen, order=2, why="it swings by itself, as nothing of order 1 does")
            if seen.why == AN_UNKNOWN and may_be_kelvins(heading.name, np.concatenate(moving[name])):
                seen = replace(seen, why=A_TEMPERATURE)
            slow = ", read more often than it is measured" if is_slow(moving[name]) and _follows(moving[name]) else ""
            unclear = seen.angle and degrees_hints(records, [Coordinate(name, 2, True, unit=heading.unit)])
            doubt = ', in degrees? Then add unit = "deg"' if unclear else ""
            found.append(replace(seen, why=seen.why + slow + doubt))
    return tuple(found)


def _useless(name: str, columns: Mapping[str, Sequence[FloatArray]], headings: Mapping[str, Heading]) -> str:
    """Return why a column says nothing of its own; no text where it may."""
    own = columns[name]
    joined = np.concatenate(own)
    if np.ptp(joined) <= FLAT * np.abs(joined).max(initial=0.0):
        return f"constant, {joined[0]:.6g}"
    if _is_condition(own):
        if headings[name].unit is None and _counts(own):
            return "counts recordings"
    elif all(np.ptp(np.diff(part)) == 0.0 for part in own):
        return "counts samples"
    for other in columns:
        if other == name:
            return ""
        twin = np.concatenate(columns[other])
        (one, first), (two, second) = ((joined.mean(), joined.std()), (twin.mean(), twin.std()))
        if second > 0.0 and 1.0 - abs(float(np.mean((joined - one) * (twin - two)))) / (first * second) < SAME:
            return f"the same as {headings[other].label}"
    return ""


def _is_condition(own: Sequence[FloatArray]) -> bool:
    """Tell whether a column keeps one value in each recording, and not the same in all, as what an experiment is at."""
    least = FLAT * float(np.abs(np.concatenate(own)).max(initial=0.0))
    return all(np.ptp(part) <= least for part in own) and np.ptp([part[0] for part in own]) > least


def _counts(own: Sequence[FloatArray]) -> bool:
    """Tell whether values that are constant within each recording number these, from 0 or 1 on."""
    values = np.array([part[0] for part in own])
    return values[0] in (0.0, 1.0) and set(np.diff(values)) <= {0.0, 1.0}


def _wraps(own: Sequence[FloatArray]) -> float | None:
    """Return the turn that a column jumps by, where it jumps by no less; None for one that does not."""
    steps = np.abs(np.concatenate([np.diff(part) for part in own]))
    for turn in WRAPS:
        wraps = np.abs(steps - turn) < NEAR_WRAP * turn
        if wraps.any() and not np.any(steps[~wraps] > BIG * turn):
            return turn
    return None


def repeats(*own: FloatArray) -> float:
    """Return the share of the samples (N,) of records that equal the one before, 0 where none has one before it."""
    same = np.concatenate([np.diff(part) == 0.0 for part in own])
    return float(np.mean(same)) if len(same) else 0.0


def _held(own: Sequence[FloatArray]) -> bool:
    """Tell whether a column repeats itself as a command does, which a sensor that is slow does, too."""
    jumps = np.concatenate([np.abs(np.diff(part)) for part in own])
    # The steps of a coarse encoder are of one or two sizes, all of the least.
    coarse = np.mean(jumps[jumps > 0.0] < 2.5 * jumps[jumps > 0.0].min()) > HELD
    levels = len(np.unique(np.concatenate(own)))
    return bool(repeats(*own) > HELD and (levels <= 2 or not (_follows(own) and (coarse or is_slow(own)))))


def _is_white(own: Sequence[FloatArray]) -> bool:
    """Tell whether a column is noise: whatever moves goes on from one sample to the next."""
    steps = np.concatenate([np.diff(part) for part in own])
    return len(steps) >= WHITE_FROM and bool(np.mean(steps**2) > WHITE * np.concatenate(own).var())


def _follows(own: Sequence[FloatArray]) -> bool:
    """Tell whether new values go on from the ones before, as those of a motion do and those of a command need not."""
    new = [part[np.flatnonzero(np.diff(part, prepend=np.nan))] for part in own]
    spread = np.concatenate(new).var()
    return bool(np.mean(np.concatenate([np.diff(part) for part in new]) ** 2) < FOLLOWS * spread)


def _filtered(records: Records, names: Sequence[str]) -> Filtered:
    """Return values and rates (2, n) of each record by the columns; none where a record is too short for any."""
    if not names or min(len(run) for run in records) < 4 * INSIDE.start:
        return {}
    found = {n: measured_derivatives(records, Coordinate(n), Spectral()).values for n in names}
    return {n: [np.stack([v[0][INSIDE], v[1][INSIDE]]) for v in own] for n, own in found.items()}


def _is_amount(name: str, filtered: Filtered, rates: Mapping[str, str]) -> bool:
    """Tell whether the rate of a column follows from its value, and from those of the others that are no rates."""
    if name not in filtered:
        return False
    others = [own for n, own in filtered.items() if n not in rates]
    values = [np.stack([own[k][0] for own in others]) for k in range(len(filtered[name]))]
    return rate_explained([own[1] for own in filtered[name]], values) > AN_AMOUNT


def _swings(name: str, filtered: Filtered) -> bool:
    """Tell whether a column goes up and down by more than its range."""
    own = [values[0] for values in filtered.get(name, ())]
    way = sum(float(np.abs(np.diff(y)).sum()) for y in own)
    return way > SWINGS * sum(float(np.ptp(y)) for y in own)


def _rates(filtered: Filtered, headings: Mapping[str, Heading]) -> dict[str, str]:
    """Return the columns that hold the rate of another, in whatever unit, and of which."""
    joined = {n: np.concatenate(own, axis=1) for n, own in filtered.items()}
    given = dict[str, str]()
    for name in joined:
        best = A_RATE
        for other in joined:
            slope, share = slope_and_share(joined[other][1], joined[name][0])
            told = other != name and slope > 0.0 and share > best and given.get(other) != name
            if told and _may_be_rate(headings[name], headings[other], slope):
                given[name], best = other, share
    return given


def _may_be_rate(rate: Heading, of: Heading, slope: float) -> bool:
    """Tell whether a column may be a velocity, and not an amount whose rate of change another is in proportion to.

    Args:
        rate: its heading.
        of: that of the other.
        slope: of the rate of the other on the column.
    """
    if VELOCITIES.fullmatch(rate.name) is not None:
        return True  # as v_mm, in mm/s
    if rate.unit is not None:
        return rate.unit != of.unit and A_TIME.fullmatch(rate.unit) is not None
    return of.unit is not None or abs(slope - 1.0) < NEAR_ONE


def _drives(heading: Heading) -> bool:
    """Tell whether a heading is that of a force or torque, by its unit."""
    return FORCES.fullmatch(heading.unit or "") is not None


def _is_geometric(heading: Heading) -> bool:
    """Tell whether a heading is that of a length or an angle, by its unit, or by its name where it has none."""
    if heading.unit is None:
        return ANGLES.fullmatch(heading.name) is not None
    if VELOCITIES.fullmatch(heading.name) is not None:
        return False  # omega_deg is in deg/s
    return heading.unit in LENGTHS or heading.unit == "rad" or is_degrees(heading.unit)


def _coordinate(name: str, heading: Heading, turn: float | None, with_rate: set[str]) -> Seen:
    """Return what a coordinate is: an angle, a position, an amount."""
    unit, degrees = heading.unit, is_degrees(heading.unit) or turn == WRAPS[1]
    if turn is not None or (_is_geometric(heading) and unit not in LENGTHS):
        wraps = "it wraps by 360" if degrees else "it wraps by 2 pi"
        why = wraps if turn is not None else "by its name" if unit is None else "by its unit"
        return Seen(name, heading, "coordinate", f"an angle, {why}", 2, True, degrees)
    if unit in LENGTHS and LEVELS.fullmatch(heading.name) is not None:
        return Seen(name, heading, "coordinate", A_LEVEL)
    if unit in LENGTHS and _is_geometric(heading):
        return Seen(name, heading, "coordinate", "a position, by its unit", 2)
    if name in with_rate:
        return Seen(name, heading, "coordinate", "a position: its rate was measured, too", 2)
    if unit in SPEEDS:
        return Seen(name, heading, "coordinate", A_SPEED)
    if unit is None and POSITIONS.fullmatch(heading.name):
        return Seen(name, heading, "coordinate", BY_NAME, 2)
    return Seen(name, heading, "coordinate", AN_UNKNOWN)
