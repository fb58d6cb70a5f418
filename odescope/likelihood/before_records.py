"""What was measured while inputs that act late were not known: what they were before a record begins, nobody wrote."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from odescope.likelihood.fit import Fit
from odescope.likelihood.holds import TRIAL_STEPS
from odescope.likelihood.search_space import SearchSpace
from odescope.recordings.record import Record, Records

LEAST = 2  # samples: of fewer, steps between samples say when inputs act
MOST = 0.25  # of a record: the share over which inputs are not known, at most, for their delays to be believed
APART = 10.0  # times what the rest of a record leaves: what is left where inputs are not known that were others before


def measured_where_known(records: Records, names: Collection[str], delays: Sequence[float]) -> Records | None:
    """Return records of which nothing counts that was measured while inputs were not known; None where all were.

    Before a record begins its inputs are not known, nor after its end where they act before they are recorded.

    Args:
        records: uniformly sampled, at one period.
        names: of the columns that were measured.
        delays: of the inputs, in seconds.
    """
    period = records.runs[0].sample_period
    lead, tail = (ceil(max((0.0, *of)) / period) for of in (delays, [-d for d in delays]))
    if max(lead, tail) < LEAST or lead + tail > MOST * min(len(run) for run in records):
        return None
    return Records.of(_less_ends(run, names, lead, tail) for run in records)


def misses_the_unknown(whole: SearchSpace, rest: SearchSpace, found: Fit) -> bool:
    """Say whether a model is far from what was measured while inputs were not known, and near to the rest.

    Args:
        whole: the whole record.
        rest: what was measured while inputs were known.
        found: the model.
    """
    of_whole, of_rest = (
        s.fit(found.theta, found.present, s.segments.initial, s.segments.spread * np.inf, iterations=TRIAL_STEPS)
        for s in (whole, rest)
    )
    if of_whole is None or of_rest is None:
        return of_rest is not None
    samples = rest.segments.samples
    left_out = max(of_rest.cost / samples, 1.0) * (whole.segments.samples - samples)
    return of_whole.cost - of_rest.cost > APART * left_out


def _less_ends(run: Record, names: Collection[str], lead: int, tail: int) -> Record:
    """Return a record of which the first and the last samples of some columns do not count.

    Args:
        run: the record.
        names: of the columns.
        lead: number of first samples.
        tail: number of last samples.
    """
    counts = np.column_stack([run.counted(name) for name in run.names])
    columns = [run.names.index(name) for name in names]
    counts[:lead, columns] = 0.0
    counts[len(run) - tail :, columns] = 0.0
    return replace(run, counts=counts)
