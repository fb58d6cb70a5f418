"""Options given in Python are of the kinds that a study file would have them in: what is not is told so."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import get_type_hints

import msgspec
import numpy as np

from odescope.errors import InputError, said


def check_fields(options: msgspec.Struct) -> None:
    """Refuse fields that are of another kind than declared; lists become tuples, paths text, whole numbers floats.

    Raises:
        InputError: a field is of another kind.
    """
    where = type(options).__name__
    for name, hint in get_type_hints(type(options)).items():
        value = _plain(getattr(options, name))
        if name == "files" and isinstance(value, str):
            value = (value,)
        try:
            msgspec.structs.force_setattr(options, name, msgspec.convert(value, hint))
        except msgspec.ValidationError as error:
            raise InputError(f"odescope.{where}({name}=...): {_worded(str(error))}; {value!r} came") from error


def check_tables(options: msgspec.Struct) -> None:
    """Refuse fields that stand for tables of a study file and are of another kind than declared.

    Raises:
        InputError: a field is of another kind; it says what to write.
    """
    for name, kind in get_type_hints(type(options)).items():
        value = getattr(options, name)
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct) and not isinstance(value, kind):
            given = "..."
            if isinstance(value, Mapping) and value and set(value) <= set(kind.__struct_fields__):
                given = ", ".join(f"{key}={part!r}" for key, part in value.items())
            raise InputError(
                f"{name} must be odescope.{kind.__name__}(...); {said(value)} came: write"
                f" {name}=odescope.{kind.__name__}({given})"
            )


def check_parts(options: object, name: str, kind: type) -> None:
    """Refuse a field that is no mapping of names to options of a kind.

    Args:
        options: whose field it is.
        name: of the field.
        kind: of its values.
    """
    parts, wanted = getattr(options, name), f'{name} must be {{"NAME": odescope.{kind.__name__}(...)}}'
    if not isinstance(parts, Mapping):
        raise InputError(f"{wanted}; {said(parts)} came")
    for key, part in parts.items():
        if not (isinstance(key, str) and isinstance(part, kind)):
            raise InputError(f"{wanted}; of {key!r} came {said(part)}")


def _plain(value: object) -> object:
    """Return a value without the kinds of numpy and of paths, in lists and mappings as well."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return tuple(_plain(part) for part in value)
    if isinstance(value, np.generic):
        return value.item()
    return value.__fspath__() if isinstance(value, PathLike) else value


def _worded(message: str) -> str:
    """Return what msgspec says in words of Python."""
    for old, new in (("`array`", "a list or tuple"), (" | null", ""), ("`", ""), (" - at $", " at ")):
        message = message.replace(old, new)
    return message[:1].lower() + message[1:]
