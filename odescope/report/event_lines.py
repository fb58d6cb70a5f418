"""What a run tells as lines of JSON, for programs that watch it from outside: a file of these outlives its reader."""

from __future__ import annotations

import time
from pathlib import Path

import msgspec

from odescope.errors import InputError
from odescope.events import Event, FilesWritten, Note, Progress, StageBegan
from odescope.export.languages.text import equation_lines
from odescope.json_text import encoded
from odescope.pipeline.identification import DraftReady, EquationsReady, NothingFound
from odescope.report.data import Point
from odescope.report.searches import searched

DIGITS = 6  # of the equations


class EventLine(msgspec.Struct, frozen=True, tag_field="event"):
    """A line of the file; `at` is when it was written, in seconds since 1970."""

    at: float


class StageLine(EventLine, frozen=True, tag="stage"):
    """A stage began."""

    stage: str


class ProgressLine(EventLine, frozen=True, tag="progress"):
    """How far a stage got: see `odescope.events.Progress`."""

    stage: str
    part: str
    done: int
    total: int
    seconds_left: float | None


class CandidatesLine(EventLine, frozen=True, tag="candidates"):
    """The candidates for one target, each with its number of terms and its error on held-out data."""

    target: str
    unit: str
    points: tuple[Point, ...]


class EquationsLine(EventLine, frozen=True, tag="equations"):
    """The equations as text: a `draft` is what stands before the likelihood stage."""

    draft: bool
    equations: tuple[str, ...]


class NoteLine(EventLine, frozen=True, tag="note"):
    """Something the user should know."""

    text: str


class FilesLine(EventLine, frozen=True, tag="files"):
    """Files are complete."""

    names: tuple[str, ...]


class EndLine(EventLine, frozen=True, tag="end"):
    """The run ended, with the exit code of the command, and why where that is not 0."""

    code: int
    message: str


AnyLine = StageLine | ProgressLine | CandidatesLine | EquationsLine | NoteLine | FilesLine | EndLine


def lines_of(event: Event) -> tuple[AnyLine, ...]:
    """Return the lines of an event; none of one that a reader from outside has no use for."""
    at = time.time()
    if isinstance(event, StageBegan):
        return (StageLine(at, event.stage),)
    if isinstance(event, Progress):
        return (ProgressLine(at, event.stage, event.part, event.done, event.total, event.seconds_left),)
    if isinstance(event, DraftReady):
        candidates = (CandidatesLine(at, s.target, s.unit, s.points) for s in searched(event.result))
        return (*candidates, EquationsLine(at, True, tuple(equation_lines(event.result.model, DIGITS))))
    if isinstance(event, EquationsReady):
        return (EquationsLine(at, False, tuple(equation_lines(event.result.model, DIGITS))),)
    if isinstance(event, NothingFound):
        return tuple(NoteLine(at, sentence) for sentence in event.advice)
    if isinstance(event, Note):
        return (NoteLine(at, event.text),)
    return (FilesLine(at, event.names),) if isinstance(event, FilesWritten) else ()


class EventFile:
    """A file that is written line by line, so that it can be read while it grows."""

    def __init__(self, path: Path) -> None:
        """Take a file as it is."""
        self._path = path

    @staticmethod
    def begun(path: Path) -> EventFile:
        """Begin a file anew.

        Raises:
            InputError: it cannot be written.
        """
        try:
            path.write_bytes(b"")
        except OSError as error:
            raise InputError(f"cannot write {path}: {error.strerror or error}") from error
        return EventFile(path)

    def tell(self, event: Event) -> None:
        """Add the lines of an event."""
        self._add(*lines_of(event))

    def end(self, code: int, message: str = "") -> None:
        """Add the last line."""
        self._add(EndLine(time.time(), code, message))

    def _add(self, *lines: AnyLine) -> None:
        with self._path.open("ab") as stream:
            stream.write(b"".join(encoded(line) + b"\n" for line in lines))


def read_events(path: Path, offset: int) -> tuple[tuple[AnyLine, ...], int]:
    """Return the whole lines of a file from a byte on, and the byte after them; a file that is not there has none.

    A line that is none of these is passed over: another version may have written it.
    """
    try:
        with path.open("rb") as stream:
            stream.seek(offset)
            data = stream.read()
    except OSError:
        return (), offset
    whole = data[: data.rfind(b"\n") + 1]
    found = []
    for line in whole.splitlines():
        try:
            found.append(msgspec.json.decode(line, type=AnyLine))
        except (msgspec.MsgspecError, UnicodeDecodeError):
            continue
    return tuple(found), offset + len(whole)
