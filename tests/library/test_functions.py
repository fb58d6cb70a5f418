import numpy as np
import pytest
import sympy
from term_oracle import NUMPY, SYMPY

from odescope.library.expression import Call, Combination, Name, Term
from odescope.library.functions import FIRST_FUNCTION, FUNCTIONS
from odescope.library.tape import evaluate, write_tape

X = Term(((Name("x"), 1),))


def term(function):
    return Term(((Call(function, Combination(((1.0, X),))), 1),))


@pytest.mark.parametrize("function", sorted(FUNCTIONS))
def test_the_derivative_of_a_row_is_sympys(function):
    z = sympy.Symbol("z", real=True)
    ours = sum(
        (
            c * sympy.prod((SYMPY[f](z) if f else z) ** p for f, p in product)
            for c, product in FUNCTIONS[function].derivative
        ),
        sympy.Integer(0),
    )
    theirs = SYMPY[function](z).diff(z)
    for point in (-1.3, -0.4, 0.3, 1.1, 2.5):
        if point > 0 or function not in ("log", "sqrt"):
            assert float(ours.subs(z, point)) == pytest.approx(float(theirs.subs(z, point)), rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("function", sorted(FUNCTIONS))
def test_the_instruction_of_a_row_is_the_function_of_its_name(function):
    x = np.concatenate([np.linspace(-3.0, 3.0, 41), [1e-8, 40.0]])
    with np.errstate(all="ignore"):
        expected = NUMPY[function](x)
    found = evaluate(write_tape(["x"], [term(function)]), x[None, :])[0]
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=0.0, equal_nan=True)


def test_every_row_has_an_instruction_of_its_own():
    assert [f.code for f in FUNCTIONS.values()] == list(range(FIRST_FUNCTION, FIRST_FUNCTION + len(FUNCTIONS)))
    assert [f.name for f in FUNCTIONS.values()] == list(FUNCTIONS)
