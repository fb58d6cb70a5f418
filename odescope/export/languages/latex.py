"""A model as LaTeX; how its terms are written stands in library/latex.py."""

from __future__ import annotations

from collections.abc import Iterable

from odescope.errors import check_kind
from odescope.library.latex import LATEX, latex_joined
from odescope.library.printer import print_product
from odescope.model.display import equation_latex, parameters_latex
from odescope.model.mechanism_display import latex_size, mechanisms_latex
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm


def to_latex(model: Model) -> str:
    """Return mechanisms, where there are any, and the equations as LaTeX, one a line.

    Coefficients of equations have six significant digits, those of mechanisms as many as their standard errors allow.
    Without mechanisms the relations follow, those with standard errors, with as many digits as these allow.
    What stands above the arrow of a reaction needs amsmath.
    """
    check_kind(model, Model, "what is written")
    lines = [*mechanisms_latex(model.shown_mechanisms, model.names), *map(equation_latex, model.equations)]
    if not model.mechanisms:
        lines += [_with_errors(r) for r in model.shown_relations if any(t.std_error is not None for t in r.terms)]
    lines += parameters_latex(model.parameters)
    return " \\\\\n".join(lines)


write = to_latex


def _with_errors(relation: Relation) -> str:
    """Return a relation with its targets on the left, and standard errors after its coefficients."""
    right = (t for t in relation.terms if t.factor is None)
    return f"{_sum(relation.left, 1.0)} = {_sum(right, -1.0)}"


def _sum(terms: Iterable[RelationTerm], side: float) -> str:
    """Return a sum of terms, each times 1 or -1."""
    bodies = list[tuple[bool, str]]()
    for t in terms:
        size, product = latex_size(t), print_product(LATEX, t.factor, t.term)
        body = size if product == "1" else product if size == "1" else rf"{size} \, {product}"
        bodies.append((side * t.coefficient < 0.0, body))
    return latex_joined(bodies)
