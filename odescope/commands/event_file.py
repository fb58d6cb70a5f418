"""What a run tells, written to a file beside what the terminal shows: `identify --events FILE`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from odescope.errors import OdescopeError, Stopped
from odescope.events import Event, unheard


@contextmanager
def told_to(path: Path | None) -> Iterator[Callable[[Event], None]]:
    """Yield what writes events to a file, if one is named; its last line says how what runs inside ended.

    Raises:
        InputError: the file cannot be written.
    """
    if path is None:
        yield unheard
        return
    from odescope.report.event_lines import EventFile

    file = EventFile.begun(path)
    try:
        yield file.tell
    except OdescopeError as error:
        file.end(error.exit_code, str(error))
        raise
    except KeyboardInterrupt:
        file.end(Stopped.exit_code, "stopped before any result was written")
        raise
    except Exception as error:
        file.end(1, f"{type(error).__name__}: {error}")
        raise
    file.end(0)
