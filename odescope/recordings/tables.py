"""A table of columns becomes records ready for use, whether it is a whole file, a frame in memory or a chunk."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.errors import InputError
from odescope.recordings.angles import unwrap
from odescope.recordings.chunks import Chunk
from odescope.recordings.columns import Columns, numbers, recording_codes, row_seconds
from odescope.recordings.dates import is_dates, is_durations
from odescope.recordings.disorder import in_order
from odescope.recordings.gaps import SHORTEST_RUN, RawRun, borne, check_cells, known, pieces
from odescope.recordings.layout import Layout
from odescope.recordings.record import Record, Records, Stretch
from odescope.recordings.uniform import uniform


def stretches(columns: Columns, layout: Layout, source: str, chunk: Chunk | None = None) -> Iterator[Stretch]:
    """Yield the recordings of a table, in order, gaps bridged or not, angles unwrapped, time uniform.

    The rows of one label are one recording. In a chunk of a file only those are that follow each other: a label that
    comes back later is another recording; and gaps, angles and jitter are judged by what the chunk holds.

    Args:
        columns: the used columns of the table.
        layout: what they mean. With a sample period, time counts from the recording's first row, in a chunk from the
            file's.
        source: where the table came from, for messages.
        chunk: the rows of a file that the table holds; None: all there are.

    Raises:
        InputError: there are no rows, or the columns do not serve.
    """
    count = len(columns[layout.numeric[0]])
    check_rows(count, source)
    labels, codes = recording_codes(columns, layout, source)
    if chunk is None:
        chunk = Chunk(Path(source), 0, count, 0, 0, count, source)
        groups = np.split(np.argsort(codes, kind="stable"), np.cumsum(np.bincount(codes))[:-1])
    else:
        starts = np.concatenate(([0], np.flatnonzero(np.diff(codes)) + 1))
        _refuse_mixed(labels, codes[starts], starts, layout, chunk)
        groups = np.split(np.arange(count), starts[1:])
        labels = [labels[codes[group[0]]] for group in groups]
    for run in _raw_runs(columns, layout, source, zip(labels, groups, strict=True), chunk.window[0]):
        yield from _between_gaps(run, chunk, layout)


def on_uniform_time(records: Records, layout: Layout) -> Records:
    """Return records of one's own making as files are read: cut at gaps, angles unwrapped, time uniform.

    Args:
        records: with any stamps; a value of which nothing was measured is missing.
        layout: what their columns mean; they bear its names.

    Raises:
        InputError: the stamps do not serve, or the gaps are refused.
    """
    runs = (RawRun.of(record) for record in records)
    cut = (piece for run in runs for piece in run.cut(pieces(run, layout.gaps)))
    return Records(tuple(record for run in cut for _, record, _ in _made_uniform(run, layout)))


def _made_uniform(run: RawRun, layout: Layout) -> Iterator[tuple[IntArray, Record, IntArray]]:
    """Yield samples, record and grid points of each stretch of a run without gaps in which its inputs are known.

    Samples (n,) are indices into the run, points (n,) where they lie in the record. All stretches lie on one grid: the
    more stamps there are, the better they tell what a clock is worth.
    """
    unwrapped = unwrap(run, layout.angles.intersection(run.names))
    record, points = uniform(unwrapped, layout.jitter, layout.held, layout.inputs)
    parts = known(run, points, layout.inputs)
    done = replace(record.repairs, unseen=len(parts) - 1)
    for samples, repairs in zip(parts, borne(done, parts), strict=True):
        first, last = np.clip(points[samples[[0, -1]]], 0, len(record) - 1).tolist()
        yield samples, replace(record.part(first, last + 1), repairs=repairs), points[samples] - first


def check_rows(rows: int, source: str) -> None:
    """Refuse a table without rows."""
    if not rows:
        raise InputError(f"{source} holds column names but no rows of data")


def row_times(columns: Columns, layout: Layout, source: str) -> Iterator[tuple[str, FloatArray]]:
    """Yield the source of each recording of a table, and the times (n,) of its rows that have one.

    Args:
        columns: the used columns of the table.
        layout: what they mean; it names the column of the time.
        source: where the table came from, for messages.
    """
    if layout.time is None:
        return
    labels, codes = recording_codes(columns, layout, source)
    time = row_seconds(columns, layout, source)
    for k, label in enumerate(labels):
        own = time[codes == k]
        yield _source(source, layout, label), own[np.isfinite(own)]


def _source(source: str, layout: Layout, label: str) -> str:
    return f"{source} ({layout.recording} {label})" if layout.recording is not None else source


def _raw_runs(
    columns: Columns, layout: Layout, source: str, groups: Iterable[tuple[str, IntArray]], before: int
) -> Iterator[RawRun]:
    """Yield the run of each label and its row indices (n,); `before` rows of the file come before the table."""
    for name, label in layout.columns:
        if label == layout.time and (is_dates(columns[label]) or is_durations(columns[label])):
            raise InputError(
                f"{name!r} is the time as a variable, and the column {label!r} in {source} holds no numbers but"
                f" {'durations' if is_durations(columns[label]) else 'dates'}: add a column with the seconds from the"
                " start, and name that as the time"
            )
    found = {label: numbers(columns[label], label, source) for label in dict(layout.columns).values()}
    factors = [np.pi / 180.0 if name in layout.degrees else 1.0 for name in layout.names]
    values = np.column_stack([found[column] for _, column in layout.columns]) * factors
    time = None if layout.time is None else row_seconds(columns, layout, source)
    dated = layout.time is not None and is_dates(columns[layout.time])
    units = dict(layout.units) | dict.fromkeys(layout.degrees, "rad")
    counted = np.arange(len(values), dtype=np.float64) * (layout.sample_period or 0.0)
    for label, rows in groups:
        yield RawRun(
            t=counted[: len(rows)] if time is None else time[rows],
            values=values[rows],
            names=layout.names,
            units=tuple(units.get(name) for name in layout.names),
            source=_source(source, layout, label),
            rows=before + rows + 1,
            labels=tuple(column for _, column in layout.columns),
            dated=dated,
        )


def _refuse_mixed(names: list[str], codes: IntArray, starts: IntArray, layout: Layout, chunk: Chunk) -> None:
    """Refuse runs (n,) too short to work with where their label comes back: read at once, they would be one recording.

    The first and the last may only be cut short.
    """
    short = np.flatnonzero(np.diff(starts)[1:] < SHORTEST_RUN) + 1
    again = short[np.bincount(codes)[codes[short]] > 1]
    if len(again):
        label, row = names[codes[again[0]]], chunk.window[0] + int(starts[again[0]]) + 1
        raise InputError(
            f"recording {label!r} in {chunk.path.name} is in several places, with only a few rows from data row {row}"
            f" on: in a file that is read in chunks the rows of a recording must follow each other; sort it by"
            f" {layout.recording!r}, then by time"
        )


def _between_gaps(run: RawRun, chunk: Chunk, layout: Layout) -> Iterator[Stretch]:
    """Yield what is left of a run between its gaps, as far as it holds some of the chunk's own rows."""
    rows, (start, stop) = run.rows - 1, chunk.window
    if rows[-1] < chunk.first or rows[0] >= chunk.stop:
        return
    if layout.sample_period is not None and not chunk.whole:
        run = replace(run, t=rows * np.float64(layout.sample_period))
    cut_before, cut_after = bool(rows[0] == start > 0), bool(rows[-1] + 1 == stop < chunk.size)
    check_cells(run)
    run = in_order(run)
    rows = run.rows - 1
    partial = cut_before or cut_after
    cuts = pieces(run, layout.gaps, partial)
    for piece, whole in zip(cuts, run.cut(cuts, partial), strict=True):
        for own, record, points in _made_uniform(whole, layout):
            samples = piece[own]
            first, last = _own(rows[samples], points, chunk, len(record))
            if first < last:
                begins, ends = not (cut_before and samples[0] == 0), not (cut_after and samples[-1] + 1 == len(rows))
                yield Stretch(record, first, last, begins, ends)


def _own(rows: IntArray, points: IntArray, chunk: Chunk, count: int) -> tuple[int, int]:
    """Return which of the `count` points of a grid are the chunk's own, by the rows (n,) that came to `points` (n,).

    Points without a row, between those of two chunks, belong to the former one.
    """
    first, last = np.searchsorted(rows, (chunk.first, chunk.stop)).tolist()
    edges = np.append(points, count)[[first, last]]
    edges[0] = 0 if first == 0 else edges[0]
    start, stop = np.clip(edges, 0, count).tolist()
    return (start, stop) if first < last else (start, start)
