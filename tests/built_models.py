"""Models from relations that a test writes down."""

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm


def build(coordinates, inputs, *relations):
    """Coordinates, inputs, and of each relation its terms: factor, text, coefficient."""
    names = {c.derivative(k) for c in coordinates for k in range(c.order)} | {i.name for i in inputs}
    scope = Scope.of(names)
    rows = [[RelationTerm(Product(factor, parse_term(text, scope)), c) for factor, text, c in r] for r in relations]
    return Model(tuple(coordinates), tuple(inputs), tuple(Relation(tuple(row)) for row in rows))
