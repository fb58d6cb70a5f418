"""Positions that are components of one: by their names, and what depends on their speed and distance."""

import pytest
from mechanics import scope_of

from odescope.library.candidates import Library
from odescope.library.defaults import default_library
from odescope.library.expansion import expanded
from odescope.library.expression import Combination
from odescope.library.lagrangian import lagrangian
from odescope.library.parse import Scope, parse_term
from odescope.library.spatial import (
    components,
    from_origin,
    in_space,
    spatial_dissipation,
    spatial_forces,
    spatial_potentials,
    together,
)
from odescope.recordings.coordinate import Coordinate

PLANE = (Coordinate("x", 2), Coordinate("y", 2))
SPACE = (*PLANE, Coordinate("z", 2))


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ("x y", [("x", "y")]),
        ("z x y", [("x", "y", "z")]),
        ("ball_y phi ball_x", [("ball_x", "ball_y")]),
        ("x1 y1 x2 y2", [("x1", "y1"), ("x2", "y2")]),
        ("X Z", [("X", "Z")]),
        ("x phi", []),
        ("x1 x2", []),
        ("a b", []),
        ("x", []),
    ],
)
def test_components_are_told_by_their_names(names, found):
    assert list(components(names.split())) == found


def test_only_positions_in_what_may_be_one_unit_are_components():
    x = Coordinate("x", 2, unit="m")
    assert in_space((x, Coordinate("y", 2)))
    assert not in_space((x, Coordinate("y", 2, unit="K")))
    assert not in_space((x, Coordinate("y", 1)))
    assert not in_space((x, Coordinate("y", 2, angle=True)))


def test_what_only_moves_on_has_the_drag_of_its_speed_and_no_distance():
    x, y = (Coordinate(name, 2, cyclic=True) for name in "xy")
    assert spatial_forces((x, y), [x.target]) == ("x_dot*sqrt(x_dot**2 + y_dot**2)",)
    assert spatial_potentials((x, y)) == ()
    assert spatial_potentials((x, Coordinate("y", 2))) == ()
    assert spatial_dissipation((x, y)) == spatial_dissipation(PLANE)
    assert together((x, y), 0) == {}
    still = tuple(Coordinate(name, 1, cyclic=True) for name in ("vx", "vy"))
    assert spatial_forces(still, [still[0].target]) == ()
    assert together((x, y), 1) == together(PLANE, 1)


@pytest.mark.parametrize("coordinates", [PLANE, SPACE], ids=["plane", "space"])
def test_lagranges_equations_hold_what_the_relations_do(coordinates):
    """Derivatives of the energies and of the dissipation function are the forces, in the relation of each component."""
    scope = scope_of(coordinates)
    parts = {
        (p.relation, p.product.term)
        for m in lagrangian(coordinates, (), scope)
        for p in m.parts
        if m.kind in ("potential", "dissipation")
    }
    for r, c in enumerate(coordinates):
        forces = Library.of(spatial_forces(coordinates, [c.target]), scope)
        assert len(forces) == 3
        assert set(forces) <= set(default_library(coordinates, (), [c.target], scope))
        for force in forces:
            for _, term in expanded(Combination.of([(1.0, force)])).parts:
                assert (r, term) in parts


def test_what_goes_by_the_distance_from_the_origin_is_known():
    scope = Scope.of(["x", "y", "x_dot", "y_dot"])
    assert from_origin(parse_term("x/sqrt(x**2 + y**2)**3", scope)) == {"x", "y"}
    assert from_origin(parse_term("x_dot*sqrt(x_dot**2 + y_dot**2)", scope)) == {"x_dot", "y_dot"}
    assert from_origin(parse_term("x**2*y", scope)) == frozenset()
