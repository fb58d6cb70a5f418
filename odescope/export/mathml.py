"""A model as MathML, which browsers typeset without scripts."""

from __future__ import annotations

from odescope.library.mathml import TIMES, math, mathml_name, mathml_sum, mathml_term
from odescope.model.explicit import explicit
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm


def to_mathml(model: Model) -> str:
    """Return the explicit equations as MathML, one a line, to six significant digits."""
    return "\n".join(math(q.mathml) for q in explicit(model))


def relation_mathml(relation: Relation) -> str:
    """Return a relation of the model as it was found: a sum that is zero."""
    parts = [(t.coefficient, product_mathml(t)) for t in relation.terms]
    return f"{mathml_sum(parts)}<mo>=</mo><mn>0</mn>"


def product_mathml(term: RelationTerm) -> str:
    """Return the product of factor and term."""
    if term.factor is None:
        return mathml_term(term.term)
    target = mathml_name(term.factor)
    return target if not term.term.factors else f"{target}{TIMES}{mathml_term(term.term)}"
