"""What commands say of a model and the data that it is run on: options, labels, and how sensors read its states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError, nearest
from odescope.model.model import Model
from odescope.model.quantity_units import quantity_units, shown
from odescope.model.recorded import TimeColumns, in_degrees, time_label, time_unit_of
from odescope.recordings.dates import to_text
from odescope.recordings.headings import TimeUnit, in_seconds
from odescope.recordings.readers import date_zone
from odescope.recordings.record import Record


def label_of(run: Record, files: Sequence[Path], recording: str) -> str:
    """Return what the column `recording` says of a run: the reader leaves it in the run's source.

    Args:
        run: that was read.
        files: it was read from one of them; of a folder, the file is named.
        recording: the column.
    """
    source = run.source
    for file in files:
        source = source.removeprefix(file.name)
    return source.partition(f" ({recording} ")[2].removesuffix(")")


def named_numbers(option: str, texts: Sequence[str], known: Sequence[str], what: str) -> dict[str, float]:
    """Return the numbers of options NAME=NUMBER by name.

    Args:
        option: as it is spelled.
        texts: what came after each.
        known: the names that there are.
        what: one of them is.

    Raises:
        InputError: a name that is not known or given twice, or no finite number.
    """
    given: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        name = name.strip()
        if name in given:
            raise InputError(f"{option} {name} is given twice")
        if name not in known:
            raise InputError(f"{option} {text}: {name!r} is no {what} of the model; {nearest(name, known)}")
        try:
            given[name] = float(value)
        except ValueError:
            raise InputError(f"{option} {text}: expected {what.upper()}=NUMBER, such as {name}=0.5") from None
        if not np.isfinite(given[name]):
            raise InputError(f"{option} {text}: the number must be finite")
    return given


@dataclass(frozen=True)
class TimeCells:
    """The column of the time in results, as it is in the data.

    Attributes:
        label: its name there, else t.
        unit: of its numbers.
        zoned: whether its dates name their zone; None where it holds numbers.
    """

    label: str
    unit: TimeUnit
    zoned: bool | None

    @staticmethod
    def of(model: Model, data: Path, given: TimeColumns) -> TimeCells:
        """Return the column of a file.

        Args:
            model: that was identified with some column.
            data: a file.
            given: by the command line.
        """
        label = time_label(model, data, given)
        if label is None:
            return TimeCells("t", "s", None)
        return TimeCells(label, time_unit_of(model, data, given), date_zone(data, label))

    def written(self, t: FloatArray) -> list[str]:
        """Return times in seconds (N,) as cells, as few digits as tell them apart: 1.001 s are 1001 ms."""
        if self.zoned is not None:
            return to_text(t, self.zoned)
        factor, over = in_seconds(self.unit)
        return [repr(v) if self.unit == "s" else repr(float(f"{v:.15g}")) for v in (t * over / factor).tolist()]

    @property
    def told(self) -> str:
        """What is said of it: the unit of numbers, or that it holds dates."""
        return f"{self.label} in {self.unit}" if self.zoned is None else f"{self.label} as dates"


def units_told(model: Model, time: TimeCells) -> list[str]:
    """Return a line on what results are in, the time and every state whose unit is known; none for bare seconds."""
    units = units_read(model)
    known = [f"{s} in {units[s]}" for s in model.states if units[s]]
    return [f"columns: {', '.join([time.told, *known])}"] if known or time.told != f"{time.label} in s" else []


def units_read(model: Model) -> dict[str, str]:
    """Return the unit of every state, target and input as its column has it; "" where it is not known."""
    degrees = in_degrees(model)
    read = (msgspec.structs.replace(c, unit="deg") if c.name in degrees else c for c in model.coordinates)
    return {name: shown(unit) for name, unit in quantity_units(replace(model, coordinates=tuple(read))).items()}


def column_units(model: Model) -> dict[str, float]:
    """Return what the unit of a column is in the model's, by state and target: degrees where these were recorded."""
    degrees = in_degrees(model)
    names = ((name, c.name in degrees) for c in model.coordinates for name in (*c.states, c.target))
    return {name: np.pi / 180.0 if turned else 1.0 for name, turned in names}


def given_noise(model: Model, texts: Sequence[str]) -> dict[str, float]:
    """Return the noise of coordinates in the units of the model, given as NAME=NUMBER in those of the columns.

    Args:
        model: whose coordinates are meant.
        texts: of `--noise`.

    Raises:
        InputError: see `named_numbers`.
    """
    given = named_numbers("--noise", texts, [c.name for c in model.coordinates], "coordinate")
    units = column_units(model)
    return {name: number * units[name] for name, number in given.items()}


@dataclass(frozen=True, eq=False)
class Sensors:
    """What sensors read of states (n,): `offset` more, in units of `unit` radians or of one."""

    offset: FloatArray
    unit: FloatArray

    @staticmethod
    def of(model: Model) -> Sensors:
        """Return the sensors of a model's states, those of angles in degrees where it was identified from such."""
        more, units = {c.name: c.offset for c in model.coordinates}, column_units(model)
        offset, unit = [more.get(s, 0.0) for s in model.states], [units[s] for s in model.states]
        return Sensors(np.array(offset), np.array(unit))

    def read(self, states: FloatArray) -> FloatArray:
        """Return the readings of states (N, n)."""
        found: FloatArray = (states + self.offset) / self.unit
        return found

    def state(self, k: int, reading: float) -> float:
        """Return the k-th state from its reading."""
        return float(reading * self.unit[k] - self.offset[k])
