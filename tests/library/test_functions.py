import numpy as np
import pytest
import sympy
from term_oracle import NUMPY, SYMPY, read

from odescope.export.languages.python import to_python
from odescope.library.expression import Call, Combination, Name, Term
from odescope.library.functions import FUNCTIONS, Function
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.model.simulation import simulate
from odescope.recordings.coordinate import Coordinate, Input

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


@pytest.mark.parametrize("function", sorted(FUNCTIONS))
def test_a_free_run_and_exported_code_compute_the_function_of_its_name(function):
    """Integrals of u' = 1, x' = f(u): the simulation against a fine trapezoid, the exported module against numpy."""
    low, high = (0.1, 1.4) if function in ("log", "sqrt") else (-1.3, 1.4)
    scope = Scope.of(["x", "u"])
    rows = [("x_dot", parse_term("1", scope), 1.0), (None, parse_term(f"{function}(u)", scope), -1.0)]
    relation = Relation(tuple(RelationTerm(Product(f, t), c) for f, t, c in rows))
    model = Model((Coordinate("x"),), (Input("u"),), (relation,))
    u = np.linspace(low, high, 271)
    run = simulate(model, u - low, u[:, None], np.zeros(1))
    fine = np.linspace(low, high, 270 * 64 + 1)
    value = NUMPY[function](fine)
    area = np.concatenate([[0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(fine))])[::64]
    assert run.ended is None
    np.testing.assert_allclose(run.column("x"), area, atol=2e-4)  # a step of 0.01 across the jump of the sign's
    exported: dict = {}
    exec(compile(to_python(model), "exported", "exec"), exported)  # noqa: S102 (our own output)
    for at in (low, 0.7, high):
        assert exported["derivative"](0.0, np.zeros(1), (at,))[0] == pytest.approx(NUMPY[function](at), rel=1e-14)


def test_a_row_without_a_branch_is_refused(monkeypatch):
    monkeypatch.setitem(FUNCTIONS, "arctan", Function("arctan", 99, "1/(1 + z**2)", r"\arctan"))
    with pytest.raises(ValueError, match="no branch"):
        write_tape(["x"], [term("arctan")])
    relation = Relation((RelationTerm(Product("x_dot"), 1.0), RelationTerm(Product(None, term("arctan")), 1.0)))
    model = Model((Coordinate("x"),), (), (relation,))
    with pytest.raises(ValueError, match="no branch"):
        simulate(model, np.arange(3.0), np.empty((3, 0)), np.ones(1))
