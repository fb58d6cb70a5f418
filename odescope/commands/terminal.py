"""What a run tells, shown on a terminal: results on standard output, everything else on standard error."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from odescope.errors import InputError
from odescope.events import Event, FilesWritten, Note, standing, unheard

if TYPE_CHECKING:
    from odescope.model.model import Model

MOST_ROWS = 20  # of coefficients


@contextmanager
def shown(also: Callable[[Event], None] = unheard) -> Iterator[Callable[[Event], None]]:
    """Yield what shows events: where a run stands on one line, if standard error is a terminal, and what it found.

    `also` is told every event first.
    """
    status = None
    if sys.stderr.isatty():
        from rich.console import Console

        status = Console(stderr=True).status("starting")
        status.start()

    told = set[str]()

    def tell(event: Event) -> None:
        also(event)
        line, out, err = standing(event), found(event), remark(event, told)
        if isinstance(event, Note):
            told.add(event.text)
        if status is not None and line:
            status.update(line)
        if out or err:
            if status is not None:
                status.stop()  # it would take standard output for its own
            if err:
                print(err, file=sys.stderr)
            if out:
                say(out + "\n")
            if status is not None:
                status.start()

    try:
        yield tell
    finally:
        if status is not None:
            status.stop()


def found(event: Event) -> str:
    """Return the equations, if an event brings them: mechanisms with standard errors first, where there are any."""
    from odescope.pipeline.identification import EquationsReady

    if not isinstance(event, EquationsReady):
        return ""
    from odescope.export.languages.text import equation_lines
    from odescope.model.mechanism_display import mechanisms_text
    from odescope.model.recorded_time import in_told_time, told_unit

    model = in_told_time(event.result.model)
    made_of, equations = mechanisms_text(model.shown_mechanisms), equation_lines(model, 6)
    first = [] if model is event.result.model else [f"# time in {told_unit(model)} here, in seconds in all files"]
    if not made_of:
        return "\n".join([*first, *equations])
    heading = "rates of change" if all(c.order == 1 for c in model.coordinates) else "equations of motion"
    return "\n".join([*first, *made_of, heading, *(f"  {line}" for line in equations)])


def remark(event: Event, told: Collection[str] = ()) -> str:
    """Return what is worth a line of its own that stays; before equations, what they are worth.

    Args:
        event: of a run.
        told: what has been said before: advice says no more than is new.
    """
    from odescope.pipeline.identification import EquationsReady, NothingFound

    if isinstance(event, NothingFound):
        return "\n".join(f"advice: {sentence}" for sentence in event.advice if sentence not in told)
    if isinstance(event, EquationsReady):
        return event.result.verdict
    if isinstance(event, Note):
        return f"{'warning' if event.warns else 'note'}: {event.text}"
    return f"wrote {event.folder}/: {', '.join(event.names)}" if isinstance(event, FilesWritten) else ""


def errors_text(model: Model) -> str:
    """Return coefficients with standard errors, as lines, as many as leave a screen for the rest; no text for none."""
    from odescope.model.coefficients import coefficient_lines, rows_with_errors
    from odescope.model.recorded_time import in_told_time

    lines = coefficient_lines(rows_with_errors(in_told_time(model).coefficients))
    shown = (
        lines if len(lines) <= MOST_ROWS else [*lines[:MOST_ROWS], f"... {len(lines) - MOST_ROWS} more in model.json"]
    )
    return "".join(f"{line}\n" for line in ["", *shown]) if lines else ""


def say(text: str) -> None:
    """Write to standard output; a reader that has seen enough, such as head, is no error.

    Raises:
        InputError: it cannot be written.
    """
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in the buffer goes there
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise InputError(f"cannot write to standard output: {error.strerror or error}") from error
