"""The files that run a model in another language."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from odescope.errors import InputError, check_kind
from odescope.export.spelling import Names
from odescope.model.model import Model
from odescope.recordings.coordinate import check_name

NAME = "plant"  # of a program that nobody has named


@dataclass(frozen=True)
class ProgramFiles:
    """Files by name, and notes on what is not written as the model has it: names that the language reserves."""

    files: Mapping[str, str | bytes]
    notes: tuple[str, ...] = ()


def check_program(model: Model, name: str, names: Names, language: str) -> None:
    """Refuse what is no model, and a name that a program cannot carry.

    Args:
        model: to write.
        name: of functions, or of the model.
        names: what the language asks of names.
        language: for people.

    Raises:
        InputError: it is no model, or the name no plain identifier, or the language reserves it.
    """
    check_kind(model, Model, "what is written")
    check_name(name, "the name of the program")
    if names.spelled([name])[name] != name:
        raise InputError(f"a program in {language} cannot be called {name!r}, a name of its own: choose another")


def check_no_early_input(model: Model, language: str) -> None:
    """Refuse a model of which an input acts before it was recorded, for a language that knows the past alone.

    Args:
        model: to write.
        language: for people.

    Raises:
        InputError: an input has a negative delay.
    """
    early = next((i for i in model.inputs if i.delay < 0.0), None)
    if early is not None:
        raise InputError(
            f"{language} cannot say that the input {early.name!r} acts {-early.delay!r} s before it was recorded: shift"
            f" its column by so much, and write a delay of 0 for {early.name!r} into the model file"
        )
