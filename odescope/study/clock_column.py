"""Which column of a data file holds the time, and in which unit: what a study is drafted with."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.dates import DAY
from odescope.recordings.headings import Heading, TimeUnit, doubtful_time_unit, since_1970, time_unit

TIMES = re.compile(
    r"(t|time|timestamp|date|datetime|datum|zeit|uhrzeit|zeitstempel|temps|clock|stamp)(_.*)?", re.IGNORECASE
)
DAYS = re.compile(r"(date|datetime|datum)(_.*)?", re.IGNORECASE)
SERIAL = 20_000.0, 80_000.0  # days since 1899, as spreadsheets count dates: 1954 to 2119
STEADY = 4.0  # times the median: no step of a clock that nobody calls one is longer
FEW = 8  # steps, that are even by chance
BACK = 0.25  # of the steps go back of what is no clock, however it is called: T may be a temperature


@dataclass(frozen=True)
class ClockColumn:
    """The column of the time, its unit and what that rests on, and that of the day beside a clock; None for none.

    `counts` is the column that counts the rows where none holds the time.
    """

    label: str | None
    unit: TimeUnit
    why: str
    date: str | None = None
    counts: str | None = None


def clock_of(columns: dict[str, FloatArray], dated: Sequence[str]) -> ClockColumn:
    """Return the column of the time: by its name, else one of dates, else one that grows in even steps.

    A column that is called so and is in a unit of something else, or often goes back, is none.

    Args:
        columns: the numbers in each (N,).
        dated: those that hold dates.
    """
    moving = [label for label, values in columns.items() if np.any(np.diff(values) > 0.0)]
    for label in moving:
        heading = Heading.of(label)
        if (heading.unit is not None and time_unit(label) is None) or _goes_back(columns[label]):
            continue
        if label not in dated and (TIMES.fullmatch(heading.name) or (time_unit(label) and heading.unit is None)):
            return _clock(label, values=columns[label])
    days = [label for label in dated if not np.any(np.mod(columns[label], DAY))]
    for label in sorted((m for m in moving if m in dated), key=days.__contains__):  # a column of days alone comes last
        clock = len(days) == 1 and label not in days and columns[label].max() < DAY
        return ClockColumn(label, "s", "dates or a clock, in seconds", days[0] if clock else None)
    for label, values in columns.items():
        steps = np.diff(values)
        if len(steps) and np.all(steps > 0.0) and steps.max() < STEADY * np.median(steps) and values[0] == 0.0:
            if np.all(steps == 1.0):
                return ClockColumn(None, "s", "", counts=label)
            return _clock(label, "in seconds? It grows in even steps: say in time_unit what in")
    return ClockColumn(None, "s", "")


def clock_in_disorder(columns: dict[str, FloatArray]) -> str | None:
    """Return a column that is called a time and is one but for the order of its rows, None where there is none.

    Its values, sorted, grow in even steps; what is in a unit of something else, or called T, as temperatures are, is
    none.

    Args:
        columns: the numbers in each (N,).
    """
    for label, values in columns.items():
        heading, steps = Heading.of(label), np.diff(np.sort(values))
        timed = time_unit(label) is not None or (heading.unit is None and TIMES.fullmatch(heading.name) is not None)
        if (
            timed
            and heading.name != "T"
            and len(steps) >= FEW
            and np.all(steps > 0.0)
            and steps.max() < STEADY * np.median(steps)
        ):
            return label
    return None


def _clock(label: str, why: str = "", values: FloatArray | None = None) -> ClockColumn:
    """Return the column of the time.

    Args:
        label: its own.
        why: what makes it that, where its heading does not say its unit.
        values: the numbers in it, where it is called a time.
    """
    if values is not None and DAYS.fullmatch(Heading.of(label).name) and time_unit(label) is None:
        if SERIAL[0] < np.nanmin(values) and np.nanmax(values) < SERIAL[1]:
            return ClockColumn(label, "d", "days since 1899, it seems, as spreadsheets count them")
        why = "in seconds? Its heading says a date: say which unit in time_unit"
    counted = None if values is None else since_1970(float(np.nanmin(values)))
    if counted is not None and time_unit(label) is None:
        return ClockColumn(label, counted, f"{counted} since 1970, it seems")
    unit, doubt = time_unit(label), doubtful_time_unit(label) or next(iter({"d", "day"} & {label.casefold()}), None)
    if doubt:
        why = f"in seconds? Its heading says {doubt}: say which in time_unit"
    return ClockColumn(label, unit or "s", why if unit in (None, "s") else f"its heading says {unit}")


def _goes_back(values: FloatArray) -> bool:
    """Tell whether numbers (N,) go back too often for a clock, which does so where a recording begins."""
    back, on = np.count_nonzero(np.diff(values) < 0.0), np.count_nonzero(np.diff(values) > 0.0)
    return bool(back > BACK * (back + on))
