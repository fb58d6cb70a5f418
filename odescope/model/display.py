"""Equations as people read them: quotients and relations in LaTeX and MathML, and what a notebook shows."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from odescope.library.latex import LATEX, latex_fraction, latex_name
from odescope.library.mathml import MATHML, math, mathml_fraction, mathml_name, mathml_sum
from odescope.library.printer import print_combination, print_product
from odescope.model.explicit import Quotient
from odescope.model.relation import Relation, RelationTerm


def quotient_latex(quotient: Quotient) -> str:
    """Return the equation target = numerator / denominator in LaTeX."""
    right = print_combination(LATEX, quotient.numerator)
    if not quotient.plain:
        right = latex_fraction(right, print_combination(LATEX, quotient.denominator))
    return f"{latex_name(quotient.target)} = {right}"


def quotient_mathml(quotient: Quotient) -> str:
    """Return the equation target = numerator / denominator in MathML."""
    right = print_combination(MATHML, quotient.numerator)
    if not quotient.plain:
        right = mathml_fraction(right, print_combination(MATHML, quotient.denominator))
    return f"{mathml_name(quotient.target)}<mo>=</mo>{right}"


def relation_mathml(relation: Relation) -> str:
    """Return a relation as it was found: a sum that is zero."""
    return f"{mathml_sum((t.coefficient, product_mathml(t)) for t in relation.terms)}<mo>=</mo><mn>0</mn>"


def product_mathml(term: RelationTerm) -> str:
    """Return the product that a coefficient of a relation multiplies."""
    return print_product(MATHML, term.factor, term.term)


def equations_html(quotients: Sequence[Quotient], said: Sequence[str]) -> str:
    """Return the equations in MathML, and below them a list of sentences; all text is escaped."""
    equations = "".join(f"<p>{math(quotient_mathml(q))}</p>" for q in quotients)
    items = "".join(f"<li>{escape(line)}</li>" for line in said)
    return f"<div>{equations}{f'<ul>{items}</ul>' if items else ''}</div>"


def equations_latex(quotients: Sequence[Quotient]) -> str:
    """Return the equations as displayed LaTeX, one a line."""
    return "$$\\begin{gathered}\n" + " \\\\\n".join(map(quotient_latex, quotients)) + "\n\\end{gathered}$$"
