from dataclasses import replace

import numpy as np
import pytest

from odescope.errors import InputError
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.library.tape import evaluate
from odescope.model.model import Model
from odescope.model.relation import Relation, RelationTerm
from odescope.model.scores import ModelScores
from odescope.recordings.coordinate import Coordinate, Input

CART, ANGLE, FORCE = Coordinate("x", order=2, cyclic=True), Coordinate("phi", order=2, angle=True), Input("u")
SCOPE = Scope.of(frozenset({"x", "phi", "x_dot", "phi_dot", "x_ddot", "phi_ddot", "u", "stray"}))


def relation(*parts):
    return Relation(tuple(RelationTerm(Product(factor, parse_term(text, SCOPE)), c) for factor, text, c in parts))


CARRIAGE = relation(
    ("x_ddot", "1", 2.3), ("phi_ddot", "cos(phi)", 0.5), (None, "u", -1.0), (None, "sin(phi)*phi_dot**2", -0.4)
)
PENDULUM = relation(
    ("phi_ddot", "1", 0.09), ("x_ddot", "cos(phi)", 0.4), (None, "phi_dot", 0.02), (None, "sin(phi)", 3.9)
)


def model(*relations, inputs=(FORCE,)):
    return Model((CART, ANGLE), inputs, relations)


def test_states_come_by_order_of_derivative_and_variables_end_with_the_inputs():
    mixed = Model(
        (Coordinate("x", order=3), Coordinate("y")),
        (FORCE,),
        (
            Relation((RelationTerm(Product("x_dddot", parse_term("u", SCOPE)), 1.0),)),
            Relation((RelationTerm(Product("y_dot", parse_term("x", SCOPE)), 1.0),)),
        ),
    )
    assert mixed.states == ("x", "y", "x_dot", "x_ddot")
    assert mixed.targets == ("x_dddot", "y_dot")
    assert mixed.variables == ("x", "y", "x_dot", "x_ddot", "u")


def test_tape_gives_the_matrix_row_by_row_and_then_the_right_hand_side():
    columns = np.random.default_rng(0).uniform(-2.0, 2.0, (5, 40))
    _, phi, _, phi_dot, u = columns
    found = evaluate(model(CARRIAGE, PENDULUM).tape, columns)
    expected = [
        2.3 + 0 * phi,
        0.5 * np.cos(phi),
        0.4 * np.cos(phi),
        0.09 + 0 * phi,
        u + 0.4 * np.sin(phi) * phi_dot**2,
        -0.02 * phi_dot - 3.9 * np.sin(phi),
    ]
    assert found == pytest.approx(np.array(expected), rel=1e-14, abs=1e-14)


def test_part_adds_what_multiplies_one_factor_and_drops_what_cancels():
    doubled = relation(("x_ddot", "u", 1.0), ("x_ddot", "u", 0.5), ("x_ddot", "phi", 2.0), ("x_ddot", "phi", -2.0))
    assert doubled.part("x_ddot").text == "1.5*u"
    assert doubled.part("phi_ddot").parts == ()
    assert doubled.part(None).parts == ()


def test_the_text_of_a_term_reads_back_as_the_product_of_factor_and_term():
    for part in (*CARRIAGE.terms, *PENDULUM.terms):
        expected = parse_term(part.factor, SCOPE) * part.term if part.factor else part.term
        assert parse_term(part.text, SCOPE) == expected


def test_models_that_say_the_same_are_equal_whatever_was_computed_from_them():
    first, second = model(CARRIAGE, PENDULUM), model(CARRIAGE, PENDULUM)
    assert first.tape.slots > 0
    assert first == second
    assert replace(first, scores=ModelScores(left_out=1)) != second


@pytest.mark.parametrize(
    ("relations", "inputs", "message"),
    [
        ((CARRIAGE,), (FORCE,), "2 targets needs as many relations; 1 came"),
        ((CARRIAGE, PENDULUM, PENDULUM), (FORCE,), "2 targets needs as many relations; 3 came"),
        ((CARRIAGE, relation((None, "phi", 1.0), (None, "u", 1.0))), (FORCE,), "holds no target"),
        (
            (CARRIAGE, relation(("x", "phi", 1.0))),
            (FORCE,),
            "factor 'x' is no target; the targets are x_ddot, phi_ddot",
        ),
        ((CARRIAGE, relation(("x_ddot", "stray", 1.0))), (FORCE,), "'stray', which is neither state nor input"),
        ((CARRIAGE, relation(("x_ddot", "phi_ddot", 1.0))), (FORCE,), "'phi_ddot', which is neither state nor input"),
        ((CARRIAGE, PENDULUM), (), "'u', which is neither state nor input"),
    ],
)
def test_relations_that_make_no_model_are_refused(relations, inputs, message):
    with pytest.raises(InputError, match=message):
        model(*relations, inputs=inputs)
