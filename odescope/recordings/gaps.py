"""Gaps in a run: missing cells and jumps of time, at which it is cut or refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray
from odescope.errors import InputError
from odescope.recordings.record import Record, check_finite, check_increasing, within

Gaps = Literal["refuse", "split"]

SHORTEST_RUN = 16  # fewer samples between gaps leave nothing between the margins of a derivative filter
GAP_PERIODS = 1.5  # a longer step lacks at least one sample


@dataclass(frozen=True, slots=True, eq=False)
class RawRun:
    """One run as it was read: NaN where a cell is missing, time that may jump.

    Shapes: t (N,), values (N, c); rows (N,) counts the file's data rows from 1; `labels` are the columns' names in
    the file, which messages use.
    """

    t: FloatArray
    values: FloatArray
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    source: str
    rows: IntArray
    labels: tuple[str, ...]


def gapless(run: RawRun, gaps: Gaps, partial: bool = False) -> tuple[IntArray, ...]:
    """Return the samples (n,) of each piece of a raw run between its gaps, as indices into it.

    A gap is where cells are missing or time jumps by more than 1.5 periods. Pieces shorter than 16 samples are dropped.

    Args:
        run: as it was read; its angles are not unwrapped yet, since across a gap that would be a guess.
        gaps: whether a run with gaps is split there or refused.
        partial: the run is cut out of a longer one, whose rest may well serve: that nothing is left of it is no fault.

    Raises:
        InputError: there are gaps and `gaps` is "refuse"; no piece is left; time goes back or repeats; a value is
            infinite.
    """
    check_finite(~np.isinf(run.t)[:, None], ("time",), run.rows, run.source)
    check_finite(~np.isinf(run.values), run.labels, run.rows, run.source)
    timed = np.flatnonzero(~np.isnan(run.t))
    check_increasing(run.t[timed], run.rows[timed], run.source)
    complete = np.flatnonzero(~np.isnan(run.t) & ~np.isnan(run.values).any(axis=1))
    if len(complete) < 2:
        if partial and (gaps == "split" or len(complete) == len(run.t)):
            return ()
        raise InputError(f"{len(complete)} of {len(run.t)} rows are complete{within(run.source)}: expected at least 2")
    steps = np.diff(run.t[timed])
    longest = GAP_PERIODS * float(np.median(steps))
    if gaps == "refuse":
        _refuse_gaps(run, run.rows[timed[:-1]][steps > longest])
        return (complete,)
    cuts = (np.diff(complete) > 1) | (np.diff(run.t[complete]) > longest)
    pieces = np.split(complete, np.flatnonzero(cuts) + 1)
    kept = tuple(samples for samples in pieces if len(samples) >= SHORTEST_RUN)
    if not kept and not partial:
        raise InputError(
            f"nothing is left{within(run.source)} after splitting at its gaps: the longest of {len(pieces)} pieces "
            f"has {max(map(len, pieces))} samples, and pieces shorter than {SHORTEST_RUN} are dropped"
        )
    return kept


def record_of(run: RawRun, samples: IntArray) -> Record:
    """Return some samples (n,) of a raw run as a record; InputError where one of them is not finite."""
    return Record(run.t[samples], run.values[samples], run.names, run.units, run.source)


def _refuse_gaps(run: RawRun, jumps: IntArray) -> None:
    holes = {"time": np.isnan(run.t)}  # by label: a column that serves under two names is told once
    holes |= {f"column {label!r}": np.isnan(cells) for label, cells in zip(run.labels, run.values.T, strict=True)}
    found = [_missing(what, cells, run.rows) for what, cells in holes.items() if cells.any()]
    if len(jumps):
        rows = _listed([str(row) for row in jumps])
        found.append(f"time has {_counted(len(jumps))} (after data row{'s' * (len(jumps) > 1)} {rows})")
    if found:
        raise InputError(
            f"{' and '.join(found)}{within(run.source)}, where row 1 is the first row of data; "
            "repair them there or set gaps = 'split' in [data]"
        )


def _missing(what: str, missing: BoolArray, rows: IntArray) -> str:
    """Say in which rows cells are missing."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False])).astype(np.int8)))
    spans = [
        f"{rows[start]}-{rows[stop - 1]}" if stop - start > 1 else f"{rows[start]}"
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
    ]
    plural = "s" * (int(missing.sum()) > 1)
    return f"{what} has {_counted(len(spans))} (data row{plural} {_listed(spans)})"


def _counted(gaps: int) -> str:
    return f"{gaps} gap{'s' * (gaps != 1)}"


def _listed(items: list[str]) -> str:
    return ", ".join(items[:6]) + ", ..." * (len(items) > 6)
