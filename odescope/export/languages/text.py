"""A model as plain text in Python syntax, which terms have as their own."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from odescope.errors import InputError, check_kind
from odescope.library.expression import Combination, Term
from odescope.library.readable import displayed
from odescope.model.coefficients import coefficient_lines, rows_with_errors
from odescope.model.display import equation_text, parameters_text
from odescope.model.equations import Equation
from odescope.model.explicit import Quotient
from odescope.model.mechanism_display import mechanisms_text
from odescope.model.model import Model
from odescope.model.relation import Relation


def to_text(model: Model, digits: int | None = None) -> str:
    """Return one equation a line: target = fraction, or, where that is long, what multiplies targets = the rest.

    Floats round-trip, or are rounded to `digits` significant digits. Where the model is made of mechanisms, these come
    first, in lines that begin with #; else such lines with the standard errors of coefficients follow.

    Raises:
        InputError: it is no model, or there are less than one digit.
    """
    check_kind(model, Model, "what is written")
    if digits is not None and not (type(digits) is int and digits > 0):
        raise InputError(f"digits must be a whole number from 1, or None for all of them, got {digits!r}")
    lines = [f"# {line}" for line in mechanisms_text(model.shown_mechanisms)]
    errors = [f"# {line}" for line in coefficient_lines(rows_with_errors(model.coefficients))]
    return "\n".join([*lines, *equation_lines(model, digits), *errors])


write = to_text


def equation_lines(model: Model, digits: int | None = None) -> list[str]:
    """Return the equations, one a line, and the constants in them; see `to_text`."""
    equations = model.equations if digits is None else tuple(_rounded(e, digits) for e in model.equations)
    typed = list(dict.fromkeys((*model.named_terms, *(t for e in equations for t in _terms(e)))))
    return [*(_readable(equation_text(e), typed) for e in equations), *parameters_text(model.parameters)]


def _terms(equation: Equation) -> list[Term]:
    """Return the terms of an equation, less the targets that they multiply."""
    if isinstance(equation, Quotient):
        return [t for c in (equation.outside, equation.numerator, equation.denominator) for _, t in c.parts]
    return [t.term for t in equation.terms]


def _readable(line: str, terms: Iterable[Term]) -> str:
    """Return a line with terms as a person would type them, those that name constants and quotients."""
    for term in sorted((t for t in terms if displayed(t) != t.text), key=lambda t: -len(t.text)):
        typed = displayed(term)
        if typed.startswith("1/"):  # 0.43/v, not 0.43*1/v
            line = line.replace(f"*{term.text}", typed.removeprefix("1"))
        line = line.replace(term.text, typed)
    return line


def _rounded(equation: Equation, digits: int) -> Equation:
    if isinstance(equation, Quotient):
        sides = (equation.outside, equation.numerator, equation.denominator)
        beside, top, bottom = (_to_digits(c, digits) for c in sides)
        return replace(equation, outside=beside, numerator=top, denominator=bottom)
    return Relation(tuple(replace(t, coefficient=_to(t.coefficient, digits)) for t in equation.terms))


def _to_digits(combination: Combination, digits: int) -> Combination:
    return Combination(tuple((_to(c, digits), term) for c, term in combination.parts))


def _to(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")
