"""Units of states and inputs: those that are given, and kelvins of what name and size show to be a temperature."""

from __future__ import annotations

from odescope.pipeline.filtering import Filtered
from odescope.recordings.checks import may_be_kelvins


def units_of(filtered: Filtered) -> dict[str, str | None]:
    """Return the units of states and inputs by name, None of what has none and is no temperature by name and size.

    The rate of a coordinate has one in any case, so it is no angle.
    """
    signals = filtered.signals
    given = {c.name: c.unit for c in signals.coordinates} | {i.name: i.unit for i in filtered.inputs}
    given |= {c.derivative(k): f"{c.unit or 1}/s^{k}" for c in signals.coordinates for k in range(1, c.order)}
    bare = {name for name, unit in given.items() if unit is None}
    warm = {name for name in bare if may_be_kelvins(name, signals.joined()[signals.row(name)])}
    return {name: "K" if name in warm else unit for name, unit in given.items()}
