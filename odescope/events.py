"""What a run tells while it works, and how it is asked to stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from odescope.errors import Stopped


@dataclass(frozen=True, slots=True)
class StageBegan:
    """A stage of the pipeline began."""

    stage: str


@dataclass(frozen=True, slots=True)
class Progress:
    """`done` of `total` parts of a stage are finished, each a "chunk", a "search"; the rest takes `seconds_left`."""

    stage: str
    part: str
    done: int
    total: int
    seconds_left: float | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """Something the user should know."""

    text: str


Event = StageBegan | Progress | Note


def _unheard(_: Event) -> None:
    """Hear an event and do nothing."""


def _never() -> bool:
    return False


@dataclass(frozen=True, slots=True)
class Monitor:
    """Whom a run tells its events, and whom it asks whether to stop; every stage and search takes one.

    Attributes:
        tell: called with every event, in the thread that runs the pipeline.
        stop: asked at least once a second; True ends the run.
    """

    tell: Callable[[Event], None] = _unheard
    stop: Callable[[], bool] = _never

    def check(self) -> None:
        """Raise Stopped if the run is to end."""
        if self.stop():
            raise Stopped("stopped")
