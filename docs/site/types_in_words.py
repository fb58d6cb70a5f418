"""What values a type hint admits, in words."""

from __future__ import annotations

from types import NoneType, UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

import msgspec

PLAIN = {str: "text", float: "number", int: "whole number", bool: "`true` or `false`", NoneType: "null"}
SEVERAL = {"text": "texts", "number": "numbers", "a table with a `kind`": "tables with a `kind` each"}


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
