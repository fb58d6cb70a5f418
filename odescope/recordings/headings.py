"""Column headings that hold more than a name: "x (m)", "Motor angle [deg]", "theta_deg", "time_ms"."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from odescope.errors import InputError

SINCE = (1e8, 1e10)  # seconds from 1970 on: numbers that are such in parts of a second are no times of experiments
TimeUnit = Literal["s", "ms", "us", "ns", "min", "h", "d"]

_TIMES: dict[TimeUnit, tuple[str, ...]] = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "millis", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "usecs", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nanos", "nanosecond", "nanoseconds"),
    "min": ("min", "mins", "minute", "minutes"),
    "h": ("h", "hr", "hrs", "hour", "hours"),
    "d": ("d", "day", "days"),
}
# Times and over: a division by 1000 is exact where the number of seconds has a short decimal, a product with 0.001 not.
_SECONDS: dict[TimeUnit, tuple[float, float]] = {
    "s": (1.0, 1.0),
    "ms": (1.0, 1e3),
    "us": (1.0, 1e6),
    "ns": (1.0, 1e9),
    "min": (60.0, 1.0),
    "h": (3600.0, 1.0),
    "d": (86400.0, 1.0),
}
UNITS_OF_TIME: tuple[TimeUnit, ...] = tuple(_TIMES)
_PARTS: tuple[TimeUnit, ...] = ("ms", "us", "ns")
_WITHOUT_BRACKETS = ("s", "ms", "us", "ns")  # in t_min the rest may be the least of something
_OVER = re.compile(r"\s*(?:t|time|zeit|temps)\s*/\s*(\w+)\s*", re.IGNORECASE)  # as ISO 80000 has it: t/min
_JOINED = re.compile(r"(?:.*(?:time|stamp|clock|zeit|temps)|t)([mµμun]s|[mu]sec|millis|micros|nanos)")  # TimeUS, timeMs
_OF_DATES = re.compile(  # zones, and forms such as yyyy-mm-dd HH:MM:SS
    r"(?:utc|gmt)(?:\s*[+-−]\s*\d{1,2}(?::?\d\d)?)?|local(?: time)?|z|iso(?:[ -]?8601)?"
    r"|[aecmpw]k?[sd]t|[ecw]es?t|[bhijk]st|mesz|mez"
    r"|[ymdhsfa]{2,4}(?:[-./:, t_]+[ymdhsfa]{1,4})+",
    re.IGNORECASE,
)
_BRACKETED = re.compile(r"^(.*?)\s*[\[({]\s*([^\[\](){}]*?)\s*[\])}]\s*$", re.DOTALL)
_LAST = re.compile(  # without brackets: words that name nothing but a unit, as cm, bar or K may
    r"(.*[^\W_].*?)[\s_.-]+(deg|degs|degrees?|rad|radians?|rpm|deg[CF]|mm|Nm|kN|[hkM]Pa|mbar|psi|m[AV]|k?Hz|kg|k[VW])"
)
_EXPONENT = re.compile(r"\^?[-+−]?\d+|[⁻⁺]?[⁰¹²³⁴-⁹]+")
_PREFIXED = re.compile(
    r"(?:[fpnuµμmcdhkMGT]|da)?(?:m|g|s|A|K|mol|cd|Hz|N|Nm|Pa|J|W|Wh|C|V|F|Ω|Ohm|ohm|S|T|H|L|l|rad|bar|eV|M|U)"
)
_WHOLE = frozenset(
    [
        "1",
        "-",
        "%",
        "°",
        "deg",
        "degs",
        "degree",
        "degrees",
        "rev",
        "rpm",
        "turn",
        "turns",
        "°C",
        "°F",
        "degC",
        "degF",
        "psi",
        "min",
        "h",
        "hr",
        "d",
        "day",
        "days",
        "in",
        "ft",
        "lb",
        "lbf",
        "t",
        "sec",
        "msec",
        "usec",
        "meter",
        "meters",
        "metre",
        "metres",
        "millimeter",
        "millimeters",
        "second",
        "seconds",
        "volt",
        "volts",
        "newton",
        "newtons",
        "radian",
        "radians",
        "ampere",
        "amperes",
        "amp",
        "amps",
        "watt",
        "watts",
        "pascal",
        "kelvin",
        "celsius",
        "IU",
        "cal",
        "kcal",
        "ppm",
        "ppb",
        "atm",
        "mmHg",
        "mph",
        "kn",
        "rps",
        "counts",
        "gon",
        "grad",
        "Grad",
        "ticks",
        "steps",
        "pulses",
        "cells",
    ]
)


@dataclass(frozen=True)
class Heading:
    """A column's label taken apart: a plain name, usable in formulae, and the unit, in brackets or as the last word."""

    label: str
    name: str
    unit: str | None

    @staticmethod
    def of(label: str) -> Heading:
        """Return the parts of a label; what stands in brackets and is no unit belongs to the name."""
        found = _BRACKETED.match(label) or _LAST.fullmatch(label)
        if found is None or not (found[2] == "" or is_unit(found[2])):
            return Heading(label, plain_name(label), None)
        return Heading(label, plain_name(found[1]), found[2] or None)


