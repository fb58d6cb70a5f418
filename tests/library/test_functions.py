import numpy as np
import pytest
import sympy
from term_oracle import NUMPY, SYMPY, read

from odescope.library.expression import Call, Combination, Name, Term
from odescope.library.functions import FUNCTIONS, Function
from odescope.library.tape import (
    ADD,
    CONSTANT,
    INTEGER_POWER,
    MULTIPLY,
    REAL_POWER,
    SCALE,
    evaluate,
    write_tape,
)
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate

X = Term(((Name("x"), 1),))


def term(function):
    return Term(((Call(function, Combination(((1.0, X),))), 1),))


@pytest.mark.parametrize("function", sorted(FUNCTIONS))
def test_the_derivative_of_a_row_is_sympys(function):
    z = sympy.Symbol("z", real=True)
    ours = sympy.sympify(read(FUNCTIONS[function].derivative, {"z": z}, SYMPY))
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


def test_codes_are_distinct_and_none_of_the_tapes_own():
    codes = [f.code for f in FUNCTIONS.values()]
    assert len(set(codes)) == len(codes)
    assert min(codes) > max(CONSTANT, ADD, MULTIPLY, SCALE, INTEGER_POWER, REAL_POWER)


def test_a_row_without_a_branch_is_refused(monkeypatch):
    monkeypatch.setitem(FUNCTIONS, "sinh", Function("sinh", 99, "cosh(z)", r"\sinh"))
    tape = write_tape(["x"], [term("sinh")])
    with pytest.raises(ValueError, match="without a branch"):
        evaluate(tape, np.ones((1, 3)))
    model = Model(
        (Coordinate("x"),), (), (Relation((RelationTerm("x_dot", Term(), 1.0), RelationTerm(None, term("sinh"), 1.0))),)
    )
    with pytest.raises(ValueError, match="without a branch"):
        simulate(model, np.arange(3.0), np.empty((3, 0)), np.ones(1))
