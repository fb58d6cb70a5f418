"""What is told of a search is told of the model in the end, as its equations are shown."""

from types import SimpleNamespace

from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.relation import Relation, RelationTerm
from odescope.model.scores import SuspicionScore
from odescope.pipeline.found_settings import suspicion_scores

SCOPE = Scope.of(("x", "y", "u"))


def suspicion(target, found):
    return SuspicionScore(target, "x", "fractions", 0, 0.1, 2.0, tried=found, found=found, gain=5.0)


def found_in(left, terms, *found):
    """Return what is told as found of a model whose relation of x has these terms, and that of y a constant."""
    parts = [(0, text) for text in terms] + [(1, "1")]
    mechanisms = [
        SimpleNamespace(parts=(SimpleNamespace(relation=r, product=Product(None, parse_term(text, SCOPE))),))
        for r, text in parts
    ]
    space = SimpleNamespace(mechanisms=mechanisms, frame=SimpleNamespace(targets=("x_dot", "y_dot")))
    refinement = SimpleNamespace(space=space, fit=SimpleNamespace(present=range(len(parts))))
    of_x = [RelationTerm(Product("x_dot", parse_term(text, SCOPE)), 1.0) for text in left]
    of_x += [RelationTerm(Product(None, parse_term(text, SCOPE)), -1.0) for text in terms]
    of_y = RelationTerm(Product("y_dot"), 1.0), RelationTerm(Product(None), -1.0)
    model = SimpleNamespace(relations=(Relation(tuple(of_x)), Relation(of_y)))
    first, second = suspicion_scores((suspicion("x_dot", found), suspicion("y_dot", found)), model, refinement)
    assert second.found == ()  # the other relation holds none of it
    return first.found


def test_a_function_is_told_as_it_stands_in_the_equation():
    assert found_in(("1",), ("u*sqrt(x)", "u"), "u*sqrt(x)") == ("u*sqrt(x)",)
    assert found_in(("u",), ("u*sqrt(x)", "u"), "u*sqrt(x)") == ("sqrt(x)",)  # shown divided by u
    assert found_in(("1", "u"), ("u*sqrt(x)", "u"), "u*sqrt(x)") == ("u*sqrt(x)",)  # a denominator, 1 + u


def test_a_function_that_was_dropped_is_not_told():
    assert found_in(("1",), ("sqrt(x)",), "sqrt(x)", "log(x)") == ("sqrt(x)",)


def test_where_no_likelihood_was_asked_all_is_told_as_it_came():
    of_it = (suspicion("x_dot", ("log(x)",)),)
    assert suspicion_scores(of_it, SimpleNamespace(relations=()), None) == of_it
