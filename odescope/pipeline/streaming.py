"""Recordings that do not fit in memory: what is decided on a sample of them, and the factors of all the others.

Cutoffs, delays, clipping, candidates and the weights of the rows are settled on a sample of the portions. Then every
portion is read where it lies, filtered, mapped to rows and reduced to its factors, which is all that is kept of it.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.parallel.workers import Threads, Workers
from odescope.recordings.chunks import DataFile, Portion, cut, read_portion, survey
from odescope.recordings.coordinate import Input
from odescope.recordings.readers import Layout, find_files
from odescope.recordings.record import Records
from odescope.regression.factor import Factor
from odescope.regression.problem import LibraryRows, Pieces, Problem, factored, pieces_a_block
from odescope.regression.rows import FOLDS, Block, cut_blocks
from odescope.signals.delays import delayed_stretch
from odescope.signals.differentiators import Differentiator
from odescope.signals.estimate import Signals, signals_like
from odescope.signals.outliers import Clipping, clip_like
from odescope.signals.spectral import reach
from odescope.study.options import Data

PROGRAM = 550.0  # MB that an identification takes however short its log is
BYTES_A_CELL = 110.0  # at the most, while a table is read and filtered
SAMPLED = 8  # portions of the size that fits in memory together, of which decisions are made
OUTGROWN = 2.0  # times the rows there were when the sample was drawn: then another is
LEAST_ROWS = 50_000  # in memory at once: fewer decide nothing


def rows_in_memory(memory: float, columns: int) -> int:
    """Return how many rows of so many columns may stand in memory, given the memory of all in MB."""
    return int((memory - PROGRAM) * 1e6 / (BYTES_A_CELL * columns))


def _refuse_too_little(memory: float, columns: int) -> None:
    if rows_in_memory(memory, columns) < LEAST_ROWS:
        least = PROGRAM + LEAST_ROWS * BYTES_A_CELL * columns / 1e6
        raise InputError(
            f"memory = {memory:g} MB is too little for a long log of {columns} columns: expected at least {least:.0f},"
            f" of which the program itself takes {PROGRAM:.0f} (memory in [data])"
        )


@dataclass(frozen=True, eq=False)
class Plan:
    """What turns a portion of the data into factors, settled before: small, and the same for every portion.

    `like` are signals without columns, `lead` the seconds dropped at the ends for the sake of delays, `shortest` those
    below which a recording is left out, `libraries` those of the targets.
    """

    layout: Layout
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
        settled = (self.differentiator, self.margin, self.inputs, self.lead, self.clipping, self.shortest)
        found = hashlib.sha256(repr((settled, self.like.channels, self.like.period, self.like.coordinates)).encode())
        for library in self.libraries:
            found.update(repr([t.text for t in library.terms]).encode())
            for name, value in sorted(vars(library.row_map).items()):
                found.update(value.tobytes() if isinstance(value, np.ndarray) else f"{name}={value!r}".encode())
        return found.hexdigest()

    def overlap(self, period: float) -> int:
        """Return the rows that a cut has to be away from a sample to leave it alone."""
        slowest = min(c.cutoff for c in self.like.channels)
        late = max((abs(i.delay) for i in self.inputs), default=0.0) + (self.lead or 0.0)
        return int(np.ceil((reach(slowest) + late) / period)) + 1


@dataclass(frozen=True)
class Task:
    """A portion, its fold, and the pieces that a block of it makes; or its blocks, where they are known already."""

    portion: Portion
    parts: int
    fold: int = 0
    blocks: tuple[Block, ...] | None = None


@dataclass(frozen=True, eq=False)
class Reduced:
    """What is kept of a portion: for each target factors of pieces with their folds; the extremes of every signal."""

    factors: tuple[tuple[tuple[int, Factor], ...], ...]
    low: FloatArray
    high: FloatArray
    rows: int
    recordings: int


def reduce(task: Task, plan: Plan) -> Reduced:
    """Read, filter and factor one portion.

    Raises:
        InputError: whatever reading refuses, another sampling period, a candidate that is not finite there.
    """
    signals, recordings = _signals(task, plan)
    blocks = cut_blocks(signals, [task.fold] * len(signals.columns)) if task.blocks is None else task.blocks
    one = Threads(1)  # portions themselves are in several hands
    try:
        factors = tuple(tuple(factored(library, signals, blocks, task.parts, one)) for library in plan.libraries)
    except InputError as error:
        where = f"{task.portion.path.name}, data rows {task.portion.first + 1} to {task.portion.stop}"
        raise InputError(f"{where}: {error}") from error
    names = len(signals.names)
    columns = (*signals.columns, np.empty((names, 0)))
    low = np.min([c.min(axis=1, initial=np.inf) for c in columns], axis=0)
    high = np.max([c.max(axis=1, initial=-np.inf) for c in columns], axis=0)
    return Reduced(factors, low, high, task.portion.stop - task.portion.first, recordings)


def _signals(task: Task, plan: Plan) -> tuple[Signals, int]:
    """Return the signals of a portion, and how many recordings begin in it."""
    kept, recordings = [], 0
    for read in read_portion(task.portion, plan.layout):
        clipped = read
        if plan.clipping is not None:
            clipped = clip_like(plan.clipping, read, plan.like.coordinates, plan.differentiator)
        stretch = delayed_stretch(clipped, plan.inputs, plan.lead)
        if stretch is None or (not read.cut and stretch.record.duration < plan.shortest):
            continue
        recordings += read.begins and read.first == 0
        kept.append(stretch)
    return signals_like(plan.like, kept, plan.differentiator, plan.margin), recordings


@dataclass(frozen=True, eq=False)
class Log:
    """What was recorded, as far as it stands in memory, and where the rest lies.

    `origin` is the portion of each record, `files` all files and `rows` the rows that a portion of them may have at
    most; data that were given in memory have no portions. Where the log is not `complete`, the records are a sample.
    """

    records: Records
    portions: tuple[Portion, ...] = ()
    origin: tuple[int, ...] = ()
    files: tuple[DataFile, ...] = ()
    rows: int = 0
    complete: bool = True
    store: Store | None = None

    @property
    def folds(self) -> tuple[int, ...] | None:
        """The fold of each record, where all of a portion is held out together."""
        return None if self.complete else tuple(k % FOLDS for k in self.origin)

    def without(self, dropped: Sequence[bool]) -> Log:
        """Return the log less some of its records."""
        kept = [not d for d in dropped]
        origin = tuple(compress(self.origin, kept))
        return replace(self, records=Records(tuple(compress(self.records, kept))), origin=origin)


def open_log(data: Data, layout: Layout, store: Store | None) -> Log:
    """Return what fits in memory of the files of a study: all, or portions evenly spread over it.

    Raises:
        InputError: a file that is missing, unreadable, of another kind, or whose columns do not serve.
    """
    if not data.files:
        raise InputError("the study names no files: set files in [data], or pass the recordings")
    paths = find_files([Path(f) for f in data.files])
    files = tuple(_anywhere(f) for f in Threads().map(survey, paths, layout))
    columns, total = len(layout.used), sum(f.rows for f in files)
    rows = rows_in_memory(data.memory, columns)
    complete = total <= max(rows, LEAST_ROWS)
    portions = tuple(p for f in files for p in cut(f, f.rows if complete else max(rows // SAMPLED, 1)))
    if not complete:
        _refuse_too_little(data.memory, columns)
        _refuse_indivisible(files, rows)
        sampled = () if store is None else store.sampled(portions, total)
        portions = sampled or sample(portions, rows)
        if store is not None and not sampled:
            store.keep_sample(portions, total)
    read = [[s.record for s in read_portion(p, layout)] for p in portions]
    origin = tuple(k for k, records in enumerate(read) for _ in records)
    records = Records(tuple(record for own in read for record in own))
    return Log(records, portions, origin, files, rows // SAMPLED, complete, store)


def _refuse_indivisible(files: Sequence[DataFile], rows: int) -> None:
    for file in files:
        if not file.divisible and file.rows > rows:
            raise InputError(
                f"{file.path.name} has {file.rows} rows and can only be read whole, but {rows} fit in the memory that"
                " is allowed: unpack it, convert it to Parquet, or allow more ([data] memory)"
            )


def sample(portions: Sequence[Portion], rows: int) -> tuple[Portion, ...]:
    """Return portions evenly spread among all that have together about so many rows."""
    sizes = np.array([p.stop - p.first for p in portions])
    middles, total = np.cumsum(sizes) - 0.5 * sizes, int(sizes.sum())
    count = max(min(len(portions), FOLDS), int(len(portions) * min(1.0, rows / total)))
    while True:
        wanted = total * (np.arange(count) + 0.5) / count
        index = np.unique(np.abs(middles[None] - wanted[:, None]).argmin(axis=1))
        if sizes[index].sum() <= rows or count <= FOLDS:
            return tuple(portions[k] for k in index)
        count = max(FOLDS, int(0.9 * count))


def _anywhere(file: DataFile) -> DataFile:
    """Return a file whose path does not depend on where it is read from."""
    path = file.path.absolute()
    return replace(file, path=path, text=None if file.text is None else replace(file.text, path=path))


def _tasks(log: Log, plan: Plan, blocks: Sequence[Block]) -> list[Task]:
    """Return what is to be done; the portions of a sample take turns as folds, so do the others.

    Raises:
        InputError: a filter reaches further than a portion.
    """
    if log.complete:
        own: list[list[Block]] = [[] for _ in log.portions]
        first = {k: r for r, k in reversed(list(enumerate(log.origin)))}
        for b in blocks:
            k = log.origin[b.record]
            own[k].append(replace(b, record=b.record - first[k]))
        parts = pieces_a_block(len(blocks))
        return [Task(p, parts, blocks=tuple(b)) for p, b in zip(log.portions, own, strict=True)]
    overlap = plan.overlap(log.records.runs[0].sample_period)
    if overlap > log.rows and any(f.rows > log.rows for f in log.files):
        slowest = min(c.cutoff for c in plan.like.channels)
        raise InputError(
            f"a cutoff of {slowest:.3g} Hz reaches over {overlap} samples, too many for portions of {log.rows}: allow"
            " more memory ([data] memory), or record at a lower rate"
        )
    turns = {_place(p): k % FOLDS for k, p in enumerate(log.portions)}
    portions = [p for file in log.files for p in cut(file, log.rows, overlap)]
    parts = pieces_a_block(len(portions))
    # The fold of the others is their own, whatever other files there are: what is kept of them stays what it is.
    folds = [int(_digest([str(p.path), p.first]), 16) % FOLDS for p in portions]
    return [Task(p, parts, turns.get(_place(p), fold)) for p, fold in zip(portions, folds, strict=True)]


def _place(portion: Portion) -> tuple[Path, int, int]:
    return portion.path, portion.first, portion.stop


@dataclass(frozen=True)
class Store:
    """Where factors of finished portions of a study are kept, so that nothing is done twice.

    Nothing of it is executed when it is read. `study` is a digest of the options.
    """

    root: Path
    study: str

    @property
    def folder(self) -> Path:
        """The study's own folder."""
        return self.root / self.study[:16]

    def sampled(self, portions: Sequence[Portion], rows: int) -> tuple[Portion, ...]:
        """Return the portions of which decisions were made before; none where they changed, or the log has doubled."""
        try:
            kept = json.loads((self.folder / "sample.json").read_text(encoding="utf-8"))
            known = {self._identity(p): p for p in portions}
            return tuple(known[name] for name in kept["portions"]) if rows <= OUTGROWN * kept["rows"] else ()
        except (OSError, ValueError, TypeError, KeyError):  # none yet, or of other files
            return ()

    def keep_sample(self, portions: Sequence[Portion], rows: int) -> None:
        """Keep the portions of which decisions are made, and the rows of the log."""
        content = {"rows": rows, "portions": [self._identity(p) for p in portions]}
        self._write("sample.json", lambda path: path.write_text(json.dumps(content), encoding="utf-8"))

    def keys(self, tasks: Sequence[Task], plan: Plan) -> list[str]:
        """Return the names under which factors of portions are kept: they say all that these depend on."""
        return [f"{_digest([plan.digest, self._identity(t.portion), *_around(t)])}.npz" for t in tasks]

    def holds(self, key: str) -> bool:
        """Return whether something is kept under a name."""
        return (self.folder / key).exists()

    def read(self, key: str) -> Reduced | None:
        """Return what is kept under a name, None where it is not there or damaged."""
        try:
            with (self.folder / key).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return _unpacked(arrays)
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None

    def write(self, key: str, reduced: Reduced) -> None:
        """Keep the factors of a portion."""
        self._write(key, lambda path: _save(path, _packed(reduced)))

    def prune(self, keys: Sequence[str]) -> None:
        """Remove the study's factors that no longer serve."""
        for name in {path.name for path in self.folder.glob("*.npz")} - set(keys):
            (self.folder / name).unlink(missing_ok=True)

    def _write(self, name: str, write: Callable[[Path], object]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        partial = self.folder / f".{secrets.token_hex(8)}"
        try:
            write(partial)
            os.replace(partial, self.folder / name)
        finally:
            partial.unlink(missing_ok=True)

    @staticmethod
    def _identity(portion: Portion) -> str:
        about = portion.path.stat()
        return f"{portion.path.resolve()}|{about.st_size}|{about.st_mtime_ns}|{portion.first}|{portion.stop}"


def _around(task: Task) -> tuple[int, int, int]:
    return task.portion.before, task.portion.after, task.fold


def _digest(about: Sequence[str | int]) -> str:
    return hashlib.sha256(json.dumps(about).encode()).hexdigest()[:32]


def _save(path: Path, arrays: dict[str, FloatArray]) -> None:
    with path.open("wb") as file:  # by its name alone NumPy would give it an ending
        np.savez(file, **arrays)  # type: ignore[arg-type]


def _packed(reduced: Reduced) -> dict[str, FloatArray]:
    arrays = {"low": reduced.low, "high": reduced.high, "counts": np.array([reduced.rows, reduced.recordings])}
    for t, factors in enumerate(reduced.factors):
        arrays[f"about{t}"] = np.array([[fold, f.rows] for fold, f in factors]).reshape(-1, 2)
        arrays[f"r{t}"] = np.array([f.r for _, f in factors])
        arrays[f"scale{t}"] = np.array([f.scale for _, f in factors])
    return arrays


def _unpacked(file: np.lib.npyio.NpzFile) -> Reduced:
    targets = sum(name.startswith("about") for name in file.files)
    factors = tuple(
        tuple(
            (int(fold), Factor(r, scale, int(rows)))
            for (fold, rows), r, scale in zip(file[f"about{t}"], file[f"r{t}"], file[f"scale{t}"], strict=True)
        )
        for t in range(targets)
    )
    rows, recordings = (int(n) for n in file["counts"])
    return Reduced(factors, file["low"], file["high"], rows, recordings)


@dataclass(frozen=True, eq=False)
class Whole:
    """What is kept of all portions: the problems with the factors of all data, the extremes of the signals, counts."""

    problems: tuple[Problem, ...]
    low: FloatArray
    high: FloatArray
    rows: int
    portions: int
    recordings: int


def reduce_all(
    log: Log, plan: Plan, problems: Sequence[Problem], hands: Workers, watch: Callable[[str], None]
) -> Whole:
    """Return the problems with the factors of all portions of a log.

    Raises:
        InputError: see `reduce`; or a filter reaches further than a portion.
    """
    todo = _tasks(log, plan, problems[0].blocks)
    pieces = [Pieces() for _ in problems]
    names = len(plan.like.names)
    low, high, rows, recordings = np.full(names, np.inf), np.full(names, -np.inf), 0, 0
    for reduced in _each(todo, log, plan, hands, watch):
        for own, factors in zip(pieces, reduced.factors, strict=True):
            own.take(factors)
        low, high = np.minimum(low, reduced.low), np.maximum(high, reduced.high)
        rows, recordings = rows + reduced.rows, recordings + reduced.recordings
    folds = [own.folds() for own in pieces]
    found = tuple(
        replace(p, folds=f, pieces=own.all(), sample=None if log.complete else p.folds)
        for p, f, own in zip(problems, folds, pieces, strict=True)
    )
    return Whole(found, low, high, rows, len(todo), recordings)


def _each(
    todo: Sequence[Task], log: Log, plan: Plan, hands: Workers, watch: Callable[[str], None]
) -> Iterator[Reduced]:
    """Yield what is kept of each portion, in order, and tell how far it got and how long it will take."""
    store = None if log.complete else log.store
    keys = [""] * len(todo) if store is None else store.keys(todo, plan)
    missing = [k for k, key in enumerate(keys) if store is None or not store.holds(key)]
    if not hands.remote:  # as many at once as stand in memory beside the sample
        around = max(t.portion.before + t.portion.after for t in todo) / log.rows
        hands = replace(hands, count=max(1, min(hands.count, int(0.5 * SAMPLED / (1.0 + around)))))  # type: ignore[type-var]
    computed = hands.map(reduce, [todo[k] for k in missing], plan)
    begin, done = time.monotonic(), 0
    for k, task in enumerate(todo):
        if done < len(missing) and missing[done] == k:
            found = next(computed)
            done += 1
            left = (time.monotonic() - begin) / done * (len(missing) - done)
            watch(f"recordings: {k + 1} of {len(todo)} portions, {_span(left)} left")
            if store is not None:
                store.write(keys[k], found)
        else:
            assert store is not None  # it holds what is not missing
            kept = store.read(keys[k])
            found = reduce(task, plan) if kept is None else kept
            if kept is None:  # damaged
                store.write(keys[k], found)
        yield found
    if store is not None:
        store.prune(keys)


def _span(seconds: float) -> str:
    minutes, rest = divmod(max(round(seconds), 0), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
