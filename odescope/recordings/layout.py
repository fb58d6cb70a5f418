"""Layout: which columns of a file mean what."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

from odescope.errors import InputError, nearest
from odescope.recordings.gaps import Gaps
from odescope.recordings.headings import TimeUnit, check_time_unit


@dataclass(frozen=True, slots=True)
class Layout:
    """Which columns of a file mean what, and what to do about gaps and jitter.

    `columns` and `units` are pairs (name in odescope, column in the file) and (name, unit); `angles`, `held` and
    `inputs` hold names in odescope, `degrees` those of angles to convert to radians; `jitter` is a limit in sample
    periods, None for none; `time_unit` is that of the column `time`; `time`, `date` and `recording` are columns in the
    file, or `recording` a folder's key (lap=7/a.parquet). `date` holds the day where `time` holds a clock. `loose` are
    columns in a text file whose cells count as missing where they are no numbers, and are not refused.

    Raises:
        InputError: not exactly one of `time` and `sample_period`, no column, a tolerance or period out of range.
    """

    time: str | None = None
    sample_period: float | None = None
    columns: tuple[tuple[str, str], ...] = ()
    units: tuple[tuple[str, str], ...] = ()
    angles: frozenset[str] = frozenset()
    degrees: frozenset[str] = frozenset()
    held: frozenset[str] = frozenset()
    inputs: frozenset[str] = frozenset()
    recording: str | None = None
    gaps: Gaps = "bridge"
    jitter: float | None = None
    time_unit: TimeUnit = "s"
    date: str | None = None
    loose: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if (self.time is None) == (self.sample_period is None):
            came = (
                "both came" if self.time else "neither came: `odescope init FILE` drafts a study with the one it finds"
            )
            raise InputError(f"[data] needs exactly one of time (a column's name) and sample_period (a number); {came}")
        if self.sample_period is not None and not 0 < self.sample_period < float("inf"):
            raise InputError(f"sample_period must be a positive number, got {self.sample_period!r}")
        if not self.columns:
            raise InputError("no column to read: name at least one coordinate")
        if self.gaps not in get_args(Gaps):
            raise InputError(f"gaps must be 'bridge', 'split' or 'refuse', got {self.gaps!r}")
        if self.jitter is not None and not 0 <= self.jitter < float("inf"):
            raise InputError(f"jitter must be a number of sample periods, 0 or more, got {self.jitter!r}")
        check_time_unit(self.time_unit)
        for name in (*dict(self.units), *self.angles, *self.degrees, *self.held, *self.inputs):
            if name not in self.names:
                raise InputError(
                    f"the layout names {name!r}, which is not among its columns; {nearest(name, self.names)}"
                )

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns in odescope."""
        return tuple(name for name, _ in self.columns)

    @property
    def numeric(self) -> tuple[str, ...]:
        """The file's columns that must hold numbers, each once."""
        time = () if self.time is None else (self.time,)
        return tuple(dict.fromkeys((*time, *(column for _, column in self.columns))))

    @property
    def used(self) -> tuple[str, ...]:
        """The file's columns that are read at all, each once."""
        beside = (label for label in (self.date, self.recording) if label is not None)
        return tuple(dict.fromkeys((*self.numeric, *beside)))