def plain_name(text: str) -> str:
    """Return a name for formulae: ASCII letters, digits and underscores; Greek letters by their names."""
    spelled = "".join(_greek(c) for c in unicodedata.normalize("NFKD", text))
    name = re.sub(r"[^A-Za-z0-9_]+", "_", spelled.encode("ascii", "ignore").decode()).strip(
        "_" if not text.startswith("_") else ""
    )
    return f"_{name}" if name[:1].isdigit() else name


def _greek(character: str) -> str:
    found = re.fullmatch(r"GREEK (?:SMALL|CAPITAL) LETTER (?:FINAL )?(\w+)", unicodedata.name(character, ""))
    return character if found is None else found[1].lower() if character.islower() else found[1].capitalize()


def is_unit(text: str) -> bool:
    """Return whether a text is a unit, such as m/s^2, N m or deg."""
    parts = [p for p in re.split(r"[\s/*·.]+", _EXPONENT.sub(" ", text) if text != "1" else text) if p]
    return bool(parts) and all(p in _WHOLE or _PREFIXED.fullmatch(p) for p in parts)


def time_unit(label: str) -> TimeUnit | None:
    """Return the unit that the heading of a column of time names, in brackets or as its last word; None for none."""
    heading = Heading.of(label)
    if heading.unit is not None:
        return named_time_unit(heading.unit.casefold())
    over, last = _OVER.fullmatch(label), _last_word(label)
    if (joined := _JOINED.fullmatch(last)) is not None:
        last = joined[1]
    known = UNITS_OF_TIME if over is not None else _WITHOUT_BRACKETS
    return next((unit for unit, words in _TIMES.items() if last in words and unit in known), None)


def named_time_unit(word: str) -> TimeUnit | None:
    """Return the unit of time that a word, in small letters, names; None where it names none."""
    return next((unit for unit, words in _TIMES.items() if word in words), None)


def doubtful_time_unit(label: str) -> str | None:
    """Return what the heading of a column of time may name as its unit without its being taken for one; None for none.

    That is what stands in brackets and is no unit of time that is known, nor the zone or the form of dates; or a last
    word such as hours.
    """
    if time_unit(label) is not None:
        return None
    found, last = _BRACKETED.match(label), _last_word(label)
    if found is not None:
        return None if not found[2] or _OF_DATES.fullmatch(found[2]) else found[2]
    named = last not in ("d", "day")  # as in time_of_day, and where the days are dates
    return last if named and named_time_unit(last) is not None else None


def _last_word(label: str) -> str:
    return re.split(r"[\s_./-]+", label.strip().casefold())[-1]


def in_seconds(unit: TimeUnit) -> tuple[float, float]:
    """Return what a time in a unit is to be multiplied with, and then divided by, to be in seconds."""
    return _SECONDS[unit]


def told_in_seconds(unit: TimeUnit) -> str:
    """Return the words that times in a unit are in seconds, and, of a longer one, how coefficients are read in it."""
    more, fewer = in_seconds(unit)
    read = f" (a coefficient times {more:g} for each 1/s in its unit is one per {unit})" if more > fewer else ""
    return f"time was recorded in {unit}: in files and notes it is in seconds{read}"


def since_1970(time: float) -> TimeUnit | None:
    """Return the unit in which a time is one from 1973 to 2286, counted from 1970 on; None for seconds and all else."""
    return next((unit for unit in _PARTS if SINCE[0] < time / in_seconds(unit)[1] < SINCE[1]), None)


def check_time_unit(unit: str) -> None:
    """Refuse what is no unit of time."""
    if unit not in UNITS_OF_TIME:
        raise InputError(f"time_unit must be one of {', '.join(map(repr, UNITS_OF_TIME))}, got {unit!r}")


def find_label(wanted: str, labels: Sequence[str], source: str) -> str | None:
    """Return the label that is meant by one, itself or the one with the same plain name; None where there is none.

    Args:
        wanted: as a study or a command line spells it.
        labels: of the columns.
        source: where these are, for messages.

    Raises:
        InputError: several have that name.
    """
    if wanted in labels:
        return wanted
    name = Heading.of(wanted).name
    meant = [label for label in dict.fromkeys(labels) if name and Heading.of(label).name == name]
    if len(meant) > 1:
        raise InputError(
            f"{wanted!r} may be {' or '.join(map(repr, meant))} in {source}: name the column as it is spelled there"
        )
    return meant[0] if meant else None
