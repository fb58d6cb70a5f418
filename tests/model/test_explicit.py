import numpy as np
import pytest
import sympy

from odescope.errors import InputError
from odescope.library.expression import Name
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.model.denominators import denominator_ranges
from odescope.model.display import quotient_latex
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate, Input


def build(coordinates, inputs, *relations):
    names = {c.derivative(k) for c in coordinates for k in range(c.order)} | {i.name for i in inputs}
    scope = Scope.of(names)
    rows = [[RelationTerm(Product(factor, parse_term(text, scope)), c) for factor, text, c in r] for r in relations]
    return Model(tuple(coordinates), tuple(inputs), tuple(Relation(tuple(row)) for row in rows))


# Coefficients are dyadic, so that products of them are exact and SymPy's rationals must agree to the last bit.
CART = build(
    [Coordinate("x", order=2, cyclic=True), Coordinate("phi", order=2, angle=True)],
    [Input("u")],
    [
        ("x_ddot", "1", 1.5),
        ("phi_ddot", "cos(phi)", 0.125),
        (None, "u", -1.0),
        (None, "x_dot", 8.0),
        (None, "sin(phi)*phi_dot**2", -0.125),
    ],
    [
        ("phi_ddot", "1", 0.0625),
        ("x_ddot", "cos(phi)", 0.125),
        (None, "phi_dot", 0.25),
        (None, "sin(phi)", 1.25),
    ],
)
THREE = build(
    [Coordinate("a"), Coordinate("b", order=2), Coordinate("c")],
    [Input("u")],
    [("a_dot", "1", 1.0), ("b_ddot", "b", -0.5), ("c_dot", "tanh(a)", 0.25), (None, "u", 2.0), (None, "c", -1.0)],
    [("b_ddot", "exp(c)", 1.0), ("a_dot", "b_dot", 0.5), (None, "a*b", 4.0)],
    [("c_dot", "c**2", 1.0), ("c_dot", "1", 3.0), ("a_dot", "u", -0.75), (None, "sqrt(2*a + 5)", 1.0)],
)
LONE = build(
    [Coordinate("x"), Coordinate("y")],
    [],
    [("y_dot", "1", 1.0), (None, "x*y", -2.0)],
    [("x_dot", "x", 1.0), ("x_dot", "1", 0.5), (None, "x", 1.5), (None, "1", -0.25)],
)


def symbolic(combination):
    def term(t):
        return sympy.Mul(*(atom(a) ** sympy.Rational(p) for a, p in t.factors))

    def atom(a):
        if isinstance(a, Name):
            return sympy.Symbol(a.name)
        inner = symbolic(a.argument)
        return getattr(sympy, a.function)(inner) if a.function else inner

    return sympy.Add(*(sympy.Rational(c) * term(t) for c, t in combination.parts))


@pytest.mark.parametrize("model", [CART, THREE, LONE], ids=["cart", "three", "lone"])
def test_quotients_are_sympys_solution_of_the_linear_system(model):
    matrix = sympy.Matrix([[symbolic(r.part(t)) for t in model.targets] for r in model.relations])
    right = -sympy.Matrix([symbolic(r.part(None)) for r in model.relations])
    solution = matrix.adjugate() * right
    determinant = matrix.det(method="berkowitz")
    for k, quotient in enumerate(model.quotients):
        assert quotient.target == model.targets[k]
        crossed = symbolic(quotient.numerator) * determinant - solution[k] * symbolic(quotient.denominator)
        assert sympy.expand(crossed) == 0


@pytest.mark.parametrize("model", [CART, THREE, LONE], ids=["cart", "three", "lone"])
def test_quotients_satisfy_every_relation(model):
    columns = np.random.default_rng(1).uniform(-2.0, 2.0, (len(model.variables), 200))
    quotients = model.quotients
    top = evaluate(write_tape(model.variables, [q.numerator for q in quotients]), columns)
    bottom = evaluate(write_tape(model.variables, [q.denominator for q in quotients]), columns)
    for relation in model.relations:
        parts = [relation.part(t) for t in (*model.targets, None)]
        values = evaluate(write_tape(model.variables, parts), columns)
        products = values * np.vstack([top / bottom, np.ones(200)])
        assert np.all(np.abs(products.sum(axis=0)) <= 1e-11 * np.abs(products).sum(axis=0))


def test_a_quotient_is_no_larger_than_its_own_block():
    y_dot, x_dot = LONE.quotients[1], LONE.quotients[0]
    assert y_dot.text == "2.0*x*y"
    assert x_dot.text == "(0.25 - 1.5*x)/(0.5 + x)"


def test_text_of_a_quotient_reads_back_as_itself():
    for model in (CART, THREE, LONE):
        scope = Scope.of(model.variables)
        for q in model.quotients:
            for side in (q.numerator, q.denominator):
                if side.names:
                    ((around, _),) = parse_term(f"exp({side.text})", scope).factors
                    assert around.argument == side


