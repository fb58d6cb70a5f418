from itertools import product

import numpy as np
import pytest

from odescope.errors import InputError
from odescope.library.candidates import Library
from odescope.library.defaults import check_basis, default_library, default_rules, paper_basis, paper_rules
from odescope.library.parse import Scope, parse_term
from odescope.library.tape import evaluate, write_tape
from odescope.recordings.coordinate import Coordinate, Input

CART = (Coordinate("x", order=2, cyclic=True), Coordinate("phi", order=2, angle=True))
FORCE = (Input("u"),)


def scope(coordinates, inputs):
    return Scope.of([*(n for c in coordinates for n in (*c.states, c.target)), *(i.name for i in inputs)])


def default(coordinates, inputs, targets=None):
    names = scope(coordinates, inputs)
    return default_library(coordinates, inputs, targets or [c.target for c in coordinates], names), names


def products(names, *rows):
    return {parse_term("*".join(f"({f})" for f in row), names) for row in product(*rows)}


TRIGONOMETRIC = ("1", "sin(phi)", "cos(phi)", "sin(phi)*cos(phi)", "cos(phi)**2")


# the paper's


@pytest.mark.parametrize(("target", "other"), [("x_ddot", "phi_ddot"), ("phi_ddot", "x_ddot")])
def test_the_papers_counts_and_candidates(target, other):
    names = scope(CART, FORCE)
    basis = paper_basis(CART, FORCE)
    assert len(basis) == 7
    whole = Library.of(basis, names).powers(4)
    assert len(whole) == 330
    kept = whole.thin(paper_rules(CART, FORCE, target), names)
    assert len(kept) == 35
    assert sum(count for _, count in kept.removed) == 295
    motion = ("1", "x_dot", "x_dot**2", "phi_dot", "phi_dot**2", "u", target)
    assert set(kept) == products(names, motion, TRIGONOMETRIC)
    assert not any(other in t.names for t in kept)


# the defaults


def test_the_default_of_a_pendulum_on_a_cart():
    library, names = default(CART, FORCE)
    motion = ("1", "x_dot", "phi_dot", "x_dot**2", "x_dot*phi_dot", "phi_dot**2", "u", "x_ddot", "phi_ddot")
    friction = Library.of(("sign(x_dot)", "sign(phi_dot)", "x_dot*abs(x_dot)", "phi_dot*abs(phi_dot)"), names)
    assert set(library) == products(names, motion, TRIGONOMETRIC) | set(friction)
    assert len(library) == len(set(library)) == 49


@pytest.mark.parametrize("degree", [1, 2, 4])
def test_a_degree_that_is_asked_for_is_that_of_products_targets_aside(degree):
    states = (Coordinate("a", order=1), Coordinate("b", order=1))
    for coordinates, targets in ((CART, ("x_ddot", "phi_ddot")), (states, ("a_dot", "b_dot"))):
        names = scope(coordinates, FORCE)
        library = default_library(coordinates, FORCE, targets, names, degree)
        dry = ("sign", "abs")
        counted = [
            sum(p for f, p in t.factors if getattr(f, "name", None) not in targets)
            for t in library
            if not any(d in t.text for d in dry)
        ]
        assert max(counted) == degree
        assert len(library) == len(set(library))
        usual = default_library(coordinates, FORCE, targets, names)
        assert len(library) < len(usual) if degree < 3 else len(library) > len(usual)


def test_a_position_that_is_neither_angle_nor_cyclic_enters_beside_an_angle():
    coordinates = (Coordinate("x", order=2), Coordinate("phi", order=2, angle=True))
    library, names = default(coordinates, ())
    assert products(names, ("x",), TRIGONOMETRIC) <= set(library)
    assert not any(t.power_of(parse_term("phi", names).factors[0][0]) for t in library)


@pytest.mark.parametrize(
    ("coordinates", "law"),
    [
        # Michaelis-Menten: x' (.3 + x) = .6 (.3 + x) - 1.5 x
        ([Coordinate("x")], ["x_dot", "x*x_dot", "1", "x"]),
        # Lorenz
        ([Coordinate("x"), Coordinate("y"), Coordinate("z")], ["x_dot", "y_dot", "z_dot", "x", "y", "z", "x*z", "x*y"]),
        # Holling: prey a/(1 + h a) predator
        ([Coordinate("a"), Coordinate("b")], ["a_dot", "a*a_dot", "a", "a**2", "a**3", "a*b", "b", "b_dot*a", "b_dot"]),
        # van der Pol
        ([Coordinate("x", order=2)], ["x_ddot", "x_dot", "x**2*x_dot", "x"]),
    ],
)
def test_the_default_without_angles_holds_the_laws_of_the_text_books(coordinates, law):
    library, names = default(tuple(coordinates), ())
    assert {parse_term(t, names) for t in law} <= set(library)


