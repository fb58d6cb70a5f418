"""A function for exported modules in Python: recorded inputs, laid out as they act."""

from __future__ import annotations

from odescope.export.band_limited import BEFORE, band_limited_weights
from odescope.model.model import Model

_ACTING = """
def acting(t, u):
    \"""Lay recorded inputs out as they act, late by DELAYS and between samples as HOLDS says.

    t (N,) are the times of a record, ascending, and u (N, {m}) its inputs. Return times (K,) since t[0] between which
    every input is a line; its values just after each time but the last, and just before the next, both (K - 1, {m});
    and which of the times the samples are (N,). Before its first sample an input has the value of the first.
    \"""
    t = numpy.asarray(t, dtype=float)
    u, since = numpy.asarray(u, dtype=float).reshape(len(t), {m}), t - t[0]
    corners = [{corners} for k in range({m})]
    times = numpy.unique(numpy.concatenate([since, *(at + DELAYS[k] for k, (at, _) in enumerate(corners))]))
    times = times[(times >= 0.0) & (times <= since[-1])]
    same = 1e-9 * numpy.min(numpy.diff(since), initial=numpy.inf)  # what is nearer is the same instant
    times = times[numpy.diff(times, prepend=-numpy.inf) > same]
    begin, end = numpy.empty((len(times) - 1, {m})), numpy.empty((len(times) - 1, {m}))
    for k, (at, values) in enumerate(corners):
        if HOLDS[k] == "zero":
            middle = 0.5 * (times[:-1] + times[1:]) - DELAYS[k]
            begin[:, k] = end[:, k] = values[numpy.maximum(numpy.searchsorted(at, middle, side="right") - 1, 0)]
        else:
            acts = numpy.interp(times - DELAYS[k], at, values)
            begin[:, k], end[:, k] = acts[:-1], acts[1:]
    return times, begin, end, numpy.searchsorted(times, since - same)
"""

_BAND_LIMITED = """

_WEIGHTS = [
{rows}
]


def _corners(hold, since, samples):
    if hold != "band-limited":
        return since, samples
    # A polygon with some corners a sample: a windowed sinc of the samples around, moved outwards so that the means over
    # intervals are right. Beyond its ends a record goes on point-symmetrically.
    padded = numpy.pad(samples, {before}, mode="reflect", reflect_type="odd")
    fine = numpy.stack([numpy.correlate(padded, row, mode="valid") for row in _WEIGHTS], axis=1)
    values = fine.ravel()[: {finer} * (len(samples) - 1) + 1]
    values[0], values[-1] = samples[0], samples[-1]
    return numpy.interp(numpy.arange(len(values)) / {finer}, numpy.arange(len(since)), since), values

"""


def acting_function(model: Model) -> str:
    """Return the source of `acting(t, u)`, which rests on `numpy` and on the module's DELAYS and HOLDS."""
    m = len(model.inputs)
    if all(i.hold != "band-limited" for i in model.inputs):
        return _ACTING.format(m=m, corners="(since, u[:, k])")
    weights = band_limited_weights()
    rows = "\n".join(f"    {row!r}," for row in weights.tolist())
    band_limited = _BAND_LIMITED.format(rows=rows, before=BEFORE, finer=len(weights))
    return band_limited + _ACTING.format(m=m, corners="_corners(HOLDS[k], since, u[:, k])")
