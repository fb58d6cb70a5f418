"""The larger and the smaller of two, in the text of a term: values, what people are shown, LaTeX."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.library.latex import LATEX
from odescope.library.mathml import MATHML
from odescope.library.parse import Scope, parse_term
from odescope.library.printer import print_term
from odescope.library.readable import displayed, readable
from odescope.library.tape import evaluate, write_tape

SCOPE = Scope.of(["x", "y", "u"], constants=["c"])
ROWS = np.random.default_rng(3).normal(size=(4, 50))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("max(x - c, 0)", lambda x, y, u, c: np.maximum(x - c, 0.0)),
        ("max(0, 2*x - 3)", lambda x, y, u, c: np.maximum(2.0 * x - 3.0, 0.0)),
        ("min(u, 0.5)*y", lambda x, y, u, c: np.minimum(u, 0.5) * y),
        ("max(x, y)**2", lambda x, y, u, c: np.maximum(x, y) ** 2),
        ("min(x*y, 3*x)", lambda x, y, u, c: np.minimum(x * y, 3.0 * x)),
        ("max(min(u, 0.5), -0.5)", lambda x, y, u, c: np.clip(u, -0.5, 0.5)),
        ("abs(max(x, 0) - y)", lambda x, y, u, c: np.abs(np.maximum(x, 0.0) - y)),
    ],
)
def test_values_are_numpys_and_what_is_shown_reads_back(text, value):
    term = parse_term(text, SCOPE)
    assert evaluate(write_tape(["x", "y", "u", "c"], [term]), ROWS)[0] == pytest.approx(value(*ROWS))
    assert parse_term(readable(term), SCOPE) == term
    assert "max(" in displayed(term) or "min(" in displayed(term)


@given(st.floats(-9, 9), st.floats(-9, 9), st.sampled_from(["max", "min"]))
def test_the_order_of_the_two_does_not_matter(slope, place, name):
    text = f"{name}({slope!r}*x - {abs(place)!r}, y)" if place >= 0.0 else f"{name}({slope!r}*x + {-place!r}, y)"
    inside = text[4:-1].rsplit(", ", 1)
    assert parse_term(f"{name}({inside[1]}, {inside[0]})", SCOPE) == parse_term(text, SCOPE)


def test_a_sum_with_the_size_of_something_else_stays_one():
    assert displayed(parse_term("(3 + 0.5*abs(x))**1", SCOPE)) == "(3.0 + 0.5*abs(x))"
    assert displayed(parse_term("(x + 0.5*abs(x))**1", SCOPE)) == "(0.5*abs(x) + x)"
    assert displayed(parse_term("(0.5*x + 0.5*x*abs(x))**1", SCOPE)) == "(0.5*x + 0.5*x*abs(x))"


def test_formulae_say_it_as_people_write_it():
    term = parse_term("y*max(x - c, 0)**2", SCOPE)
    assert print_term(LATEX, term) == r"y \, \max^{2}\left(-c + x, \, 0\right)"
    assert "<mi>max</mi>" in print_term(MATHML, term)
    assert "abs" not in print_term(MATHML, term)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("max(x)", "max takes two arguments, 1 came"),
        ("min(x, y, u)", "min takes two arguments, 3 came"),
        ("max(1, 2)*x", "the arguments of max differ by no variable"),
        ("max(x + 1, x)", "the arguments of max differ by no variable"),
        ("maxi(x, 0)", "there is no function 'maxi'; did you mean 'max'"),
    ],
)
def test_what_is_no_extreme_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        parse_term(text, SCOPE)
