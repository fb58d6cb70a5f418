from itertools import product
from math import comb

import pytest
from hypothesis import given
from hypothesis import strategies as st
from term_oracle import NAMES, repeatable

from odescope.errors import InputError
from odescope.library.candidates import Library
from odescope.library.expression import Term
from odescope.library.parse import Scope, parse_term
from odescope.library.rules import Exclusive, MaximumDegree

SCOPE = Scope.of([*NAMES, "x_ddot", "phi_ddot"])
BASIS = ("x", "u", "sin(phi)", "cos(phi)", "phi_dot")


def library(*texts):
    return Library.of(texts, SCOPE)


def term(text):
    return parse_term(text, SCOPE)


@pytest.mark.parametrize("size", [1, 2, 3, 5])
@pytest.mark.parametrize("degree", [0, 1, 2, 4])
def test_powers_are_all_products_to_the_degree_once_each(size, degree):
    found = library(*BASIS[:size]).powers(degree)
    atoms = [term(t).factors[0][0] for t in BASIS[:size]]
    expected = {
        Term.of(zip(atoms, e, strict=True)) for e in product(range(degree + 1), repeat=size) if sum(e) <= degree
    }
    assert len(found) == len(expected) == comb(size + degree, degree)
    assert set(found) == expected
    degrees = [sum(p for _, p in t.factors) for t in found]
    assert degrees == sorted(degrees)


def test_powers_of_a_basis_with_the_constant_or_a_repetition_are_those_without():
    assert library("1", "x", "u", "x").powers(3).terms == library("x", "u").powers(3).terms


def test_powers_of_products_merge():
    assert [t.text for t in library("x", "x**2").powers(2)] == ["1", "x", "x**2", "x**3", "x**4"]


def test_too_many_products_are_refused_before_they_are_made():
    basis = library(*(f"sin({k}*x)" for k in range(2, 60)))
    with pytest.raises(InputError, match=str(comb(58 + 12, 12))):
        basis.powers(12)


@repeatable
@given(st.lists(st.sampled_from(BASIS), max_size=4), st.lists(st.sampled_from(BASIS), max_size=4))
def test_sums_are_unions_and_products_all_pairs(first, second):
    a, b = library(*first), library(*second)
    assert (a + b).terms == tuple(dict.fromkeys(term(t) for t in [*first, *second]))
    assert set(a * b) == {term(s) * term(t) for s in first for t in second}
    assert len(set(a * b)) == len(a * b)


def test_thinning_keeps_order_and_counts_what_each_rule_took():
    whole = library("x", "u", "cos(phi)").powers(3)
    rules = (MaximumDegree(("x",), 1), Exclusive(("x", "u")))
    thinned = whole.thin(rules, SCOPE)
    assert [t for t in whole if t in set(thinned)] == list(thinned)
    # Of 20 products 4 have x^2 or x^3; of the rest, x u meets with nothing, u or cos.
    assert thinned.removed == ((str(rules[0]), 4), (str(rules[1]), 3))
    assert len(whole) - len(thinned) == 7
    again = thinned.thin((MaximumDegree(("u",), 0),), SCOPE) + library("u")
    assert [n for _, n in again.removed] == [4, 3, 6]


def test_a_preview_says_how_much_memory():
    assert library("x", "u").preview(65_000) == "2 candidates x 65000 samples: 1.0 MB if held at once"


def test_a_library_of_unreadable_text_is_refused():
    with pytest.raises(InputError, match="cannot read"):
        library("x", "x + u")
