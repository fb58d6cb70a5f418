"""What a run tells while it works, and how it is asked to stop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from odescope.errors import Stopped


class Event:
    """Something that a run tells: every kind is a small frozen class, and whoever listens picks those it knows."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class StageBegan(Event):
    """A stage of the pipeline began."""

    stage: str


@dataclass(frozen=True, slots=True)
class Progress(Event):
    """`done` of `total` parts of a stage are finished, each a "chunk", a "search"; the rest takes `seconds_left`."""

    stage: str
    part: str
    done: int
    total: int
    seconds_left: float | None = None


@dataclass(frozen=True, slots=True)
class DelaysEstimated(Event):
    """How many seconds each input acts late whose delay was estimated before regression, by its name."""

    delays: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Note(Event):
    """Something the user should know: what was found and done, or, where it `warns`, what may be wrong."""

    text: str
    warns: bool = False


@dataclass(frozen=True, slots=True)
class FilesWritten(Event):
    """Files are complete in a folder; those in a folder within it are named by that folder, with a slash."""

    folder: Path
    names: tuple[str, ...]


def unheard(_: Event) -> None:
    """Hear an event and do nothing."""


def each_note_once(tell: Callable[[Event], None]) -> Callable[[Event], None]:
    """Return what tells all events but notes that it has told before: a run may go through its stages several times."""
    told = set[Event]()

    def tell_new(event: Event) -> None:
        if isinstance(event, Note):
            if event in told:
                return
            told.add(event)
        tell(event)

    return tell_new


def never() -> bool:
    """Never ask to stop."""
    return False


@dataclass(frozen=True, slots=True)
class Monitor:
    """Whom a run tells its events, and whom it asks whether to stop; every stage and search takes one.

    Attributes:
        tell: called with every event, in the thread that runs the pipeline.
        stop: asked at least once a second, in any thread; True ends the run.
    """

    tell: Callable[[Event], None] = unheard
    stop: Callable[[], bool] = never

    def check(self) -> None:
        """Raise Stopped if the run is to end."""
        if self.stop():
            raise Stopped("stopped")


def standing(event: Event) -> str:
    """Return where an event says that the run stands; nothing if it does not say."""
    if isinstance(event, StageBegan):
        return event.stage
    if isinstance(event, Progress):
        left = "" if event.seconds_left is None else f", {span(event.seconds_left)} left"
        counted = event.part if event.total == 1 else f"{event.done} of {event.total} {plural(event.part)}"
        return f"{event.stage}: {counted}{left}"
    return ""


def plural(part: str) -> str:
    """Return the plural of "chunk", "search" and the like."""
    return part + ("es" if part.endswith(("s", "x", "ch", "sh")) else "s")


def span(seconds: float) -> str:
    """Return a time in the two largest of its units."""
    minutes, rest = divmod(max(round(seconds), 0), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
