"""The text of a study, changed in one place: comments and all that is not meant stay as they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AbstractTable

from odescope.errors import InputError

Setting: TypeAlias = "str | float | int | bool | Sequence[Setting] | dict[str, Setting]"


def with_setting(text: str, path: Sequence[str], value: Setting | None) -> str:
    """Return a study with another value at a key; tables that lack are added, and None removes the key.

    Args:
        text: of the study.
        path: the tables that the key is in, and the key.
        value: what is to stand there.

    Raises:
        InputError: the text is no TOML, or something other than a table stands where one is needed.
    """
    document = _parsed(text)
    table: AbstractTable | tomlkit.TOMLDocument = document
    *tables, key = path
    for name in tables:
        if name not in table:
            if value is None:
                return text
            table[name] = tomlkit.table()
        found = table[name]
        if not isinstance(found, AbstractTable):
            raise InputError(f"{name!r} is no table in this study")
        table = found
    if value is None:
        table.pop(key, None)
    elif key not in table or table[key] != value or type(table[key]) is not type(tomlkit.item(value)):
        table[key] = _kept_comment(table, key, value)
    return tomlkit.dumps(document)


def setting_at(text: str, path: Sequence[str]) -> Setting | None:
    """Return the value at a key, None where there is none.

    Raises:
        InputError: the text is no TOML.
    """
    found: object = _parsed(text).unwrap()
    for name in path:
        if not isinstance(found, dict) or name not in found:
            return None
        found = found[name]
    return found  # type: ignore[return-value]


def written(value: Setting | None) -> str:
    """Return a value as a field of a form shows it: text bare, lists of bare texts with commas, all else as TOML."""
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    if isinstance(value, list) and value and all(isinstance(v, str) and "," not in v for v in value):
        return ", ".join(map(str, value))
    inline = tomlkit.inline_table().append("v", value).as_string()
    return inline.removeprefix("{").removesuffix("}").partition("=")[2].strip()


def parsed(text: str) -> Setting | None:
    """Return the value that a text of TOML spells, None where it spells none."""
    try:
        found: Setting = tomlkit.parse(f"v = {text}").unwrap()["v"]
    except TOMLKitError:
        return None
    return found


def _kept_comment(table: AbstractTable | tomlkit.TOMLDocument, key: str, value: Setting) -> tomlkit.items.Item:
    """Return a value with the comment that stands behind the one it replaces."""
    made: tomlkit.items.Item = tomlkit.item(value)
    if isinstance(value, dict):
        made = tomlkit.inline_table()
        made.update(value)
    if key in table and table[key].trivia.comment:
        made.comment(table[key].trivia.comment.lstrip("# "))
        made.trivia.comment_ws = table[key].trivia.comment_ws
    return made


def _parsed(text: str) -> tomlkit.TOMLDocument:
    try:
        return tomlkit.parse(text)
    except TOMLKitError as error:
        raise InputError(f"it is not TOML: {error}") from error
