"""A model as files in any language: those that show it to people, and those that run it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odescope.errors import InputError, nearest
from odescope.export import languages, programs

if TYPE_CHECKING:
    from odescope.export.program_files import ProgramFiles
    from odescope.model.model import Model

ENDINGS = {"latex": "tex", "mathml": "html", "python": "py", "text": "txt"}


def export_names() -> list[str]:
    """Return the languages that a model can be exported to, of both kinds."""
    return sorted({*languages.names(), *programs.names()})


def exported(model: Model, to: str, name: str) -> ProgramFiles:
    """Return a model in a language.

    Args:
        model: to write.
        to: the language.
        name: what a program is called.

    Raises:
        InputError: there is no such language, or it cannot express the model.
    """
    from odescope.export.program_files import ProgramFiles

    if to in programs.names():
        return programs.program_writer(to)(model, name)
    if to not in languages.names():
        hint = nearest(to, export_names())
        close = f"{hint} " if hint.startswith("did you mean") else ""
        raise InputError(f"cannot export to {to!r}; {close}the languages are {', '.join(export_names())}")
    return ProgramFiles({f"model.{ENDINGS.get(to, to)}": languages.writer(to)(model).rstrip("\n") + "\n"})
