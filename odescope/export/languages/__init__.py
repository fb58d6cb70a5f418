"""Languages to write a model in: a module each, with a function `write(model)`; to add one takes no more than its file.

Its terms are printed by `library.printer`, which asks for a table of how the language writes their parts.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from odescope.errors import InputError

if TYPE_CHECKING:
    from odescope.model.model import Model


def names() -> tuple[str, ...]:
    """Return the languages there are: the modules of this package."""
    return tuple(sorted(module.name for module in iter_modules(__path__)))


def writer(language: str) -> Callable[[Model], str]:
    """Return the function that writes a model in a language.

    Raises:
        InputError: there is no such language.
    """
    known = names()
    if language not in known:
        raise InputError(f"cannot export to {language!r}; the languages are {', '.join(known)}")
    found: Callable[[Model], str] = import_module(f"{__name__}.{language}").write
    return found
