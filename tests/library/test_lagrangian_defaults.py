from itertools import combinations

import numpy as np
import pytest
from mechanics import ARMS, CART, ELASTIC, FORCE, arms, names_of, positions, scope_of, values_of

from odescope.library.candidates import Library
from odescope.library.expansion import expanded
from odescope.library.expression import Combination
from odescope.library.friction import default_friction
from odescope.library.lagrangian import lagrangian
from odescope.library.lagrangian_defaults import default_dissipation, default_energies, default_forces
from odescope.library.parse import parse_term
from odescope.library.tape import evaluate, write_tape
from odescope.recordings.coordinate import Coordinate

CONFIGURATIONS = ("1", "cos(phi)", "sin(phi)", "cos(2*phi)", "sin(2*phi)")

MASSES = (Coordinate("p", 2), Coordinate("q", 2))  # on one line


def sizes(coordinates):
    return tuple(len(terms) for terms in default_energies(coordinates))


def test_the_default_of_a_pendulum_on_a_cart():
    kinetic, potential = default_energies(CART)
    rates = ("x_dot*x_dot", "x_dot*phi_dot", "phi_dot*phi_dot")
    assert set(kinetic) == {r if h == "1" else f"{r}*{h}" for r in rates for h in CONFIGURATIONS}
    assert potential == (*CONFIGURATIONS[1:], "phi**2")
    assert default_dissipation(CART) == (
        "x_dot**2", "phi_dot**2", "abs(x_dot)", "abs(phi_dot)", "abs(x_dot)**3", "abs(phi_dot)**3",
    )  # fmt: skip
    assert default_forces(CART, FORCE) == {"x": ("u", "1"), "phi": ("u", "1")}
    assert len(lagrangian(CART, FORCE, scope_of(CART, FORCE))) == 30


def test_beside_inputs_stand_a_constant_where_the_potential_has_none_and_in_a_plane_what_turns():
    plain, angle, level = Coordinate("a", 2), Coordinate("b", 2, angle=True), Coordinate("c", 2, cyclic=True)
    forces = default_forces((plain, angle, level), FORCE)
    turning = ("u*cos(b)", "u*sin(b)")  # of a body in the plane of a and c
    assert forces == {"a": ("u", *turning), "b": ("u", "1"), "c": ("u", "1", *turning)}
    assert default_forces((plain, angle, level), ()) == {"a": (), "b": (), "c": ()}
    assert "a" in default_energies((plain, angle, level))[1]


def test_the_default_of_two_arms():
    kinetic, potential = default_energies(ARMS)
    harmonics = ("phi1", "phi2", "2*phi1", "phi1 + phi2", "phi1 - phi2", "2*phi2")
    springs = ("phi1**2", "phi2**2", "(phi1 - phi2)**2")
    assert potential == (*(f"{f}({h})" for h in harmonics for f in ("cos", "sin")), *springs)
    assert set(kinetic) >= {"phi1_dot*phi2_dot*cos(phi1 - phi2)", "phi1_dot*phi1_dot*cos(phi2)"}
    assert len(kinetic) == 3 * 13
    assert {"(phi1_dot - phi2_dot)**2", "abs(phi1_dot - phi2_dot)"} <= set(default_dissipation(ARMS))
    assert len(lagrangian(ARMS, (), scope_of(ARMS))) == 63


def test_positions_enter_by_powers_beside_harmonics():
    kinetic, potential = default_energies(ELASTIC)
    assert {"r_dot*r_dot", "phi_dot*phi_dot*r**2", "r_dot*phi_dot*r*sin(phi)"} <= set(kinetic)
    assert set(potential) == {
        "cos(phi)", "sin(phi)", "cos(2*phi)", "sin(2*phi)", "r*cos(phi)", "r*sin(phi)", "r", "r**2", "r**3", "r**4",
        "phi**2",
    }  # fmt: skip
    _, potential = default_energies(MASSES)
    assert {"p", "(p - q)**2", "p**2*q**2", "(p - q)**4", "p*q**3", "q**4"} <= set(potential)
    assert len(potential) == 14


def test_springs_between_positions_span_what_their_products_do():
    """Of positions in different units differences say nothing."""
    _, potential = default_energies(MASSES)
    apart = [Coordinate(c.name, 2, unit=unit) for c, unit in zip(MASSES, ("m", "C"), strict=True)]
    _, products = default_energies(apart)
    assert {"p*q", "p**3*q"} == set(products) - set(potential)
    terms = [[parse_term(text, scope_of(MASSES)) for text in texts] for texts in (potential, products)]
    columns = [evaluate(write_tape(names_of(MASSES), own), values_of(MASSES)).T for own in terms]
    ranks = [np.linalg.matrix_rank(c) for c in (*columns, np.hstack(columns))]
    assert ranks == [14, 14, 14]