def test_the_default_without_angles_is_monomials_with_and_without_a_target():
    coordinates, inputs = (Coordinate("x"), Coordinate("y", order=2)), (Input("u"),)
    library, names = default(coordinates, inputs, ("x_dot",))
    monomials = Library.of(("x", "y", "y_dot", "u"), names).powers(3)
    target = parse_term("x_dot", names)
    # The relation of x, which is of order 1 and may be a speed: the friction of y is not in it.
    friction = Library.of(("sign(x)", "x*abs(x)"), names)
    assert set(library) == {*monomials, *(target * m for m in monomials), *friction}
    assert len(library) == 2 * 35 + 2
    library, _ = default(coordinates, inputs, ("y_ddot",))
    friction = Library.of(("sign(y_dot)", "y_dot*abs(y_dot)", "sign(x)", "x*abs(x)"), names)  # of a wheel that y holds
    assert set(friction) == {t for t in library if "(" in t.text}


@pytest.mark.parametrize(
    ("coordinates", "target", "law"),
    [
        # a glider: V gamma' = a V^2 - g cos(gamma)
        ([Coordinate("V"), Coordinate("gamma", angle=True)], "gamma_dot", ["V*gamma_dot", "V**2", "cos(gamma)"]),
        # a satellite that holds a wheel with the speed w
        ([Coordinate("a", order=2, angle=True), Coordinate("w")], "a_ddot", ["sign(w)", "w", "w*a_dot", "w*a_ddot"]),
    ],
)
def test_what_is_of_order_1_beside_an_angle_may_be_a_speed(coordinates, target, law):
    library, names = default(tuple(coordinates), (), (target,))
    assert {parse_term(t, names) for t in law} <= set(library)
    assert len(library) == len({*library})


def test_friction_is_of_the_targets_rates_and_their_differences_with_like_ones():
    coordinates = tuple(Coordinate(name, order=2, angle=name in "bd", cyclic=True) for name in "abcd")
    library, names = default(coordinates, FORCE, ("b_ddot",))
    friction = ("sign(b_dot)", "b_dot*abs(b_dot)", "sign(b_dot - d_dot)", "(b_dot - d_dot)**1*abs(b_dot - d_dot)")
    found = {t for t in library if "sign" in t.text or "abs" in t.text}
    assert found == set(Library.of(friction, names))
    assert len(library) == len({*library})


def test_an_angle_of_order_1_is_no_speed_that_could_have_friction():
    library, _ = default((Coordinate("heading", angle=True), Coordinate("way", cyclic=True)), FORCE)
    assert not [t for t in library if "sign" in t.text or "abs" in t.text]


@pytest.mark.parametrize(("count", "degree", "monomials"), [(5, 3, 56), (6, 2, 28), (9, 2, 55), (10, 1, 11)])
def test_the_degree_falls_where_there_would_be_too_many(count, degree, monomials):
    coordinates = tuple(Coordinate(f"c{k}") for k in range(count))
    library, names = default(coordinates, (), ("c0_dot",))
    assert len(library) == 2 * monomials + 2
    friction = Library.of(("sign(c0)", "c0*abs(c0)"), names)
    assert set(friction) < set(library)
    rest = library.that(lambda term: term not in friction.terms)
    assert max(product.degree for product in rest.products(("c0_dot",))) == degree


def test_all_defaults_are_linear_in_the_targets():
    for coordinates in (CART, (Coordinate("x"), Coordinate("y")), (Coordinate("q", order=3),)):
        targets = [c.target for c in coordinates]
        library, _ = default(coordinates, FORCE)
        assert {product.factor for product in library.products(targets)} == {None, *targets}


def test_an_equation_of_third_order_has_its_derivatives_as_states():
    library, names = default((Coordinate("q", order=3),), ())
    assert {parse_term(t, names) for t in ("q", "q_dot", "q_ddot", "q_dddot", "q*q_dot*q_ddot")} <= set(library)


# a basis by hand


