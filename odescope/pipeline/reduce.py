"""Recordings that do not fit in memory: every chunk of them becomes factors, which is all that is kept of it.

Cutoffs, delays, clipping, candidates and the weights of the rows are settled before, on a sample of the chunks.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.events import Monitor, Progress
from odescope.parallel.workers import Threads, Workers, check_wanted
from odescope.pipeline.fingerprint import fingerprint
from odescope.pipeline.sample import SAMPLED, Sample
from odescope.pipeline.store import Reduced, digest
from odescope.recordings.chunks import Chunk, cut
from odescope.recordings.coordinate import Input
from odescope.recordings.extremes import extremes
from odescope.recordings.layout import Layout
from odescope.recordings.periods import stretch_at_period
from odescope.recordings.readers import read_chunk
from odescope.recordings.record import Stretch
from odescope.regression.problem import LibraryRows, Pieces, Problem, factored, pieces_a_block
from odescope.regression.rows import FOLDS, cut_blocks
from odescope.signals.delays import delayed, remaining
from odescope.signals.differentiators import Differentiator
from odescope.signals.estimate import Signals, signals_like
from odescope.signals.filling import filled_like
from odescope.signals.outliers import Clipping, clip_outliers
from odescope.signals.placeholders import without_placeholders
from odescope.signals.spectral import reach


@dataclass(frozen=True, eq=False)
class Plan:
    """What turns a chunk of the data into factors, settled before: small, and the same for every chunk.

    `period` is that of the samples, `placeholders` are the numbers that stand for no reading, by coordinate, `like` are
    signals without columns, `lead` the seconds dropped at the ends for the sake of delays, `shortest` those below which
    a recording is left out, `libraries` those of the targets.
    """

    layout: Layout
    period: float
    placeholders: Mapping[str, float]
    differentiator: Differentiator
    margin: float
    inputs: tuple[Input, ...]
    lead: float | None
    clipping: Clipping | None
    shortest: float
    like: Signals
    libraries: tuple[LibraryRows, ...]

    @property
    def digest(self) -> str:
        """What tells this plan from any other."""
        settled = (
            self.layout, self.period, self.placeholders, self.differentiator, self.margin, self.inputs, self.lead,
            self.clipping, self.shortest,
        )  # fmt: skip
        found = (self.like.channels, self.like.period, self.like.coordinates)
        libraries = [([t.text for t in library.terms], library.row_map) for library in self.libraries]
        return fingerprint((settled, found, libraries))

    @property
    def overlap(self) -> int:
        """The rows that a cut has to be away from a sample to leave it alone."""
        slowest = min(c.cutoff for c in self.like.channels)
        late = max((abs(i.delay) for i in self.inputs), default=0.0) + (self.lead or 0.0)
        return int(np.ceil((reach(slowest) + late) / self.period)) + 1


@dataclass(frozen=True)
class Task:
    """A chunk, its fold, and the pieces that a block of it makes."""

    chunk: Chunk
    parts: int
    fold: int


def reduce(task: Task, plan: Plan) -> Reduced:
    """Read, filter and factor one chunk.

    Raises:
        InputError: whatever reading refuses, another sampling period, a candidate that is not finite there.
    """
    signals, stretches = _signals(task.chunk, plan)
    blocks = cut_blocks(signals, [task.fold] * len(signals.columns))
    one = Threads(1)  # chunks themselves are taken by several workers
    try:
        factors = tuple(tuple(factored(library, signals, blocks, task.parts, one)) for library in plan.libraries)
    except InputError as error:
        where = f"{task.chunk.path.name}, data rows {task.chunk.first + 1} to {task.chunk.stop}"
        raise InputError(f"{where}: {error}") from error
    recordings = sum(s.begins and s.first == 0 for s in stretches)
    return Reduced(factors, *_extremes(signals, stretches), task.chunk.stop - task.chunk.first, recordings)


def _extremes(signals: Signals, stretches: Sequence[Stretch]) -> tuple[FloatArray, FloatArray]:
    """Return the least and the greatest value (names,) of every signal of a chunk, of inputs as they were recorded.

    Coordinates are taken as filtered: outliers of a chunk are not told from its samples.

    Args:
        signals: of the chunk.
        stretches: that they are of, with inputs as they were recorded.
    """
    columns = (*signals.columns, np.empty((len(signals.names), 0)))
    low = np.min([c.min(axis=1, initial=np.inf) for c in columns], axis=0)
    high = np.max([c.max(axis=1, initial=-np.inf) for c in columns], axis=0)
    for i in signals.inputs:
        ends = extremes(stretches, i.name)
        if np.isfinite(ends).all():
            low[signals.row(i.name)], high[signals.row(i.name)] = ends
    return low, high


def _signals(chunk: Chunk, plan: Plan) -> tuple[Signals, tuple[Stretch, ...]]:
    """Return the signals of a chunk, and the stretches of recordings that they are of, inputs as they were recorded."""
    read = [stretch_at_period(s, plan.period, plan.layout) for s in read_chunk(chunk, plan.layout)]
    least = [max(plan.shortest, s.record.sample_period) for s in read]
    stretches = tuple(
        s for s, short in zip(read, least, strict=True) if s.cut or remaining(s.record, plan.lead) >= short
    )
    stretches = tuple(replace(s, record=without_placeholders(s.record, plan.placeholders)) for s in stretches)
    check_wanted()
    cutoffs = [c.cutoff for c in plan.like.channels]
    stretches = filled_like(stretches, plan.like.coordinates, plan.differentiator, cutoffs)
    check_wanted()
    if plan.clipping is not None:
        stretches = clip_outliers(stretches, plan.like.coordinates, plan.differentiator, plan.clipping)
        check_wanted()
    acted = delayed(stretches, plan.inputs, plan.lead)
    signals = signals_like(plan.like, acted, plan.differentiator, plan.margin)
    return signals, stretches


def _tasks(sample: Sample, plan: Plan) -> list[Task]:
    """Return what is to be done; the chunks of the sample take turns as folds, so do the others.

    Raises:
        InputError: a filter reaches further than a chunk.
    """
    overlap = plan.overlap
    if overlap > sample.rows and any(f.rows > sample.rows for f in sample.files):
        slowest = min(c.cutoff for c in plan.like.channels)
        raise InputError(
            f"a cutoff of {slowest:.3g} Hz reaches over {overlap} samples, too many for chunks of {sample.rows}: allow"
            " more memory ([data] memory), or record at a lower rate"
        )
    turns = {_place(c): k % FOLDS for k, c in enumerate(sample.chunks)}
    chunks = [c for file in sample.files for c in cut(file, sample.rows, overlap)]
    parts = pieces_a_block(len(chunks))
    # The fold of the others is their own, whatever other files there are and wherever these lie: what is kept of them
    # stays what it is, and the same study gives the same model on every machine. Files of one name differ in size.
    size = {f.path: f.path.stat().st_size for f in sample.files}
    folds = [int(digest([c.path.name, size[c.path], c.first]), 16) % FOLDS for c in chunks]
    return [Task(c, parts, turns.get(_place(c), fold)) for c, fold in zip(chunks, folds, strict=True)]


def _place(chunk: Chunk) -> tuple[Path, int, int]:
    return chunk.path, chunk.first, chunk.stop


@dataclass(frozen=True, eq=False)
class Whole:
    """What is kept of all chunks: the problems with the factors of all data, the extremes of the signals, counts."""

    problems: tuple[Problem, ...]
    low: FloatArray
    high: FloatArray
    rows: int
    chunks: int
    recordings: int


def reduce_all(sample: Sample, plan: Plan, problems: Sequence[Problem], workers: Workers, monitor: Monitor) -> Whole:
    """Return the problems with the factors of all chunks of recordings of which a sample stands in memory.

    Args:
        sample: that stands in memory.
        plan: what was settled on it.
        problems: posed on it, one a target.
        workers: who reduce the chunks.
        monitor: told how many are done, and asked whether to stop.

    Raises:
        InputError: see `reduce`; or a filter reaches further than a chunk.
        Stopped: the monitor says so.
    """
    todo = _tasks(sample, plan)
    pieces = [Pieces() for _ in problems]
    names = len(plan.like.names)
    low, high, rows, recordings = np.full(names, np.inf), np.full(names, -np.inf), 0, 0
    with closing(_each(todo, sample, plan, workers, monitor)) as each:
        for reduced in each:
            for own, factors in zip(pieces, reduced.factors, strict=True):
                own.take(factors)
            low, high = np.minimum(low, reduced.low), np.maximum(high, reduced.high)
            rows, recordings = rows + reduced.rows, recordings + reduced.recordings
    found = tuple(
        replace(p, folds=own.folds(), pieces=own.all(), sample=p.folds) for p, own in zip(problems, pieces, strict=True)
    )
    return Whole(found, low, high, rows, len(todo), recordings)


def _each(
    todo: Sequence[Task], sample: Sample, plan: Plan, workers: Workers, monitor: Monitor
) -> Generator[Reduced, None, None]:
    """Yield what is kept of each chunk, in order, and tell how far it got and how long it will take."""
    store, keys = sample.store, [""] * len(todo)
    if store is not None:
        settled = plan.digest
        keys = [store.key(settled, t.chunk, t.fold) for t in todo]
    missing = [k for k, key in enumerate(keys) if store is None or not store.holds(key)]
    # As many at once as stand in memory beside the sample.
    around = max(t.chunk.before + t.chunk.after for t in todo) / sample.rows
    workers = workers.at_most(max(1, int(0.5 * SAMPLED / (1.0 + around))))
    begin, done = time.monotonic(), 0
    with closing(workers.map(reduce, [todo[k] for k in missing], plan, check=monitor.check)) as computed:
        for k, (task, key) in enumerate(zip(todo, keys, strict=True)):
            monitor.check()
            left = None
            if done < len(missing) and missing[done] == k:
                found = next(computed)
                done += 1
                left = (time.monotonic() - begin) / done * (len(missing) - done)
                if store is not None:
                    store.write(key, found)
            else:
                assert store is not None  # it holds what is not missing
                kept = store.read(key)
                found = reduce(task, plan) if kept is None else kept
                if kept is None:  # damaged
                    store.write(key, found)
            monitor.tell(Progress("recordings", "chunk", k + 1, len(todo), left))
            yield found
