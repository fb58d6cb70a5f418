"""What can go wrong, said once: each error knows the exit code of the command line."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path


class OdescopeError(Exception):
    """Base of every error that odescope raises on purpose; its text is meant for the user."""

    exit_code = 2


class InputError(OdescopeError, ValueError):
    """The input or the command line is wrong: the text says what was expected, what came and what to do."""

    exit_code = 2


class NoModelError(OdescopeError):
    """The data support no model; `stage` names the stage that came out empty."""

    exit_code = 3

    def __init__(self, stage: str, message: str) -> None:
        super().__init__(stage, message)  # both: an error that comes from another process is made anew from these
        self.stage = stage
        self.message = message

    def __str__(self) -> str:
        return f"no model: the {self.stage} stage came out empty: {self.message}"


class WorkersLostError(OdescopeError):
    """The machines that compute are gone; nothing is wrong with the input, and the same command may be run again."""


class Stopped(OdescopeError):
    """The user stopped the run; the message says what is kept of it."""

    exit_code = 130


@contextmanager
def interrupts_as_such() -> Iterator[None]:
    """Raise as such an interrupt that came while compiled code returned: Python tells SystemErrors that it caused."""
    try:
        yield
    except SystemError as error:
        cause: BaseException | None = error
        while isinstance(cause, SystemError):
            cause = cause.__cause__
        if isinstance(cause, KeyboardInterrupt):
            raise cause from None
        raise


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint that names the closest known name, or lists the known ones where none is close."""
    options = [str(option) for option in known]
    close = difflib.get_close_matches(name, options, n=1, cutoff=0.6)
    if not close:
        folded = {option.casefold(): option for option in options}
        close = [folded[name.casefold()]] if name.casefold() in folded else []
    if close:
        return f"did you mean {close[0]!r}?"
    shown = ", ".join(options[:12]) + (", ..." if len(options) > 12 else "")
    return f"there are: {shown}" if options else "there are none"


def as_path(given: object, what: str) -> Path:
    """Return a path that a caller gave as such or as text; `what` says what of.

    Raises:
        InputError: it is neither, or no file can be called so.
    """
    if isinstance(given, str | os.PathLike):
        path = Path(os.fspath(given))
        if "\0" in str(path):
            raise InputError(f"{what} cannot be called {str(path)!r}: no name of a file holds a zero character")
        return path
    raise InputError(f"{what} is named by its path, as text or pathlib.Path; {said(given)} came")


def said(given: object) -> str:
    """Return what a value is, in words for a message: its kind, and its shape where it has one."""
    if given is None:
        return "None"
    kind, shape = type(given).__name__.removeprefix("nd"), getattr(given, "shape", None)
    article = "an" if kind[:1].lower() in "aeiou" else "a"
    return f"{article} {kind}" + (f" of shape {shape}" if isinstance(shape, tuple) else "")


def check_kind(given: object, kind: type, what: str) -> None:
    """Refuse what is not of a kind.

    Args:
        given: what came.
        kind: a public class of the package.
        what: it is given as, for the message.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(given, kind):
        part = kind.__name__.lower()
        hint = f": pass its .{part}" if isinstance(getattr(given, part, None), kind) else ""
        raise InputError(f"{what} must be odescope.{kind.__name__}; {said(given)} came{hint}")
