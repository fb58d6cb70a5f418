"""Units of states and inputs: those that are given, and kelvins of what name and size show to be a temperature."""

from __future__ import annotations

import re

from odescope.arrays import FloatArray
from odescope.pipeline.filtering import Filtered

NAMED = re.compile(r"t(_?\w{1,2}|_\w+)?|temp\w*", re.IGNORECASE)  # T, T1, Tc, T_in, temp, temperature
KELVINS = (200.0, 3000.0)  # what is called so and stays between these is in kelvins


def units_of(filtered: Filtered) -> dict[str, str | None]:
    """Return the units of states and inputs by name, kelvins where none is given but name and values say so."""
    signals = filtered.signals
    given = {c.name: c.unit for c in signals.coordinates} | {i.name: i.unit for i in filtered.inputs}
    return {name: unit or _kelvins(name, signals.joined()[signals.row(name)]) for name, unit in given.items()}


def _kelvins(name: str, values: FloatArray) -> str | None:
    warm = KELVINS[0] < values.min() and values.max() < KELVINS[1]
    return "K" if warm and NAMED.fullmatch(name) else None
