"""The samples that the gate takes for not measured, and what each of them is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray, true_ranges
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Records
from odescope.recordings.repeats import PLATEAU
from odescope.signals.differentiators import Differentiator
from odescope.signals.filling import filled
from odescope.signals.outliers import gate_outliers
from odescope.signals.placeholders import placeholders, without_placeholders
from odescope.signals.slow_sensors import without_repeats

Reason = Literal["saturated", "repeated", "late", "outlier", "placeholder"]
REASONS: tuple[Reason, ...] = get_args(Reason)

Reasons = Mapping[str, tuple[IntArray, ...]]  # by coordinate, one (N,) a record: 0 counts, k is REASONS[k - 1]


def gated_records(
    records: Records, coordinates: Sequence[Coordinate], differentiator: Differentiator
) -> tuple[Records, Reasons]:
    """Return records in which samples that say nothing of the signal do not count, and why each of them does not.

    Args:
        records: uniformly sampled, at one period.
        coordinates: what was measured.
        differentiator: filters them.

    Raises:
        NoModelError: so many samples are far off that none is usual.
    """
    there = [c for c in coordinates if any(np.any(run.counted(c.name) > 0.0) for run in records)]
    known = placeholders(records, there)
    measured = without_repeats(Records.of(without_placeholders(run, known) for run in records), there)
    measured = filled(measured, there, differentiator)
    found = gate_outliers(measured, there, differentiator)
    return found, reasons_of(records, found, coordinates, known)


def reasons_of(
    before: Records, after: Records, coordinates: Sequence[Coordinate], standing: Mapping[str, float]
) -> Reasons:
    """Return why each sample was gated.

    A placeholder is a number that stands for no reading; saturated are five or more in a row at an end of the range;
    repeated is what equals a sample beside it exactly, late what lies between the signal one sample earlier and now;
    any other is an outlier.

    Args:
        before: the records that the gate was given.
        after: those that it gave back, with the signal in the place of what it took out.
        coordinates: what was measured.
        standing: the number that stands for no reading, by coordinate, where there is one.
    """
    found = {}
    for c in coordinates:
        recorded, signal = ([run.column(c.name) for run in records] for records in (before, after))
        ends = min(float(y.min()) for y in recorded), max(float(y.max()) for y in recorded)
        gone = [(a.counted(c.name) > 0.0) & (b.counted(c.name) == 0.0) for a, b in zip(before, after, strict=True)]
        none = standing.get(c.name, np.nan)
        found[c.name] = tuple(_reason(*of, ends, none) for of in zip(recorded, signal, gone, strict=True))
    return found


def _reason(
    recorded: FloatArray, signal: FloatArray, gone: BoolArray, ends: tuple[float, float], standing: float
) -> IntArray:
    """Return the reason of each sample of one record, (N,), 0 where it counts.

    Args:
        recorded: (N,) samples.
        signal: (N,) what took the place of those that do not count.
        gone: (N,) whether they do not.
        ends: of the range of all records.
        standing: the number that stands for no reading, NaN if there is none.
    """
    earlier, same = np.concatenate([signal[:1], signal[:-1]]), np.diff(recorded) == 0.0
    kinds = (
        recorded == standing,
        _plateaus(gone & np.isin(recorded, ends)),
        np.append(False, same) | np.append(same, False),
        (recorded - earlier) * (recorded - signal) < 0.0,
    )
    reason: IntArray = np.where(gone, np.select(kinds, (5, 1, 2, 3), 4), 0).astype(np.int64)
    return reason


def _plateaus(inside: BoolArray) -> BoolArray:
    """Return where (N,) so many samples follow each other that they are no chance."""
    found = np.zeros(len(inside), dtype=np.bool_)
    for first, stop in true_ranges(inside):
        found[first:stop] = stop - first >= PLATEAU
    return found
