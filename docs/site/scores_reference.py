"""The reference of the scores in model.json, as Markdown: every key from the classes that it is written from."""

from __future__ import annotations

import inspect
from typing import get_type_hints

from odescope.model.scores import ModelScores
from odescope.study.described import in_words, structs


def scores_reference() -> str:
    """Return one paragraph a class, those that hold others first, each with its keys."""
    found = [ModelScores]
    for kind in found:
        inner = [k for hint in get_type_hints(kind).values() for k in structs(hint)]
        found += [k for k in dict.fromkeys(inner) if k not in found]
    return "\n\n".join(map(_entry, found))


def _entry(kind: type) -> str:
    name = "scores" if kind is ModelScores else kind.__name__
    keys = "\n".join(f"- `{key}`: {in_words(hint, null=True)}" for key, hint in get_type_hints(kind).items())
    return f"**`{name}`**: {inspect.cleandoc(kind.__doc__ or '')}\n\n{keys}"
