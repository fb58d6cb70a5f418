"""A model as plain text in Python syntax, which terms have as their own."""

from __future__ import annotations

from dataclasses import replace

from odescope.library.expression import Combination
from odescope.model.model import Model


def to_text(model: Model, digits: int | None = None) -> str:
    """Return one explicit equation a line; floats round-trip, or are rounded to `digits` significant digits."""
    quotients = model.quotients
    if digits is not None:
        quotients = tuple(
            replace(q, numerator=_rounded(q.numerator, digits), denominator=_rounded(q.denominator, digits))
            for q in quotients
        )
    return "\n".join(f"{q.target} = {q.text}" for q in quotients)


write = to_text


def _rounded(combination: Combination, digits: int) -> Combination:
    return Combination(tuple((float(f"{c:.{digits}g}"), term) for c, term in combination.parts))
