"""A model as equations of states, targets and inputs, for languages that solve equations themselves."""

from __future__ import annotations

from collections.abc import Mapping

from odescope.export.smooth import SmoothRelations
from odescope.library.expression import Combination, Power, signed_sum
from odescope.library.printer import Language, print_combination
from odescope.library.product import Product
from odescope.model.model import Model


def caret_language(names: Mapping[str, str], functions: Mapping[str, str]) -> Language[str]:
    """Return how terms are written where ^ is a power.

    Args:
        names: how states, targets and inputs are written.
        functions: how functions are that do not have their own names, each a pattern for its argument.
    """
    return Language(
        name=lambda name, power: _raised(names[name], power),
        call=lambda function, argument, power: _raised(
            functions.get(function, function + "({})").format(argument), power
        ),
        group=lambda inside, power: _raised(f"({inside})", power),
        product=lambda factors: "*".join(factors) or "1",
        sum=signed_sum,
    )


def equations(model: Model, relations: SmoothRelations, language: Language[str]) -> tuple[tuple[str, str], ...]:
    """Return both sides of every relation: what holds targets on the left.

    Args:
        model: to write.
        relations: its relations.
        language: to print in.
    """
    sides = list[tuple[str, str]]()
    for row, right in zip(relations.matrix, relations.right, strict=True):
        parts = [
            (c, Product(target, term).expanded)
            for target, entry in zip(model.targets, row, strict=True)
            for c, term in entry.parts
        ]
        sides.append((print_combination(language, Combination(tuple(parts))), print_combination(language, right)))
    return tuple(sides)


def _raised(body: str, power: Power) -> str:
    return body if power == 1 else f"{body}^{power}" if power > 0 else f"{body}^({power})"