@pytest.mark.parametrize("flags", [(False, False), (True, True), (False, True)])
def test_where_all_are_cyclic_there_is_no_potential(flags):
    coordinates = [Coordinate(name, 2, angle=a, cyclic=True) for name, a in zip("ab", flags, strict=True)]
    assert default_energies(coordinates) == (("a_dot*a_dot", "a_dot*b_dot", "b_dot*b_dot"), ())


def test_friction_is_that_of_the_default_relations():
    coordinates = (*CART, Coordinate("psi", 2, angle=True), Coordinate("a", 2))
    scope = scope_of(coordinates)
    slopes = {
        t
        for m in lagrangian(coordinates, (), scope)
        if m.kind == "dissipation"
        for t in (part.product.term for part in m.parts)
    }
    named = Library.of(default_friction(coordinates, [c.target for c in coordinates]), scope)
    # Derivatives of squares, sizes and cubed sizes; differences, multiplied out, in the relation of each.
    products = {e for t in named for _, e in expanded(Combination.of([(1.0, t)])).parts}
    assert products | {parse_term(c.derivative(1), scope) for c in coordinates} == slopes


def test_differences_are_of_coordinates_of_like_kind():
    coordinates = (*CART, Coordinate("psi", 2, angle=True), Coordinate("a", 2))
    relative = {t for t in default_dissipation(coordinates) if " - " in t}
    kinds = ("({})**2", "abs({})", "abs({})**3")
    assert relative == {f.format(d) for f in kinds for d in ("a_dot - x_dot", "phi_dot - psi_dot")}


def test_rates_in_different_units_have_no_difference():
    metres, millimetres, unknown = (
        Coordinate(name, 2, unit=u) for name, u in zip("xyz", ("m", "mm", None), strict=True)
    )
    assert not [t for t in default_dissipation((metres, millimetres)) if " - " in t]
    assert not [t for t in default_friction((metres, millimetres), ["x_ddot", "y_ddot"]) if " - " in t]
    assert [t for t in default_dissipation((metres, unknown)) if " - " in t]


def test_what_is_written_is_what_a_term_says_but_for_numbers():
    coordinates = (Coordinate("psi", 2, angle=True), Coordinate("b", 2), Coordinate("alpha", 2, angle=True))
    kinetic, potential = default_energies(coordinates)
    for text in (*potential, *default_dissipation(coordinates)):
        term = parse_term(text, scope_of(coordinates))
        assert term.text.replace("2.0*", "2*") == text
    assert len({parse_term(k, scope_of(coordinates)) for k in kinetic}) == len(kinetic)


def test_of_what_looks_alike_the_likelier_costs_less():
    sizes_of = lambda c: {m.term: m.size for m in lagrangian(c, (), scope_of(c)) if m.kind == "potential"}  # noqa: E731
    arms_, masses = sizes_of(ARMS), sizes_of(MASSES)
    assert arms_["cos(phi1)"] < arms_["phi1**2"]
    assert arms_["(phi1 - phi2)**2"] < arms_["cos(phi1 - phi2)"]
    assert arms_["(phi1 - phi2)**2"] == masses["(p - q)**2"]
    (gas,) = (m for m in lagrangian(MASSES, (), scope_of(MASSES), potential=["exp(p - q)"]) if m.kind == "potential")
    assert gas.size == 1.0


@pytest.mark.parametrize(
    ("coordinates", "kinetic", "potential"),
    [
        (positions(4), 156, 69),  # everything
        (positions(5), 85, 125),  # from here on only with functions of one's own
        (positions(6), 123, 83),  # to degree 3 in the potential
        (positions(7), 168, 35),  # 2
        (positions(12), 78, 90),  # constant masses
        (arms(3), 150, 30),
        (arms(4), 98, 50),
        (arms(6), 93, 105),
    ],
)
def test_degrees_fall_where_there_would_be_too_many(coordinates, kinetic, potential):
    assert sizes(coordinates) == (kinetic, potential)
    assert kinetic + potential <= 250


def test_four_arms_keep_the_differences_of_the_two_that_move():
    kinetic, _ = default_energies(arms(4))
    for a, b in combinations(range(4), 2):
        assert f"phi{a}_dot*phi{b}_dot*cos(phi{a} - phi{b})" in kinetic
    assert "phi0_dot*phi1_dot*cos(phi2)" not in kinetic


def test_very_many_coordinates_keep_masses_and_forces_that_do_not_change():
    assert sizes(positions(30)) == (30 * 31 // 2, 30)
