import pytest
from found_models import cart, enzyme

from odescope.commands.demo import cart_pendulum
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.model import Model
from odescope.model.quantity_units import quantity_units, shown
from odescope.model.relation import Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate, Input
from odescope.report.units import coefficient_units, mechanism_units


def test_the_pendulum_on_a_cart():
    model = cart_pendulum()
    units = quantity_units(model)
    assert shown(units["phi_ddot"]) == "rad s⁻²"
    cart = dict(
        zip([t.text for t in model.relations[0].terms], coefficient_units(model.relations[0], units), strict=True)
    )
    assert cart["u"] == "m N⁻¹ s⁻²"
    assert cart["x_dot"] == "s⁻¹"
    assert cart["x_ddot*cos(phi)**2"] == "1"
    assert cart["phi_dot**2*sin(phi)"] == "m rad⁻²"


def test_mechanisms_are_in_the_unit_of_the_work_of_the_force():
    assert list(mechanism_units(cart()).values()) == [
        "N s² m⁻¹", "N s² rad⁻¹", "N m s² rad⁻²", "N m", "N s m⁻¹", "1"
    ]  # fmt: skip
    assert list(mechanism_units(enzyme()).values()) == ["mol⁻¹ s⁻¹", "s⁻¹"]


def unit(term, own="m", driver="N m"):
    scope = Scope.of(["x", "x_dot", "u"])
    relation = Relation(
        (RelationTerm(Product("x_ddot"), 1.0), RelationTerm(Product(None, parse_term(term, scope)), 2.0))
    )
    model = Model((Coordinate("x", 2, unit=own),), (Input("u", unit=driver),), (relation,))
    return coefficient_units(relation, quantity_units(model))[1]


@pytest.mark.parametrize(
    ("term", "expected"),
    [
        ("1", "m s⁻²"),
        ("u", "m (N m)⁻¹ s⁻²"),
        ("abs(x_dot)*x_dot", "m⁻¹"),
        ("sqrt(x)", "m^(1/2) s⁻²"),
        ("tanh(3.0*x_dot)", "m s⁻²"),
        ("(x - 3.0)**1", "s⁻²"),
        ("(x + u)**1", ""),
    ],
)
def test_terms(term, expected):
    assert unit(term) == expected


def test_a_unit_that_is_not_stated_is_not_guessed():
    assert unit("u", driver=None) == ""
    assert unit("x", own=None) == ""
    assert unit("u", driver="1") == "m s⁻²"
