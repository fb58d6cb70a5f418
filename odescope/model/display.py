"""Equations as people read them: quotients and relations in LaTeX and MathML, and what a notebook shows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from odescope.library.expression import Term, signed_sum
from odescope.library.latex import LATEX, latex_fraction, latex_joined, latex_name, latex_number, latex_sum
from odescope.library.mathml import (
    LINE,
    MATHML,
    TIMES,
    math,
    mathml_fraction,
    mathml_joined,
    mathml_name,
    mathml_number,
    mathml_sum,
    written_length,
)
from odescope.library.printer import print_combination, print_product, print_term
from odescope.model.coefficients import UNITS, CoefficientRow
from odescope.model.equations import Equation
from odescope.model.explicit import SAME, Quotient
from odescope.model.mechanism_display import mechanisms_latex, mechanisms_mathml
from odescope.model.relation import FoundMechanism, FoundParameter, Relation, RelationTerm
from odescope.model.rounding import rounded, with_last_digits


def equation_text(equation: Equation) -> str:
    """Return an equation in Python syntax: a target and its fraction, or a relation with its targets on the left."""
    if isinstance(equation, Quotient):
        return f"{equation.target} = {equation.text}"
    left = signed_sum((t.coefficient, t.text) for t in equation.left)
    return f"{left} = {equation.right.text}"


def parameters_text(parameters: Sequence[FoundParameter]) -> list[str]:
    """Return a line of plain text for every constant within functions, its standard error after +-."""
    return [f"{p.name} = {value}" + (f" +- {error}" if error else "") for p, value, error in _sizes(parameters)]


def parameters_latex(parameters: Sequence[FoundParameter]) -> list[str]:
    """Return the same in LaTeX."""
    return [
        f"{latex_name(p.name)} = {latex_number(value)}" + (rf" \pm {latex_number(error)}" if error else "")
        for p, value, error in _sizes(parameters)
    ]


def parameters_mathml(parameters: Sequence[FoundParameter]) -> list[str]:
    """Return the same in MathML."""
    return [
        f"{mathml_name(p.name)}<mo>=</mo>{mathml_number(value)}"
        + (f"<mo>±</mo>{mathml_number(error)}" if error else "")
        for p, value, error in _sizes(parameters)
    ]


def _sizes(parameters: Sequence[FoundParameter]) -> list[tuple[FoundParameter, str, str]]:
    """Return those that are written by name somewhere, with value and standard error as text."""
    return [(p, *rounded(p.value, p.std_error)) for p in parameters if p.written]


def equation_latex(equation: Equation) -> str:
    """Return an equation in LaTeX, as `equation_text`."""
    if isinstance(equation, Quotient):
        return quotient_latex(equation)
    left = latex_sum((t.coefficient, print_product(LATEX, t.factor, t.term)) for t in equation.left)
    return f"{left} = {print_combination(LATEX, equation.right)}"


def equation_mathml(equation: Equation) -> str:
    """Return an equation in MathML, as `equation_text`."""
    if isinstance(equation, Quotient):
        return quotient_mathml(equation)
    left = mathml_sum((t.coefficient, product_mathml(t)) for t in equation.left)
    return f"{left}<mo>=</mo>{print_combination(MATHML, equation.right)}"


def stated_mathml(equation: Equation, relations: Sequence[Relation]) -> str:
    """Return an equation in MathML with standard errors, in brackets behind the digits that they are of.

    A fraction has them where it is one relation solved for its target; one of several relations has none.

    Args:
        equation: as it is shown.
        relations: of the model, with the same names for constants.
    """
    if not isinstance(equation, Quotient):
        left = _stated((t.coefficient, product_mathml(t), t.std_error) for t in equation.left)
        right = [t for t in equation.terms if t not in equation.left]
        room = max(LINE - written_length(left), LINE // 2)
        return f"{left}<mo>=</mo>{_stated(((-t.coefficient, product_mathml(t), t.std_error) for t in right), room)}"
    errors = _errors_of(equation, relations)
    if errors is None:
        return quotient_mathml(equation)
    outside, *parts = [
        _stated((c, print_term(MATHML, term), errors[factor, term]) for c, term in side.parts)
        for factor, side in (
            (None, equation.outside),
            (None, equation.unsigned),
            (equation.target, equation.denominator),
        )
    ]
    right_side = parts[0] if equation.plain else mathml_fraction(*parts)
    return f"{mathml_name(equation.target)}<mo>=</mo>{_beside(equation, outside, right_side)}"


def _errors_of(quotient: Quotient, relations: Sequence[Relation]) -> dict[tuple[str | None, Term], float | None] | None:
    """Return the errors of the coefficients of a fraction by factor and term; None where it is not one relation.

    A relation with one product of its target is shown divided by that.
    """
    whole = quotient.together
    sides = ((None, -1.0, whole.numerator), (quotient.target, 1.0, whole.denominator))
    wanted = {(factor, term): sign * c for factor, sign, side in sides for c, term in side.parts}
    for relation in relations:
        known = {(t.factor, t.term): t for t in relation.divided.terms}
        if known.keys() == wanted.keys() and all(
            abs(known[key].coefficient - c) <= SAME * abs(c) for key, c in wanted.items()
        ):
            return {key: t.std_error for key, t in known.items()}
    return None


def _stated(parts: Iterable[tuple[float, str, float | None]], line: int = LINE) -> str:
    """Return a signed sum of coefficient, product and standard error in MathML."""
    bodies = list[tuple[bool, str]]()
    for coefficient, product, error in parts:
        value, digits = with_last_digits(abs(coefficient), error)
        size = f"<mrow>{mathml_number(value)}<mtext>({digits})</mtext></mrow>" if digits else mathml_number(value)
        alone = product == mathml_number("1")
        body = size if alone else product if size == mathml_number("1") else size + TIMES + product
        bodies.append((coefficient < 0.0, body))
    return mathml_joined(bodies, line)


def quotient_latex(quotient: Quotient) -> str:
    """Return the equation target = numerator / denominator in LaTeX."""
    right = print_combination(LATEX, quotient.unsigned)
    if not quotient.plain:
        right = latex_fraction(right, print_combination(LATEX, quotient.denominator))
    if quotient.outside.parts:
        right = latex_joined([(False, print_combination(LATEX, quotient.outside)), (quotient.negative, right)])
    return f"{latex_name(quotient.target)} = {right}"


def quotient_mathml(quotient: Quotient) -> str:
    """Return the equation target = numerator / denominator in MathML."""
    right = print_combination(MATHML, quotient.unsigned)
    if not quotient.plain:
        right = mathml_fraction(right, print_combination(MATHML, quotient.denominator))
    outside = print_combination(MATHML, quotient.outside)
    return f"{mathml_name(quotient.target)}<mo>=</mo>{_beside(quotient, outside, right)}"


def _beside(quotient: Quotient, outside: str, fraction: str) -> str:
    """Return MathML of a fraction and what stands outside of it, if anything does."""
    return mathml_joined([(False, outside), (quotient.negative, fraction)]) if quotient.outside.parts else fraction


def relation_mathml(relation: Relation) -> str:
    """Return a relation as it was found: a sum that is zero."""
    return f"{mathml_sum((t.coefficient, product_mathml(t)) for t in relation.terms)}<mo>=</mo><mn>0</mn>"


def product_mathml(term: RelationTerm) -> str:
    """Return the product that a coefficient of a relation multiplies."""
    return print_product(MATHML, term.factor, term.term)


def equations_html(
    equations: Sequence[Equation],
    said: Sequence[str],
    mechanisms: Sequence[FoundMechanism] = (),
    names: Sequence[str] = (),
    parameters: Sequence[FoundParameter] = (),
    rows: Sequence[CoefficientRow] = (),
) -> str:
    """Return mechanisms and equations in MathML, coefficients in a table, and a list of sentences; text is escaped.

    Args:
        equations: of the model, as they are shown.
        said: the sentences.
        mechanisms: of the model.
        names: its states, inputs and constants, which mechanisms may name.
        parameters: its constants.
        rows: coefficients with standard errors.
    """
    formulas = [*mechanisms_mathml(mechanisms, names), *map(equation_mathml, equations), *parameters_mathml(parameters)]
    shown = "".join(f"<p>{math(formula)}</p>" for formula in formulas)
    items = "".join(f"<li>{escape(line)}</li>" for line in said)
    return f"<div>{shown}{_table_html(rows)}{f'<ul>{items}</ul>' if items else ''}</div>"


def _table_html(rows: Sequence[CoefficientRow]) -> str:
    """Return coefficients and their standard errors as a table; nothing where there are none."""
    headings = ("equation", "term", "coefficient", "standard error")
    cells = [headings]
    for row in rows:
        value, error = rounded(row.coefficient, row.std_error)
        cells.append((row.equation or row.kind, row.term, value + UNITS.get(row.kind, ""), error))
    lines = [
        "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in line) + "</tr>"
        for tag, line in zip(["th"] + ["td"] * len(rows), cells, strict=True)
    ]
    return f"<table>{''.join(lines)}</table>" if rows else ""


def equations_latex(
    equations: Sequence[Equation],
    mechanisms: Sequence[FoundMechanism] = (),
    names: Sequence[str] = (),
    parameters: Sequence[FoundParameter] = (),
) -> str:
    """Return mechanisms and equations as displayed LaTeX, one a line.

    Args:
        equations: of the model, as they are shown.
        mechanisms: of the model.
        names: its states, inputs and constants, which mechanisms may name.
        parameters: its constants.
    """
    lines = [*mechanisms_latex(mechanisms, names), *map(equation_latex, equations), *parameters_latex(parameters)]
    return "$$\\begin{gathered}\n" + " \\\\\n".join(lines) + "\n\\end{gathered}$$"
