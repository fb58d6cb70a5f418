"""Gaps in a run: missing cells and jumps of time, which are bridged, or at which it is cut or refused."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from odescope.arrays import BoolArray, FloatArray, IntArray, true_ranges
from odescope.errors import InputError
from odescope.recordings.between_samples import looks_held, unseen_steps
from odescope.recordings.bridges import off_lines
from odescope.recordings.record import UNREPAIRED, Record, Repairs, check_finite, within

Gaps = Literal["bridge", "split", "refuse"]

SHORTEST_RUN = 16  # fewer samples between gaps leave nothing between the margins of a derivative filter
GAP_PERIODS = 1.5  # a longer step lacks at least one sample
LONGEST_GAP = 32  # steps of a column: over a longer gap its samples hardly say what happened, and the run is cut there
FEW = 4  # samples: over as many an input that is not known for so long hardly moves a state
UNKNOWN = 0.25  # of an input's standard deviation: further off, a line is no knowledge of what it did
UNKNOWN_FEW = 0.1  # of the same: where a line over one sample is so far off, few samples are too many
APART = 75  # samples between cuts, on average, at least: so many more a piece has than states at its begin


@dataclass(frozen=True, slots=True, eq=False)
class RawRun:
    """One run as it was read: NaN where a cell is missing, time that may jump.

    Shapes: t (N,), values (N, c); rows (N,) counts the file's data rows from 1; `labels` are the columns' names in
    the file, which messages use; counts (N, c) of how many samples each value is the mean, None for 1 throughout;
    `repairs` says what was done to the rows, `dated` whether times are dates (see `Record`).
    """

    t: FloatArray
    values: FloatArray
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    source: str
    rows: IntArray
    labels: tuple[str, ...]
    counts: FloatArray | None = None
    repairs: Repairs = UNREPAIRED
    dated: bool = False

    @classmethod
    def of(cls, record: Record) -> RawRun:
        """Return a record as one that was read, what was not measured missing again."""
        values = record.values if record.counts is None else np.where(record.counts > 0.0, record.values, np.nan)
        rows = np.arange(1, len(record) + 1)
        named = record.names, record.units, record.source
        return cls(record.t, values, *named, rows, record.names, record.counts, record.repairs, record.dated)

    def cut(self, cuts: Sequence[IntArray], partial: bool = False) -> Iterator[RawRun]:
        """Yield pieces, each by the indices (n,) of its samples; the longest bears what was done to the rows.

        Of a run that is `partial`, cut out of a longer one, what is left out here may serve there.
        """
        complete = np.isfinite(self.t) & np.isfinite(self.values).all(axis=1)
        left_out = int(complete.sum()) - sum(int(complete[samples].sum()) for samples in cuts)
        done = self.repairs if partial else replace(self.repairs, short=self.repairs.short + left_out)
        for samples, repairs in zip(cuts, borne(done, cuts), strict=True):
            yield replace(self.take(samples), repairs=repairs)

    def take(self, samples: IntArray) -> RawRun:
        """Return some samples (n,), by their indices."""
        counts = None if self.counts is None else self.counts[samples]
        return replace(self, t=self.t[samples], values=self.values[samples], rows=self.rows[samples], counts=counts)


def borne(repairs: Repairs, cuts: Sequence[IntArray]) -> tuple[Repairs, ...]:
    """Return the repairs that each piece bears: the longest, which is the last to be left out, those of the whole.

    Args:
        repairs: of the whole.
        cuts: the samples (n,) of each piece.
    """
    longest = max(range(len(cuts)), key=lambda k: len(cuts[k]), default=0)
    whole = replace(repairs, cut=repairs.cut + len(cuts) - 1)
    return tuple(whole if k == longest else UNREPAIRED for k in range(len(cuts)))


def check_cells(run: RawRun) -> None:
    """Refuse times and values that are infinite; a missing one is NaN."""
    check_finite(~np.isinf(run.t)[:, None], ("time",), run.rows, run.source)
    advice = ": a value that was not measured is an empty cell or NaN"
    check_finite(~np.isinf(run.values), run.labels, run.rows, run.source, advice)


def pieces(run: RawRun, gaps: Gaps, partial: bool = False) -> tuple[IntArray, ...]:
    """Return the samples (n,) of each piece of a raw run, as indices into it.

    A gap is where cells are missing or time jumps by more than 1.5 periods. With "bridge" a run is only cut where a
    gap of a column is longer than 32 of the median steps between the column's own samples; missing cells stay in the
    pieces. With "split" it is cut at every gap.
    Pieces shorter than 16 samples are dropped, unless the run is all one piece.

    Args:
        run: its times increasing, but for those that are missing; its angles are not unwrapped yet.
        gaps: whether gaps are bridged, split at or refused.
        partial: the run is cut out of a longer one, whose rest may well serve: that nothing is left of it is no fault.

    Raises:
        InputError: there are gaps and `gaps` is "refuse"; no piece is left; a column has fewer than 2 samples.
    """
    measured: BoolArray = np.isfinite(run.values) & np.isfinite(run.t)[:, None]
    if gaps != "bridge":
        measured &= np.all(measured, axis=1, keepdims=True)
    counts = measured.sum(axis=0)
    if (fewest := int(counts.min())) < 2:
        if partial and (gaps != "refuse" or fewest == len(run.t)):
            return ()
        label = run.labels[int(counts.argmin())]
        what = "rows are complete" if gaps != "bridge" else f"cells of {label!r} hold numbers"
        # What was not measured in one recording may have been in the others.
        advice = f"; leave that recording out, or {label!r}" if gaps == "bridge" else ""
        raise InputError(f"{fewest} of {len(run.t)} {what}{within(run.source)}: expected at least 2{advice}")
    timed = np.flatnonzero(~np.isnan(run.t))
    steps = np.diff(run.t[timed])
    longest = GAP_PERIODS * float(np.median(steps))
    if gaps == "refuse":
        _refuse_gaps(run, run.rows[timed[:-1]][steps > longest])
        return (timed,)
    found = _bridged(run, measured) if gaps == "bridge" else _split(run, measured[:, 0], longest)
    whole = len(found) == 1 and gaps == "bridge"
    lengths = [_common_rows(measured[samples]) for samples in found]
    least = 2 if whole else SHORTEST_RUN
    kept = tuple(samples for samples, length in zip(found, lengths, strict=True) if length >= least)
    if not kept and not partial:
        raise InputError(_nothing_left(run, lengths, least))
    return kept


def _nothing_left(run: RawRun, lengths: Sequence[int], least: int) -> str:
    """Say that no piece of so many samples each, in which all columns have some, has the least number."""
    if len(lengths) == 1:
        return (
            f"{lengths[0]} of {len(run.t)} samples{within(run.source)} lie where all of"
            f" {', '.join(map(repr, run.labels))} have values: expected at least {least}; leave that recording out"
        )
    return (
        f"nothing is left{within(run.source)} after splitting at its gaps: the longest of {len(lengths)} pieces "
        f"has {max(lengths)} samples, and pieces shorter than {SHORTEST_RUN} are dropped"
    )


def _split(run: RawRun, complete: BoolArray, longest: float) -> list[IntArray]:
    """Return the pieces between missing cells and steps of time that are longer than `longest`."""
    samples = np.flatnonzero(complete)
    cuts = (np.diff(samples) > 1) | (np.diff(run.t[samples]) > longest)
    return np.split(samples, np.flatnonzero(cuts) + 1)


def _bridged(run: RawRun, measured: BoolArray) -> list[IntArray]:
    """Return the pieces between gaps that are not bridged."""
    columns = [np.flatnonzero(cells) for cells in measured.T]
    steps = [np.diff(run.t[there]) for there in columns]
    return _between(run, columns, [own > LONGEST_GAP * np.median(own) for own in steps])


def known(run: RawRun, points: IntArray, inputs: Collection[str]) -> tuple[IntArray, ...]:
    """Return the samples (n,) of each piece of a run in which what its inputs did is known, as indices into it.

    A run is cut where an input stepped in lost rows, or was not seen for so long that no line tells what it did.
    Pieces shorter than 16 samples are dropped, unless no longer one is left.

    Args:
        run: a piece of a run (`pieces`) whose gaps are bridged.
        points: (n,) of a uniform grid at which its samples lie, not falling: stamps of uneven sampling lack no rows.
        inputs: names of the columns that drive the others.
    """
    measured: BoolArray = np.isfinite(run.values) & np.isfinite(run.t)[:, None]
    driven = [k for k, name in enumerate(run.names) if name in inputs]
    columns = [np.flatnonzero(measured[:, k]) for k in driven]
    cut = [_unknown(points[there], run.values[there, k]) for k, there in zip(driven, columns, strict=True)]
    found = _between(run, columns, cut)
    return tuple(s for s in found if _common_rows(measured[s]) >= SHORTEST_RUN) or (np.arange(len(run.t)),)


def _between(run: RawRun, columns: Sequence[IntArray], cut: Sequence[BoolArray]) -> list[IntArray]:
    """Return the pieces between gaps of some columns; what lies in the gap of one is lost of the others.

    Args:
        run: its rows.
        columns: the samples (n,) of each.
        cut: after which of these (n - 1,) there is such a gap.
    """
    piece, kept = np.zeros(len(run.t), dtype=np.int64), ~np.isnan(run.t)
    for there, gaps in zip(columns, cut, strict=True):
        for k in np.flatnonzero(gaps):
            kept[there[k] + 1 : there[k + 1]] = False
            piece[there[k + 1] :] += 1
    samples = np.flatnonzero(kept)
    return np.split(samples, np.flatnonzero(np.diff(piece[samples])) + 1)


def _unknown(points: IntArray, values: FloatArray) -> BoolArray:
    """Return in which gaps (n - 1,) an input did what nobody knows: it stepped, or no line over as many samples tells.

    A coordinate is bridged by the law, as long as what drives it is known. A command that changes at every so many
    samples did so in a gap, too.

    Args:
        points: (n,) of a grid, at which the samples lie.
        values: (n,) of these.
    """
    steps = np.diff(points)
    lost = np.rint(steps / max(float(np.median(steps)), 1.0)).astype(int) - 1 if len(steps) else steps
    unknown: BoolArray = lost > 0
    if not unknown.any():
        return unknown
    if looks_held(values):
        unknown &= (np.diff(values) != 0.0) & (unseen_steps(points, values) == 0)
    else:
        whole, size = np.split(values, np.flatnonzero(unknown) + 1), float(values.std())
        fast = off_lines(whole, 1) > UNKNOWN_FEW * size
        far = [
            n for n in np.unique(lost[unknown]).tolist() if (fast if n <= FEW else off_lines(whole, n) > UNKNOWN * size)
        ]
        unknown = np.isin(lost, far)
    return unknown if APART * np.count_nonzero(unknown) <= len(values) else unknown & (lost > FEW)


def _common_rows(cells: BoolArray) -> int:
    """Return how many rows of (n, c) cells lie between the first and the last that all columns have; 0 if too few."""
    if not len(cells) or not cells.any(axis=0).all():
        return 0
    first = int(cells.argmax(axis=0).max())
    last = len(cells) - int(cells[::-1].argmax(axis=0).max())
    few = first >= last or int(cells[first:last].sum(axis=0).min()) < 2
    return 0 if few else last - first


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
            "repair them there or set gaps = 'bridge' or 'split' in [data]"
        )


def _missing(what: str, missing: BoolArray, rows: IntArray) -> str:
    """Say in which rows cells are missing."""
    spans = [
        f"{rows[start]}-{rows[stop - 1]}" if stop - start > 1 else f"{rows[start]}"
        for start, stop in true_ranges(missing)
    ]
    plural = "s" * (int(missing.sum()) > 1)
    return f"{what} has {_counted(len(spans))} (data row{plural} {_listed(spans)})"


def _counted(gaps: int) -> str:
    return f"{gaps} gap{'s' * (gaps != 1)}"


def _listed(items: list[str]) -> str:
    return ", ".join(items[:6]) + ", ..." * (len(items) > 6)
