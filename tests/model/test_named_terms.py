"""Equations as they are shown, with the names of constants, say what the relations say with numbers."""

import numpy as np
import pytest

from odescope.export.languages.text import to_text
from odescope.library.constants import term_at
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.model.model import Model
from odescope.model.relation import FoundParameter, Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate, Input

X = Scope.of(["x", "u"])
VALUES = {"K": 5.0, "n": 2.4}


@pytest.mark.parametrize("text", ["(x/K)**n", "x**n", "x/(K + x)", "(x/K)**n/(1 + (x/K)**n)", "exp(-K/x)"])
def test_a_number_that_leaves_a_term_is_not_counted_twice(text):
    named = parse_term(text, Scope.of(["x", "u"], constants=list(VALUES)))
    share, plain = term_at(named, VALUES)
    size = -3.0 * share
    found = [FoundParameter(k, v, 0.01, (plain.text,), (text,)) for k, v in VALUES.items() if k in named.names]
    terms = (("x_dot", "1", 1.0), (None, plain.text, -size), (None, "u", -1.0))
    scope = Scope.of(["x", "u"])
    relation = Relation(tuple(RelationTerm(Product(f, parse_term(t, scope)), c, abs(c) / 100.0) for f, t, c in terms))
    model = Model((Coordinate("x"),), (Input("u"),), (relation,), parameters=tuple(found))
    (shown,) = model.shown_relations
    x = np.linspace(0.5, 4.0, 20)
    columns = np.vstack([x, np.zeros(20), *(np.full(20, v) for v in VALUES.values())])
    law = evaluate(write_tape(["x", "u", *VALUES], [shown.terms[1].term]), columns)[0] * shown.terms[1].coefficient
    expected = 3.0 * evaluate(write_tape(["x", "u", *VALUES], [named]), columns)[0]
    np.testing.assert_allclose(law, expected, rtol=1e-12)
    assert shown.terms[1].coefficient == pytest.approx(3.0)
    assert shown.terms[1].std_error == pytest.approx(0.03)
    assert "x_dot = u - 3.0*" in to_text(model, 3) or "x_dot = -3.0*" in to_text(model, 3)


@pytest.mark.parametrize(
    ("text", "value"), [("(x/K)**2", 0.0), ("exp(-x/K)", 0.0), ("x*tanh(u/K)", 0.0), ("x*K**0.5", -2.0)]
)
def test_a_term_without_a_value_at_its_constant_is_shown_with_its_number(text, value):
    """A file may say so; the relations hold numbers, so that nothing but the name is lost."""
    relation = Relation((RelationTerm(Product("x_dot"), 1.0), RelationTerm(Product(None, parse_term("x", X)), 3.0)))
    constant = FoundParameter("K", value, None, ("x",), (text,))
    model = Model((Coordinate("x"),), (Input("u"),), (relation,), parameters=(constant,))
    assert repr(model).startswith("x_dot = -3.0*x")
