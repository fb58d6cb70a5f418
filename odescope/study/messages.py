"""What is wrong with a study file, in the words of TOML and with the nearest known key or value."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import NoneType
from typing import Any, get_args, get_type_hints

import msgspec

from odescope.errors import InputError, nearest
from odescope.library.rules import AnyRule
from odescope.likelihood.search import LikelihoodSearch
from odescope.regression.proposers import AnyProposer
from odescope.regression.rows import AnyRows
from odescope.selection.ranking import Ranking
from odescope.signals.cutoff import AnyCutoff
from odescope.signals.differentiators import AnyDifferentiator
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Filtering, Measured, Random, Regression, Study
from odescope.study.pieces import PLACES
from odescope.study.wrong_types import in_words_of_toml

_SECTIONS: dict[str, Any] = {
    "data": Data,
    "coordinates": Measured,
    "inputs": Driven,
    "library": Candidates,
    "signals": Filtering,
    "regression": Regression,
    "selection": Ranking,
    "likelihood": LikelihoodSearch,
    "random": Random,
}
_KINDS: dict[str, Any] = {
    "rules": AnyRule,
    "proposers": AnyProposer,
    "rows": AnyRows,
    "differentiator": AnyDifferentiator,
    "cutoff": AnyCutoff,
}
_AS_TYPES = {bool: "true, false", int: "a whole number", float: "a number without quotes", str: "a text"}
_AT = r"(?: - at `\$\.?(?P<path>.*)`)?$"
_UNKNOWN = re.compile(r"unknown field `(?P<key>.*?)`" + _AT, re.DOTALL)
_CHOICE = re.compile(r"^Invalid (?:enum )?value '(?P<value>.*)'" + _AT, re.DOTALL)


def explained(error: Exception, raw: Mapping[str, object]) -> str:
    """Return what msgspec, or a table itself, found wrong with the tables of a study, in one sentence."""
    message = _located(str(error), raw)
    if isinstance(error.__cause__, InputError):
        own, path = str(error.__cause__), re.search(_AT, message)
        where = "" if path is None or path["path"] is None or own.startswith("[") else f"[{path['path']}] "
        return f"{where}{own}"
    return _explained(message)


def _located(message: str, raw: Mapping[str, object]) -> str:
    """Name the coordinate or input that a message of msgspec is about: its paths leave out the keys of a mapping."""
    for section in ("coordinates", "inputs"):
        tables = raw.get(section)
        if f"`$.{section}[...]" not in message or not isinstance(tables, dict):
            continue
        for name, table in tables.items():
            try:
                msgspec.convert(table, _SECTIONS[section])
            except msgspec.ValidationError:
                return message.replace("[...]", f".{name}", 1)
    return message


def _explained(message: str) -> str:
    """Say in the words of TOML what msgspec found, with the nearest known key or value."""
    if "`$.library.parameters" in message:
        return (
            "[library.parameters] wants for every constant the ends of its range, the lower first, such as"
            ' v0 = [0.1, 10.0], or v0 = "scale" for a range from the data'
        )
    if unknown := _UNKNOWN.search(message):
        path = unknown["path"] or ""
        section = f"[{path}]" if path else "the study"
        return f"unknown key {unknown['key']!r} in {section}; {nearest(unknown['key'], _known_keys(path))}"
    if choice := _CHOICE.search(message):
        path = choice["path"] or ""
        return f"unknown value {choice['value']!r} at `{path}`; {nearest(choice['value'], _choices(path))}"
    if message == "Object missing required field `coordinates`":
        return "the study has no coordinates: add [coordinates.NAME]"
    plain = in_words_of_toml(message.replace("`$.", "`"))
    return plain.replace("Object missing required field", "the table lacks the key")


def _parts(path: str) -> list[str]:
    return re.sub(r"\[\d+\]", "", path).split(".")


def _known_keys(path: str) -> list[str]:
    parts = _parts(path)
    if len(parts) > 1 and parts[-1] in _KINDS:
        return sorted({field for kind in get_args(_KINDS[parts[-1]]) for field in kind.__struct_fields__})
    return list(_SECTIONS.get(parts[0], Study).__struct_fields__)


def _choices(path: str) -> list[str]:
    parts = _parts(path)
    if parts[-1] == "kind" and len(parts) > 2:
        kinds = [str(kind.__struct_config__.tag) for kind in get_args(_KINDS[parts[-2]])]
        return kinds + [name for place in PLACES if place.key == parts[-2] for name in place.installed()]
    hint = get_type_hints(_SECTIONS[parts[0]])[parts[-1]]
    options = [value for part in get_args(hint) for value in (get_args(part) or (part,)) if value is not NoneType]
    return [_AS_TYPES.get(value, str(value)) for value in options]
