"""What may stand in a study, in words: the meaning of every option from its docstring, its values from its type."""

from __future__ import annotations

import inspect
import re
from types import NoneType, UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

import msgspec

ATTRIBUTE = re.compile(r"^    (?P<name>\w+)(?: \((?P<unit>[^)]*)\))?: (?P<text>.*(?:\n {8}.*)*)", re.MULTILINE)
PLAIN = {str: "text", float: "number", int: "whole number", bool: "`true` or `false`", NoneType: "null"}
SEVERAL = {"text": "texts", "number": "numbers", "a table with a `kind`": "tables with a `kind` each"}


def described(kind: type) -> tuple[str, dict[str, tuple[str, str]]]:
    """Return what the docstring of a class of options says: its text, and unit and meaning of every attribute.

    Raises:
        LookupError: a field is not among the attributes, or an attribute is no field.
    """
    text, _, attributes = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:\n")
    found = {m["name"]: (m["unit"] or "", " ".join(m["text"].split())) for m in ATTRIBUTE.finditer(attributes)}
    fields = kind.__struct_fields__  # type: ignore[attr-defined]
    if wrong := set(found) ^ set(fields):
        raise LookupError(f"{kind.__name__}: attributes and fields differ in {', '.join(sorted(wrong))}")
    return text.strip(), {name: found[name] for name in fields}


def in_words(hint: object, null: bool = False) -> str:
    """Return what values a hint admits.

    Args:
        hint: of a field, its bounds included.
        null: whether null is a value, or stands for a key that is left out.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return in_words(arguments[0], null) + "".join(_bounds(a) for a in arguments[1:] if isinstance(a, msgspec.Meta))
    if origin in (Union, UnionType):
        if all(structs(a) == (a,) for a in arguments):
            return "a table with a `kind`"
        return " or ".join(in_words(a, null) for a in arguments if null or a is not NoneType)
    if origin is Literal:
        return " or ".join(f'`"{a}"`' for a in arguments)
    if origin is tuple and arguments[-1] is not Ellipsis:
        return f"[{', '.join(in_words(a, null) for a in arguments)}]"
    if origin in (tuple, dict):
        one = in_words(arguments[0 if origin is tuple else 1], null)
        return f"{'list' if origin is tuple else 'table'} of {SEVERAL.get(one, one)}"
    if structs(hint):
        return f"`{hint.__name__}`"  # type: ignore[attr-defined]
    return PLAIN[hint]  # type: ignore[index]


def structs(hint: object) -> tuple[type, ...]:
    """Return the classes of options or scores in a hint."""
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return (hint,)
    return tuple(kind for argument in get_args(hint) for kind in structs(argument))


def _bounds(meta: msgspec.Meta) -> str:
    said = {"at least": meta.ge, "above": meta.gt, "at most": meta.le, "below": meta.lt}
    return "".join(f", {word} {bound:g}" for word, bound in said.items() if bound is not None)
