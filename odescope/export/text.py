"""A model as plain text and as LaTeX, for people."""

from __future__ import annotations

from odescope.library.expression import Combination
from odescope.model.explicit import Quotient, explicit
from odescope.model.model import Model


def to_text(model: Model, digits: int | None = None) -> str:
    """Return one explicit equation a line; floats round-trip, or are rounded to `digits` significant digits."""
    lines = []
    for q in explicit(model):
        shown = (
            q if digits is None else Quotient(q.target, _rounded(q.numerator, digits), _rounded(q.denominator, digits))
        )
        lines.append(f"{q.target} = {shown.text}")
    return "\n".join(lines)


def to_latex(model: Model) -> str:
    """Return the explicit equations as LaTeX, one a line, to six significant digits."""
    return " \\\\\n".join(q.latex for q in explicit(model))


def _rounded(combination: Combination, digits: int) -> Combination:
    return Combination(tuple((float(f"{c:.{digits}g}"), term) for c, term in combination.parts))
