"""Programs that run a model: a module each, with a function `write(model, name)`; a further one is no more than a file.

Their terms are printed by `library.printer`, which asks for a table of how the language writes their parts.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from odescope.errors import InputError

if TYPE_CHECKING:
    from odescope.export.program_files import ProgramFiles
    from odescope.model.model import Model


def names() -> tuple[str, ...]:
    """Return the programs there are: the modules of this package."""
    return tuple(sorted(module.name for module in iter_modules(__path__)))


def program_writer(language: str) -> Callable[[Model, str], ProgramFiles]:
    """Return the function that writes a model as a program of a name.

    Raises:
        InputError: there is no such language.
    """
    known = names()
    if language not in known:
        raise InputError(f"cannot export a program to {language!r}; the languages are {', '.join(known)}")
    found: Callable[[Model, str], ProgramFiles] = import_module(f"{__name__}.{language}").write
    return found
