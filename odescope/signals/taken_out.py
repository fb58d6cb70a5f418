"""Samples that are taken for not measured before anything is filtered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from odescope.arrays import BoolArray
from odescope.recordings.local_spline import fit_smooth
from odescope.recordings.record import Record


def taken_out(run: Record, gone: Mapping[str, BoolArray]) -> Record:
    """Return a record without some samples, a smooth curve through the others in their place.

    What was there would tell a filter of frequencies that the signal does not have.

    Args:
        run: the record.
        gone: (N,) by column, which samples do not count.
    """
    counts = np.ones_like(run.values) if run.counts is None else run.counts.copy()
    values, rows = run.values.copy(), np.arange(len(run), dtype=np.float64)
    for name, out in gone.items():
        k = run.names.index(name)
        counts[out, k] = 0.0
        left = counts[:, k] > 0.0
        if np.count_nonzero(left) > 1:
            smooth = fit_smooth(rows[left], values[left, k], counts[left, k])
            values[~left, k] = smooth(np.clip(rows, rows[left][0], rows[left][-1]))[~left]
    return replace(run, values=values, counts=counts)
