"""The reference of studies, as Markdown: every key of every table, from the classes that read it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import get_type_hints

import msgspec

from odescope.study.described import described, in_words, structs
from odescope.study.options import Study

TABLES = {"coordinates": "coordinates.NAME", "inputs": "inputs.NAME"}


def study_reference() -> str:
    """Return one section a table of a study file."""
    sections = get_type_hints(Study, include_extras=True)
    order = sorted(sections, key=lambda section: section != "data")  # which is where study files begin
    return "\n\n".join(p for section in order for p in _table(section, structs(sections[section])[0]))


def _table(section: str, kind: type) -> Iterator[str]:
    yield f"(study-{section})=\n## `[{TABLES.get(section, section)}]`"
    yield described(kind)[0]
    yield from _keys(kind, f"study-{section}")
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if any(_tag(k) for k in structs(hint)):
            yield from _kinds(f"{section}.{name}", structs(hint), "list of" in in_words(hint))


def _kinds(place: str, kinds: tuple[type, ...], several: bool) -> Iterator[str]:
    """The kinds of a piece; one that is a piece within another comes after it."""
    header = f"[[{place}]]" if several else f"[{place}]"
    yield f"(study-{place.replace('.', '-')}-kinds)=\n### Kinds of `{header}`"
    for kind in kinds:
        yield f'**`kind = "{_tag(kind)}"`**: {described(kind)[0]}'
        yield from _keys(kind, f"study-{place.replace('.', '-')}-{_tag(kind)}")
    for kind in kinds:
        for name, hint in get_type_hints(kind, include_extras=True).items():
            if structs(hint):
                yield from _kinds(f"{place}.{name}", structs(hint), "list of" in in_words(hint))


def _keys(kind: type, anchor: str) -> Iterator[str]:
    hints, (_, meanings) = get_type_hints(kind, include_extras=True), described(kind)
    for field in msgspec.structs.fields(kind):
        unit, meaning = meanings[field.name]
        facts = [in_words(hints[field.name]), f"in {unit}" if unit else "", _default(field)]
        yield f"({anchor}-{field.name})=\n`{field.name}`\n: {'; '.join(filter(None, facts))}\n\n  {_capital(meaning)}"


def _default(field: msgspec.structs.FieldInfo) -> str:
    if field.required:
        return "needed"
    value = field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory()
    return "no default" if value is None else f"default `{_toml(msgspec.to_builtins(value))}`"


def _toml(value: object) -> str:
    """Return a value as TOML writes it in one line."""
    if isinstance(value, dict):
        inside = ", ".join(f"{key} = {_toml(v)}" for key, v in value.items() if v is not None)
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return msgspec.json.encode(value).decode()


def _tag(kind: type) -> str | None:
    return kind.__struct_config__.tag  # type: ignore[attr-defined, no-any-return]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
