"""A study drafted from a look at a data file: columns, sampling, units, angles, what to leave out."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import InputError
from odescope.library.functions import FUNCTIONS
from odescope.recordings.chunks import Chunk
from odescope.recordings.columns import numbers, recording_codes, row_seconds
from odescope.recordings.coordinate import Coordinate, check_name
from odescope.recordings.formats import Format, opened
from odescope.recordings.headings import Heading
from odescope.recordings.layout import Layout
from odescope.recordings.periods import at_one_period
from odescope.recordings.readers import column_names, read_chunk
from odescope.recordings.record import Records
from odescope.recordings.text_headers import NUMBER
from odescope.signals.look import HELD, Role, Seen, look, repeats
from odescope.study.clock_column import ClockColumn, clock_in_disorder, clock_of
from odescope.study.looked_at import columns_of
from odescope.study.toml import moved, parse_study

LABELS = re.compile(r"(run|segment|recording|experiment|trial|lap|series|batch|episode|id)(_.*)?", re.IGNORECASE)
LEAST_ROWS = 32  # of a recording, on average
UNEVEN = 0.8  # of the points of a grid: where fewer hold a sample, they are at no even times
NAMELESS = "the column without a name"  # an index that pandas wrote
WIDTH = 46  # columns of text before a comment


@dataclass(frozen=True)
class Drafted:
    """A study as text, and what the log looks like.

    Attributes:
        text: of the study.
        sampled: how much there is, and how often it was sampled.
        seen: what each column of numbers looks like, in the order of the file.
        unused: the other columns but those of the time and the recording, and why each is left out.
    """

    text: str
    sampled: str
    seen: tuple[Seen, ...]
    unused: Mapping[str, str]

    def count(self, role: Role) -> int:
        """Return how many columns may be coordinates, or inputs."""
        return sum(s.role == role for s in self.seen)

    @property
    def left_out(self) -> dict[str, str]:
        """The columns that the study does without, and why."""
        return _left_out(self.seen, self.unused)


def draft(files: Sequence[Path], sources: Sequence[Path], folder: Path) -> Drafted:
    """Return the study of data files.

    Args:
        files: that are looked at, the first of them in any case.
        sources: that the study names.
        folder: that the study will be in.

    Raises:
        InputError: the file cannot be read, or no column may be a coordinate.
    """
    file, labels = files[0], column_names(files[0])
    if all(NUMBER.fullmatch(label) for label in labels):
        raise InputError(
            f"the first line of {file.name} holds numbers, where column names are expected: add such a line"
        )
    chunks, read = columns_of(files, labels)
    columns = {label: column.values for label, column in read.items() if not column.refusal}
    dated = [label for label, column in read.items() if column.dated]
    refusals = {label: column.refusal for label, column in read.items() if column.refusal}
    faults = {label: column.faults for label, column in read.items() if column.faults}
    clock = _clock({label: values[: chunks[0].stop] for label, values in columns.items()}, dated, file.name)
    with opened(file) as kind:
        recording = _recording(kind, file, tuple(read), clock, frozenset(faults))
    taken = (clock.label, clock.counts, recording, *dated)
    others = [n for n in columns if n not in taken and np.isfinite(columns[n]).any()]
    headings = headings_of(others)
    if not headings:
        raise _no_numbers(file.name, labels, refusals)
    # What repeats itself is not moved to even times along a curve, which would hide that it does.
    repeating = frozenset(n for n, h in headings.items() if repeats(columns[h.label]) > HELD)
    layout = replace(_layout(clock, recording, headings), held=repeating, loose=frozenset(faults))
    records = Records(tuple(stretch.record for chunk in chunks for stretch in read_chunk(chunk, layout)))
    seen = look(at_one_period(records, layout), headings)
    if not chunks[0].whole:
        at_rest = {n for n in records.names if all(np.ptp(run.column(n)) == 0.0 for run in records)}
        seen = tuple(_seldom(s, file, layout) if s.name in at_rest else s for s in seen)
    seen = _apart(seen)
    if not any(s.role == "coordinate" for s in seen):
        told = "; ".join([*(f"{s.heading.label}: {s.why}" for s in seen), *_told(refusals)])
        raise InputError(f"no column of {file.name} looks like a coordinate ({told}): write a study, or use identify")
    empty = [label for label in labels if label not in (*others, clock.label, clock.date, recording)]
    empty = [label for label in empty if label or label in (*refusals, *dated)]  # a separator that ends lines is none
    unused = {label: refusals.get(label, "dates" if label in dated else "no numbers, or none") for label in empty}
    if clock.counts is not None:
        unused[clock.counts] = "it counts the rows"
    sampled = _sampled(clock, records, chunks)
    seen_files = dict.fromkeys(chunk.path.name for chunk in chunks)
    if len(seen_files) < len(files) or (len(files) == 1 and sources[0] != file):
        sampled = f"{', '.join(seen_files)}: {sampled}"
    text = "\n".join(_lines(sources, folder, clock, recording, sampled, seen, unused, faults)) + "\n"
    parse_study(text)
    return Drafted(text, sampled, seen, unused)


def _clock(columns: dict[str, FloatArray], dated: Sequence[str], source: str) -> ClockColumn:
    """Return the column of the time, and refuse one whose rows are in another order."""
    clock = clock_of(columns, dated)
    if clock.label is None and (disordered := clock_in_disorder(columns)) is not None:
        raise InputError(
            f"{disordered!r} of {source} seems to hold the time, and its rows are not in the order of it: sort the rows"
            " by that column; if it holds something else, call it otherwise"
        )
    return clock


def _no_numbers(source: str, labels: Sequence[str], refusals: Mapping[str, str]) -> InputError:
    """Return the error of a file without columns to draft from: what is wrong with the file, where that is why."""
    if of_file := [why for why in refusals.values() if source in why]:  # lines that do not fit, doubled names
        return InputError(of_file[0])
    said = f"{source} holds no numbers beside the time; its columns are {', '.join(labels)}"
    return InputError("; ".join([said, *_told(refusals)]))


def _told(refusals: Mapping[str, str]) -> list[str]:
    """Return what columns hold that hold no numbers; of a file that cannot be read all say one thing."""
    reasons = list(refusals.values())
    one_by_one = [f"{label}: {why}" for label, why in refusals.items()]
    return reasons[:1] if len(reasons) > 1 and len(set(reasons)) == 1 else one_by_one


def _recording(
    kind: Format, file: Path, labels: Sequence[str], clock: ClockColumn, loose: frozenset[str]
) -> str | None:
    """Return the column that changes wherever time goes back, or that is called so and stays for long."""
    if clock.label is None:
        return None
    layout = Layout(time=clock.label, columns=(("t", clock.label),), date=clock.date, loose=loose)
    back = set(np.flatnonzero(np.diff(row_seconds(kind.read(file, layout), layout, file.name)) < 0.0).tolist())
    for label in labels:
        layout = Layout(time=clock.label, columns=(("t", clock.label),), recording=label, loose=loose)
        called = LABELS.fullmatch(Heading.of(label).name) is not None
        if label in (clock.label, clock.date) or not (called or back):
            continue
        try:
            _, codes = recording_codes(kind.read(file, layout), layout, file.name)
        except InputError:  # a row without a label: it is none of these
            continue
        changes = set(np.flatnonzero(np.diff(codes)).tolist())
        # Where time goes back at every change, and nowhere else, a recording may be as short as it likes.
        seldom = len(changes) * LEAST_ROWS < len(codes) or (called and back == changes)
        if changes and seldom and back <= changes and (called or back == changes):
            return label
    return None


def headings_of(labels: Sequence[str]) -> dict[str, Heading]:
    """Return headings by names that are usable and differ; a column that is called so itself keeps its name."""
    headings, found = [Heading.of(label) for label in labels], dict[str, Heading]()
    plain = {h.name for h in headings}
    for k, heading in enumerate(headings, 1):
        name = heading.name
        try:
            check_name(name, "column")
        except InputError:
            name = f"column_{k}"
        if name in found or name in FUNCTIONS or name == "identity":
            name = _free(name, k, plain | set(found))
        found[name] = heading
    return found


def _free(name: str, k: int, taken: Collection[str]) -> str:
    """Return a name with a number from k on that nothing else has."""
    return next(free for free in (f"{name}_{number}" for number in count(k)) if free not in taken)


def _apart(seen: Sequence[Seen]) -> tuple[Seen, ...]:
    """Return columns of names other than those of the rates of coordinates, which cannot be called as such."""
    coordinates = [s for s in seen if s.role == "coordinate"]
    taken = {s.name for s in seen} | {n for s in coordinates for n in _derived(s)}
    found = list[Seen]()
    for s in seen:
        of = next((c.name for c in coordinates if c is not s and s.name in _derived(c)), None)
        if of is not None and s.role != "neither":
            name = _free(s.name, 2, taken)
            s = replace(s, name=name, why=f"{s.why}; not known as a derivative of {of}")
            taken |= {name, *_derived(s)}
        found.append(s)
    return tuple(found)


def _derived(s: Seen) -> tuple[str, ...]:
    """Return the names of the derivatives of a coordinate up to the one that its equation is for."""
    c = Coordinate(s.name, s.order)
    return (*c.states[1:], c.target)


def _layout(clock: ClockColumn, recording: str | None, headings: dict[str, Heading]) -> Layout:
    return Layout(
        time=clock.label,
        sample_period=1.0 if clock.label is None else None,
        columns=tuple((name, heading.label) for name, heading in headings.items()),
        recording=recording,
        time_unit=clock.unit,
        date=clock.date,
    )


def _seldom(seen: Seen, file: Path, layout: Layout) -> Seen:
    """Return an input for a column of a long log that rests in all parts that were looked at, if it changes elsewhere.

    Args:
        seen: what it looks like in these parts.
        file: the whole.
        layout: of the columns.
    """
    layout = replace(layout, columns=((seen.name, seen.heading.label),), held=frozenset())
    with opened(file) as kind:
        columns = kind.read(file, layout)
        _, codes = recording_codes(columns, layout, file.name)
        steps = np.abs(np.diff(numbers(columns[seen.heading.label], seen.heading.label, file.name)))
    changes = np.any(steps[np.diff(codes) == 0] > 0.0)
    return replace(seen, role="input", why="it rests for long, as a command does", held=True) if changes else seen


def _sampled(clock: ClockColumn, records: Records, chunks: Sequence[Chunk]) -> str:
    """Return how much was recorded, and how often it was sampled."""
    if not chunks[0].whole:
        told, period = f"{chunks[0].size} samples", records.runs[0].sample_period
        if clock.label is not None:
            told += f", one every {period:.4g} s, about {chunks[0].size * period:.4g} s in all"
        return f"{told}; {records.samples} of them, in {len(chunks)} parts, were looked at"
    measured = sum(len(r) if r.counts is None else round(r.counts.max(axis=1).sum()) for r in records)
    told, period = f"{measured} samples in {_count(len(records), 'recording')}", records.runs[0].sample_period
    if clock.label is None:
        return told
    in_all = sum(r.duration for r in records)
    # At uneven times there are points of a grid without a sample, which nobody has lost.
    every = f"{period:.4g} s" if measured > UNEVEN * records.samples else f"{in_all / measured:.4g} s on average"
    return f"{told}, one every {every}, {in_all:.4g} s in all"


def _lines(
    sources: Sequence[Path],
    folder: Path,
    clock: ClockColumn,
    recording: str | None,
    sampled: str,
    seen: Sequence[Seen],
    unused: Mapping[str, str],
    faults: Mapping[str, str],
) -> Iterator[str]:
    """Yield the lines of a study."""
    files = [_from(folder, source) for source in sources]
    yield "# Drafted from a look at the data: read each line, and correct what was guessed."
    yield "[data]"
    yield f"# {sampled}"
    left_out = _left_out(seen, unused)
    if told := [label for label in faults if label == clock.label or label not in left_out]:
        yield "# CHANGE THIS in the data: a run refuses such cells until they are corrected or emptied"
        yield from (f"#   {_on_one_line(f'{label}: {faults[label]}')}" for label in told)
    yield f"files = {_quoted(files)}"
    if clock.label is None:
        yield _line("sample_period = 1.0", "CHANGE THIS: seconds; no column holds the time")
    else:
        yield _line(f"time = {_quoted(clock.label)}", clock.why or "in seconds")
    if clock.date is not None:
        yield _line(f"date = {_quoted(clock.date)}", "the day of that clock")
    if clock.unit != "s":
        yield _line(f"time_unit = {_quoted(clock.unit)}", "converted to seconds")
    if recording is not None:
        yield _line(f"recording = {_quoted(recording)}", "its changes tell recordings apart")
    yield from ("", "[coordinates]" + " " * (WIDTH - 13) + "# each has an equation, for its derivative of its order")
    yield from (_line(f"{s.name} = {_coordinate(s)}", s.why) for s in seen if s.role == "coordinate")
    inputs = [s for s in seen if s.role == "input"]
    if inputs:
        yield from ("", "[inputs]" + " " * (WIDTH - 8) + "# each may stand in every equation")
        yield from (_line(f"{s.name} = {_input(s)}", s.why) for s in inputs)
    if left_out:
        yield from ("", "# Left out:")
        yield from (f"#   {_on_one_line(f'{label}: {why}')}" for label, why in left_out.items())


def _left_out(seen: Sequence[Seen], unused: Mapping[str, str]) -> dict[str, str]:
    left_out = {s.heading.label: s.why for s in seen if s.role == "neither"} | dict(unused)
    return {label or NAMELESS: why for label, why in left_out.items()}


def _coordinate(s: Seen) -> str:
    parts = [f"order = {s.order}", *_column(s), *(["angle = true"] if s.angle else [])]
    unit = "deg" if s.degrees else s.heading.unit
    return "{ " + ", ".join([*parts, *([f"unit = {_quoted(unit)}"] if unit else [])]) + " }"


def _input(s: Seen) -> str:
    parts = [*_column(s), *(['hold = "zero"'] if s.held else [])]
    parts += [f"unit = {_quoted(s.heading.unit)}"] if s.heading.unit else []
    return "{ " + ", ".join(parts) + " }" if parts else "{}"


def _column(s: Seen) -> list[str]:
    return [] if s.heading.label == s.name else [f"column = {_quoted(s.heading.label)}"]


def _quoted(value: str | list[str]) -> str:
    """Return text as TOML has it, whose basic strings are those of JSON."""
    return json.dumps(value, ensure_ascii=False)


def _line(setting: str, comment: str) -> str:
    return f"{setting:{WIDTH - 1}} # {_on_one_line(comment)}"


def _on_one_line(text: str) -> str:
    """Return a comment as TOML may hold it: a label may have line breaks and other control characters."""
    return re.sub(r"[\x00-\x1f\x7f]+", " ", text)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")


def _from(folder: Path, source: Path) -> str:
    """Return the path of a source as seen from the study's folder."""
    bare = parse_study(f"[data]\nfiles = [{_quoted(source.as_posix())}]\n[coordinates.x]\n")
    return moved(bare, Path(), folder).data.files[0]