def test_a_target_at_rest_is_zero():
    still = build([Coordinate("x")], [], [("x_dot", "x", 1.0)])
    assert still.quotients[0].numerator.parts == ()
    assert still.quotients[0].text == "(0.0)/(x)"


def test_latex_of_the_michaelis_menten_law():
    law = build(
        [Coordinate("x")],
        [],
        [("x_dot", "x", 1.0), ("x_dot", "1", 0.3), (None, "x", 0.9), (None, "1", -0.18)],
    )
    assert quotient_latex(law.quotients[0]) == r"\dot{x} = \frac{0.18 - 0.9 \, x}{0.3 + x}"
    linear = build([Coordinate("x")], [], [("x_dot", "1", 1.0), (None, "x", 2.0)])
    assert quotient_latex(linear.quotients[0]) == r"\dot{x} = -2 \, x"


# what has no explicit form

PAIR = [Coordinate("x"), Coordinate("y")]


@pytest.mark.parametrize(
    ("relations", "message"),
    [
        (
            ([("x_dot", "1", 1.0), (None, "x", 1.0)], [("x_dot", "1", 1.0), (None, "y", 1.0)]),
            "no relation holds .*y_dot",
        ),
        (
            (
                [("x_dot", "1", 0.1), ("y_dot", "1", 0.7), (None, "x", 1.0)],
                [("x_dot", "1", 0.1 * 0.3), ("y_dot", "1", 0.7 * 0.3), (None, "y", 1.0)],
            ),
            "x_dot, y_dot are not independent",
        ),
        (
            (
                [("x_dot", "x", 2.0), ("y_dot", "y", 1.0)],
                [("x_dot", "x**2", 2.0), ("y_dot", "x*y", 1.0), (None, "y", 1.0)],
            ),
            "x_dot, y_dot are not independent",
        ),
    ],
    ids=["unused", "rounded multiple", "multiple by a term"],
)
def test_relations_that_do_not_determine_the_targets_are_refused(relations, message):
    with pytest.raises(InputError, match=message):
        _ = build(PAIR, [], *relations).quotients


def test_two_relations_for_one_target_beside_one_for_two_are_counted():
    three = [Coordinate("x"), Coordinate("y"), Coordinate("z")]
    relations = (
        [("x_dot", "1", 1.0), (None, "x", 1.0)],
        [("x_dot", "1", 1.0), (None, "y", 1.0)],
        [("y_dot", "1", 1.0), ("z_dot", "1", 1.0)],
    )
    with pytest.raises(InputError, match=r"2 relations cannot determine 1 targets \(x_dot\)"):
        _ = build(three, [], *relations).quotients


def test_six_coupled_targets_are_refused_and_six_apart_are_not():
    names = "abcdef"
    coordinates = [Coordinate(n) for n in names]
    chained = [[(f"{n}_dot", "1", 1.0), (f"{names[k - 1]}_dot", n, 0.5), (None, n, 1.0)] for k, n in enumerate(names)]
    with pytest.raises(InputError, match="6 coupled targets"):
        _ = build(coordinates, [], *chained).quotients
    apart = build(coordinates, [], *([(f"{n}_dot", "1", 1.0), (None, n, 1.0)] for n in names)).quotients
    assert [q.text for q in apart] == [f"-{n}" for n in names]


# the range of the denominators


def test_denominator_ranges_of_the_cart_follow_its_determinant():
    phi = np.linspace(0.1, 1.2, 30)
    columns = np.vstack([0 * phi, phi, 0 * phi, 0 * phi, 0 * phi])
    ranges = denominator_ranges(CART, columns, np.random.default_rng(0))
    determinant = 1.5 * 0.0625 - 0.125**2 * np.cos(phi) ** 2
    for target in CART.targets:
        assert ranges[target]["data"] == pytest.approx([determinant.min(), determinant.max()], rel=1e-13)
        assert ranges[target]["box"] == pytest.approx([determinant.min(), determinant.max()], rel=1e-13)


def test_a_pole_between_the_data_shows_in_the_box_alone():
    # x_dot * (x - y) = 1: along the data x exceeds y, in a corner of their box it does not.
    model = build(PAIR, [], [("x_dot", "x", 1.0), ("x_dot", "y", -1.0), (None, "1", -1.0)], [("y_dot", "1", 1.0)])
    y = np.linspace(0.0, 3.0, 50)
    ranges = denominator_ranges(model, np.vstack([y + 0.5, y]), np.random.default_rng(0))["x_dot"]
    assert ranges["data"] == pytest.approx([0.5, 0.5])
    assert -2.5 <= ranges["box"][0] < -2.0
    assert 3.0 < ranges["box"][1] <= 3.5
