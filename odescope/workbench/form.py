"""The options of a study as fields of a form: what they are called, what they mean and admit, from their classes."""

from __future__ import annotations

from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from odescope.errors import InputError
from odescope.study.described import described, in_words, structs
from odescope.study.options import Study
from odescope.workbench.study_text import Setting, parsed, written

MOST_CHOICES = 8


@dataclass(frozen=True)
class FormField:
    """One option.

    Attributes:
        key: its name in the study.
        meaning: from the docstring of its class.
        unit: from there, too; no text for none.
        values: what it admits, in words.
        default: as a field shows it; no text for none.
        choices: all that it admits, where these are few.
        hint: its type.
    """

    key: str
    meaning: str
    unit: str
    values: str
    default: str
    choices: tuple[str, ...]
    hint: object

    def read(self, typed: str) -> Setting | None:
        """Return what was typed as a value for the study, None for nothing; the study decides whether it will do.

        Raises:
            InputError: it is neither text, where such is wanted, nor TOML.
        """
        plain = typed.strip()
        if not plain:
            return None
        spelled = parsed(plain)
        bare = [plain] if plain[0] not in "[{'\"" else []
        listed: list[Setting] = [[part.strip() for part in plain.split(",") if part.strip()]]
        # Text where text will do, "3" as the name of a column; else what TOML makes of it, 3 as an order.
        for value in (*bare, *([] if spelled is None else [spelled]), *listed):
            try:
                msgspec.convert(value, self.hint)
            except msgspec.ValidationError:
                continue
            return value
        if spelled is None:
            raise InputError(f"{self.key} wants {self.values.replace('`', '')}; {plain!r} came")
        return spelled


def fields_of(kind: type) -> tuple[str, tuple[FormField, ...]]:
    """Return what a class of options is about, and its fields."""
    about, meanings = described(kind)
    hints = get_type_hints(kind, include_extras=True)
    found = []
    for field in msgspec.structs.fields(kind):
        unit, meaning = meanings[field.name]
        hint = hints[field.name]
        default = None if field.required else msgspec.to_builtins(_default(field))
        words = in_words(hint)
        found.append(FormField(field.name, meaning, unit, words, written(default), _choices(hint), hint))
    return about, tuple(found)


def sections() -> dict[str, type]:
    """Return the tables of a study by their names, with the classes of what they hold."""
    hints = get_type_hints(Study, include_extras=True)
    return {name: structs(hint)[0] for name, hint in hints.items()}


def _default(field: msgspec.structs.FieldInfo) -> object:
    return field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory()


def _bare(hint: object) -> tuple[object, ...]:
    """Return the alternatives of a type, without bounds and null."""
    if get_origin(hint) is Annotated:
        return _bare(get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        return tuple(part for a in get_args(hint) for part in _bare(a))
    return () if hint is NoneType else (hint,)


def _choices(hint: object) -> tuple[str, ...]:
    """Return the texts and truths that a type admits, where it admits nothing else."""
    found = list[str]()
    for part in _bare(hint):
        if part is bool:
            found += ["true", "false"]
        elif get_origin(part) is Literal:
            found += map(str, get_args(part))
        else:
            return ()
    return tuple(found) if len(found) <= MOST_CHOICES else ()