def test_a_basis_by_hand_is_linear_in_targets_and_free_of_the_identity():
    names = scope(CART, FORCE)
    basis = ("x_dot", "sin( phi )", "cos(phi)", "phi_ddot")
    rules = default_rules(CART, ("x_ddot", "phi_ddot"), basis, names)
    kept = Library.of(basis, names).powers(3).thin(rules, names)
    for t in kept:
        assert t.power_of(parse_term("sin(phi)", names).factors[0][0]) <= 1
        assert t.power_of(parse_term("phi_ddot", names).factors[0][0]) <= 1
    assert parse_term("cos(phi)**3", names) in set(kept)
    assert parse_term("phi_ddot*sin(phi)*cos(phi)", names) in set(kept)


def test_sine_without_cosine_keeps_its_square():
    assert len(default_rules(CART, ("x_ddot",), ("sin(phi)", "x_dot"), scope(CART, ()))) == 1


def by_hand(*basis, coordinates=CART, degree=3):
    names = scope(coordinates, FORCE)
    rules = default_rules(coordinates, ("x_ddot",), basis, names)
    return Library.of((*basis, "x_ddot"), names).powers(degree).thin(rules, names), names


@pytest.mark.parametrize("dry", ["sign(x_dot)", "sign( x_dot - phi_dot )", "tanh(x_dot/0.01)", "sign(x_dot - 0.2)"])
def test_dry_friction_stays_alone_and_costs_one_candidate(dry):
    plain, _ = by_hand("x_dot", "u", "cos(phi)")
    library, names = by_hand("x_dot", "u", "cos(phi)", dry)
    assert set(library) == {*plain, parse_term(dry, names)}
    assert "in no products but" in library.removed[-1][0]
    assert library.removed[-1][1] > 0


def test_friction_that_is_named_with_its_normal_force_stays_as_a_whole():
    whole, sized = "u*cos(phi)*sign(x_dot)", "sqrt(abs(x_dot))"
    plain, _ = by_hand("x_dot", "u")
    library, names = by_hand("x_dot", "u", whole, sized)
    # sqrt(abs(v)) is nobody's dry friction: it is multiplied as any function.
    assert {t for t in library if "sign" in t.text} == {parse_term(whole, names)}
    assert {t for t in library if "(" not in t.text} == set(plain)
    assert parse_term(f"u*{sized}", names) in set(library)
    both, _ = by_hand("u", whole, "sign(x_dot)")
    assert {t for t in both if "sign" in t.text} == {parse_term(t, names) for t in (whole, "sign(x_dot)")}


def test_the_size_of_a_rate_multiplies_that_rate_alone():
    library, names = by_hand("x_dot", "phi_dot", "u", "abs(x_dot)")
    assert {t for t in library if "abs" in t.text} == {parse_term(t, names) for t in ("abs(x_dot)", "x_dot*abs(x_dot)")}


def test_signs_of_what_is_no_rate_are_functions_as_any():
    for coordinates, sign in (
        (CART, "sign(x)"),
        (CART, "sign(x_dot*phi_dot)"),
        ((Coordinate("x_dot"),), "sign(x_dot)"),
    ):
        names = scope(coordinates, FORCE)
        rules = default_rules(coordinates, (coordinates[0].target,), (sign, "u"), names)
        assert len(rules) == 1


def test_a_library_without_a_state_is_refused():
    names = scope(CART, FORCE)
    with pytest.raises(InputError, match="no candidate term contains a state"):
        check_basis(CART, Library.of(("u", "1", "x_ddot"), names))
    check_basis(CART, Library.of(("u", "sin(phi)"), names))


def test_sums_of_angles_span_what_products_do():
    phases, names = [Coordinate(n, angle=True) for n in "abc"], "abc"
    libraries = [
        default_library(phases, FORCE, ["a_dot"], scope(phases, FORCE), sums=sums).without(["a_dot"])
        for sums in (False, True)
    ]
    rows = np.random.default_rng(0).uniform(-3.0, 3.0, (4, 200))
    columns = [evaluate(write_tape([*names, "u"], list(library)), rows) for library in libraries]
    ranks = [np.linalg.matrix_rank(c) for c in (*columns, np.concatenate(columns))]
    assert ranks == [len(libraries[0])] * 3 == [len(libraries[1])] * 3
    assert {"sin(a - b)", "u*cos(b + c)"} <= {t.text for t in libraries[1]}
    assert "sin(a - b)" not in {t.text for t in libraries[0]}


def test_the_cube_of_an_angles_velocity_is_there_where_nothing_else_moves():
    heading, surge = Coordinate("psi", order=2, angle=True, cyclic=True), Coordinate("v", order=1)
    for coordinates, there in (((heading,), True), ((heading, surge), True), (CART, False)):
        library, _ = default(coordinates, ())
        assert any(t.text.endswith("_dot**3") for t in library) is there
