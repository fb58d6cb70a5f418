"""A target or 1 times a term: both ways between a product and one term, and what is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_candidates import BASIS, repeatable, term

from odescope.errors import InputError
from odescope.library.expression import ONE, Name, Term
from odescope.library.product import Product


@repeatable
@given(st.lists(st.sampled_from(BASIS), max_size=4), st.sampled_from([None, "x_ddot", "phi_ddot"]))
def test_a_target_and_the_rest_multiply_to_the_term(texts, target):
    rest = Term.of(f for t in texts for f in term(t).factors)
    whole = rest if target is None else rest * Term.of([(Name(target), 1)])
    product = Product.of(whole, ("x_ddot", "phi_ddot"))
    assert (product.factor, product.term) == (target, rest)
    assert product.expanded == whole
    assert product.degree == sum(abs(p) for _, p in rest.factors)


@pytest.mark.parametrize(
    "text", ["x_ddot**2", "x_ddot*phi_ddot", "sin(x_ddot)", "x_ddot*exp(x_ddot)", "u/x_ddot", "x_ddot*cos(phi_ddot)"]
)
def test_what_is_not_linear_in_the_targets_is_refused(text):
    with pytest.raises(InputError, match="not linear in the targets"):
        Product.of(term(text), ("x_ddot", "phi_ddot"))


def test_the_constant_has_no_target():
    assert Product.of(ONE, ("x_ddot",)) == Product(None, ONE)
