"""What stands at the head of every file that is written of a model."""

from __future__ import annotations

from collections.abc import Sequence

from odescope.model.model import Model
from odescope.model.recorded_time import recorded_unit
from odescope.recordings.headings import told_in_seconds

ASCII = {"°": "deg", "µ": "u", "μ": "u", "Ω": "Ohm", "·": "*"}  # of units; both letters mu are in use


def about(model: Model, renamed: Sequence[str] = ()) -> tuple[str, ...]:
    """Return lines on states, inputs, time and where the model holds, and on names that are written otherwise."""
    units = {c.name: c.unit for c in model.coordinates} | {i.name: i.unit for i in model.inputs}

    def called(name: str) -> str:
        unit = units.get(name)
        return f"{name} [{_plain(unit)}]" if unit else name

    lines = ["Equations of motion, written by odescope.", "", f"States: {', '.join(map(called, model.states))}"]
    lines += [f"Inputs: {', '.join(called(i.name) for i in model.inputs) or 'none'}"]
    for i in model.inputs:
        shifted = f", acts {abs(float(i.delay))!r} s {'after' if i.delay > 0.0 else 'before'} it was recorded"
        lines.append(f"  {i.name}: {i.hold} between samples{shifted if i.delay else ''}")
    for c in model.coordinates:
        if c.offset:
            lines.append(f"  a sensor reads {float(c.offset)!r} more than {c.name}")
    lines += [f"Time: seconds{_recorded_in(model)}"]
    if model.domain:
        lines.append("Ranges in the data that the model comes from:")
        for name, (low, high) in model.domain.items():
            lines.append(f"  {_plain(name)}: {float(low)!r} to {float(high)!r}")
    if renamed:
        lines += ["Names that this language reserves:", *(f"  {line}" for line in renamed)]
    return tuple(lines)


def _recorded_in(model: Model) -> str:
    """Return in which unit the time of the log was, where not in seconds, and how rates are read in it."""
    unit = recorded_unit(model)
    return "" if unit == "s" else f" ({told_in_seconds(unit)})"


def _plain(text: str) -> str:
    """Return text that neither ends a comment of any language nor leaves ASCII or the line."""
    for sign, spelled in ASCII.items():
        text = text.replace(sign, spelled)
    kept = "".join(c if c.isascii() and c.isprintable() else "?" for c in text)
    for mark in ("*/", "/*", "=#", "#=", "%{", "%}"):
        kept = kept.replace(mark, f"{mark[0]} {mark[1]}")
    return kept.replace('"', "'").replace("\\", "/")
