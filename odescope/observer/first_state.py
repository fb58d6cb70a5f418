"""Where an observer begins: a state that is about right, and next to nothing known of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.model.initial_state import initial_state
from odescope.model.model import Model
from odescope.model.simulation import known_from
from odescope.recordings.record import Record, less_offsets
from odescope.signals.differentiators import Spectral

LONGEST = 20_000  # samples of the stretch that the state is fitted to, and sizes are seen in
VAGUE = 2.0  # sizes of a state: the standard deviation of what is known of it


@dataclass(frozen=True, eq=False)
class FirstState:
    """What is known of the state before the first reading: mean (n,), covariance (n, n), sizes (n,) over the record.

    The first reading is the sample `known`, from which on all that acts was recorded.
    target_sizes (T,) are those of the targets; `values` (M,) about those of states, targets and inputs in a first
    stretch, by name.
    """

    mean: FloatArray
    covariance: FloatArray
    sizes: FloatArray
    target_sizes: FloatArray
    values: Mapping[str, FloatArray]
    known: int


def first_state(model: Model, record: Record) -> FirstState:
    """Return the state that a short stretch suggests, with so wide a covariance that readings are not used twice.

    The equations are linearised about it; what is known of it should come from the filter alone. Where an input acts
    late it is that of the filtered signal: of a state before what acts is known the equations say nothing.
    """
    known = known_from(model.inputs, record.t)
    even = _even(model, record)
    plain = less_offsets(even, model.coordinates)
    differentiator = Spectral()
    values = {i.name: even.column(i.name) for i in model.inputs}
    for c in model.coordinates:
        found = differentiator.derivatives([plain.column(c.name)], plain.sample_period, c.order).values[0]
        values |= {c.derivative(k): found[k] for k in range(c.order + 1)}
    size, targets = (
        np.array([max(float(np.abs(values[name]).max()), 1e-12) for name in names])
        for names in (model.states, model.targets)
    )
    at = min(int(np.searchsorted(even.t, record.t[known])), len(even) - 1)
    mean = np.array([values[name][at] for name in model.states]) if known else initial_state(model, even)
    mean = np.where(np.isfinite(mean), mean, 0.0)
    return FirstState(mean, np.diag((VAGUE * size) ** 2), size, targets, values, known)


def _even(model: Model, record: Record) -> Record:
    """Return the first stretch of a record on a uniform grid, filled in where nothing was measured.

    A coordinate of which it holds no sample at all stays as the record has it.
    """
    part = record.part(0, min(len(record), LONGEST))
    grid = np.linspace(part.t[0], part.t[-1], len(part))
    steps = np.diff(part.t)
    uniform = float(np.ptp(steps)) <= 1e-6 * float(steps.mean())
    if uniform and part.counts is None:
        return part
    filled_in = [c.name for c in model.coordinates if part.counted(c.name).any()]
    columns = []
    for name in part.names:
        there = part.counted(name) > 0.0 if name in filled_in else np.ones(len(part), dtype=np.bool_)
        columns.append(np.interp(grid, part.t[there], part.column(name)[there]))
    return replace(part, t=grid, values=np.column_stack(columns), counts=None)
