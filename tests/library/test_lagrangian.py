import numpy as np
import pytest
from hypothesis import given
from lagrange_oracle import euler_lagrange, friction
from mechanics import ARMS, CART, ELASTIC, FORCE, MASSES, coordinate_sets, names_of, positions, scope_of, values_of
from term_oracle import repeatable

from odescope.errors import InputError
from odescope.library.expression import Combination
from odescope.library.lagrangian import lagrangian
from odescope.library.mechanism import Part
from odescope.library.parse import Definition, Scope, parse_term
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.recordings.coordinate import Coordinate


def mechanisms_of(coordinates, inputs=(), **by_hand):
    return lagrangian(coordinates, inputs, scope_of(coordinates, inputs), **by_hand)


def only(coordinates, inputs=(), **by_hand):
    """The mechanisms by hand, beside the kinetic energy without which there are none."""
    nothing = {"potential": (), "dissipation": (), "forces": {}}
    bare = {"kinetic": [f"{c.derivative(1)}**2" for c in coordinates]}
    found = mechanisms_of(coordinates, inputs, **(nothing | bare | by_hand))
    return found if "kinetic" in by_hand else found[len(coordinates) :]


def added(mechanisms, weights, coordinates, columns, inputs=()):
    """What the mechanisms add to every relation, (relations, points)."""
    weighted = list(zip(mechanisms, weights, strict=True))
    sums = [
        Combination.of((w * p.share, p.product.expanded) for m, w in weighted for p in m.parts if p.relation == r)
        for r in range(len(coordinates))
    ]
    return evaluate(write_tape(names_of(coordinates, inputs), sums), columns)


def shares(mechanism):
    return {(p.relation, p.product.text): p.share for p in mechanism.parts}


# Lagrange's equations, against sympy

# What the coordinates are, and a law with numbers: kinetic, potential.
LAWS = {
    "a pendulum on a cart": (
        CART,
        [(0.8, "x_dot**2"), (0.3, "x_dot*phi_dot*cos(phi)"), (0.11, "phi_dot**2")],
        [(2.9, "cos(phi)")],
    ),
    "two arms": (
        ARMS,
        [(0.5, "phi1_dot**2"), (0.2, "phi2_dot**2"), (0.31, "phi1_dot*phi2_dot*cos(phi1 - phi2)")],
        [(-7.1, "cos(phi1)"), (-3.3, "cos(phi2)")],
    ),
    "an elastic pendulum": (
        ELASTIC,
        [(0.5, "r_dot**2"), (0.5, "r**2*phi_dot**2")],
        [(-9.81, "r*cos(phi)"), (40.0, "(r - 1.25)**2")],
    ),
    "brackets, gyroscopic terms and other powers": (
        MASSES,
        [(0.7, "(x_dot - 0.5*y_dot*cos(x))**2"), (0.4, "y_dot**2"), (1.3, "x*y_dot"), (0.1, "x_dot**4*exp(-y)")],
        [(0.6, "(x - y)**4"), (0.2, "(x - y)**2"), (0.2, "x**3*y")],
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_has_the_equations_that_sympy_derives(name):
    coordinates, kinetic, potential = LAWS[name]
    columns = values_of(coordinates)
    mechanisms = only(coordinates, kinetic=[t for _, t in kinetic], potential=[t for _, t in potential])
    found = added(mechanisms, [w for w, _ in (*kinetic, *potential)], coordinates, columns)
    np.testing.assert_allclose(found, euler_lagrange(coordinates, kinetic, potential, columns), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("coordinates", [CART, ARMS, ELASTIC], ids=["cart", "arms", "elastic"])
def test_the_defaults_have_the_equations_that_sympy_derives(coordinates):
    mechanisms = mechanisms_of(coordinates)
    weights, columns = np.random.default_rng(1).normal(size=len(mechanisms)), values_of(coordinates)
    weighted = list(zip(weights, mechanisms, strict=True))
    kinetic, potential, dissipation = (
        [(w, m.term) for w, m in weighted if m.kind == kind] for kind in ("kinetic", "potential", "dissipation")
    )
    expected = euler_lagrange(coordinates, kinetic, potential, columns) + friction(coordinates, dissipation, columns)
    np.testing.assert_allclose(added(mechanisms, weights, coordinates, columns), expected, rtol=1e-9, atol=1e-11)


@repeatable
@given(coordinate_sets())
def test_the_power_into_an_energy_is_its_change(coordinates):
    mechanisms = [m for m in mechanisms_of(coordinates) if m.kind in ("kinetic", "potential")]
    names, columns, step = names_of(coordinates), values_of(coordinates), 1e-5
    q, v, a = np.split(columns, 3)

    tape = write_tape(names, [parse_term(m.term, scope_of(coordinates)) for m in mechanisms])

    def energies(t):
        # What is odd in the rates, as a rotor's part is, does no work.
        here, rates = q + v * t + a * t**2 / 2, v + a * t
        return sum(evaluate(tape, np.concatenate([here, sign * rates, a])) for sign in (1.0, -1.0)) / 2.0

    change = (energies(step) - energies(-step)) / (2.0 * step)
    power = [np.sum(v * added([m], [1.0], coordinates, columns), axis=0) for m in mechanisms]
    np.testing.assert_allclose(power, change, rtol=1e-6, atol=1e-6)


@repeatable
@given(coordinate_sets())
def test_parts_are_plain(coordinates):
    targets = {c.target for c in coordinates}
    cyclic = {c.name for c in coordinates if c.cyclic}
    for m in mechanisms_of(coordinates, FORCE):
        keys = [(p.relation, p.product) for p in m.parts]
        assert keys
        assert len(set(keys)) == len(keys)
        for p in m.parts:
            assert p.share != 0.0
            assert p.product.factor in {None, *targets}
            assert not p.product.term.names & (targets | cyclic)
        assert not parse_term(m.term, scope_of(coordinates, FORCE)).names & cyclic


# what is written


def test_kinds_places_and_texts():
    mechanisms = mechanisms_of(
        CART,
        FORCE,
        kinetic=["cos(phi) * phi_dot*x_dot", "x_dot**2", "phi_dot**2", "x_dot*x_dot"],
        potential=["cos(phi)"],
        dissipation=["abs(x_dot)"],
        forces={"phi": ["u*cos(phi)"], "x": ["u", "1"]},
    )
    assert [(m.kind, m.place, m.term) for m in mechanisms] == [
        ("kinetic", "kinetic", "phi_dot*x_dot*cos(phi)"),
        ("kinetic", "kinetic", "x_dot**2"),
        ("kinetic", "kinetic", "phi_dot**2"),
        ("potential", "potential", "cos(phi)"),
        ("dissipation", "dissipation", "abs(x_dot)"),
        ("force", "force on phi", "u*cos(phi)"),
        ("force", "force on x", "u"),
        ("force", "force on x", "1"),
    ]
    assert shares(mechanisms[0]) == {
        (0, "phi_ddot*cos(phi)"): 1.0,
        (0, "phi_dot**2*sin(phi)"): -1.0,
        (1, "x_ddot*cos(phi)"): 1.0,
    }
    assert [shares(m) for m in mechanisms[5:]] == [{(1, "u*cos(phi)"): -1.0}, {(0, "u"): -1.0}, {(0, "1"): -1.0}]


@pytest.mark.parametrize(
    ("term", "expected"),
    [
        ("phi1_dot**2", {(0, "phi1_dot"): 2.0}),
        (
            "(phi1_dot - phi2_dot)**2",
            {(0, "phi1_dot"): 2.0, (0, "phi2_dot"): -2.0, (1, "phi1_dot"): -2.0, (1, "phi2_dot"): 2.0},
        ),
        ("abs(phi2_dot)", {(1, "sign(phi2_dot)"): 1.0}),
        (
            "abs(phi1_dot - phi2_dot)",
            {(0, "sign(phi1_dot - phi2_dot)"): 1.0, (1, "sign(phi1_dot - phi2_dot)"): -1.0},
        ),
        ("abs(phi1_dot)**3", {(0, "phi1_dot*abs(phi1_dot)"): 3.0}),
        ("abs(phi1_dot)**2", {(0, "phi1_dot"): 2.0}),
        ("abs(2*phi1_dot)**3", {(0, "phi1_dot*abs(2.0*phi1_dot)"): 12.0}),
        (
            "abs(phi1_dot - phi2_dot)**3",
            {
                (0, "phi1_dot*abs(phi1_dot - phi2_dot)"): 3.0,
                (0, "phi2_dot*abs(phi1_dot - phi2_dot)"): -3.0,
                (1, "phi1_dot*abs(phi1_dot - phi2_dot)"): -3.0,
                (1, "phi2_dot*abs(phi1_dot - phi2_dot)"): 3.0,
            },
        ),
    ],
)
def test_dissipation_is_written_in_plain_rates(term, expected):
    (mechanism,) = only(ARMS, dissipation=[term])
    assert shares(mechanism) == expected


def test_a_bracket_of_positions_is_multiplied_out_only_where_it_is_linear():
    square, fourth = only(MASSES, potential=["(x - y)**2", "(x - 3)**4"])
    assert shares(square) == {(0, "x"): 2.0, (0, "y"): -2.0, (1, "x"): -2.0, (1, "y"): 2.0}
    assert shares(fourth) == {(0, "(-3.0 + x)**3"): 4.0}


def test_functions_of_ones_own_may_be_used():
    scope = Scope.of(names_of(CART), [Definition("height", ("angle",), "cos(angle)")])
    mechanisms = lagrangian(CART, (), scope, potential=["height(phi)"], dissipation=(), forces={})
    assert mechanisms[-1].term == "cos(phi)"
    assert mechanisms[-1].parts == (Part(1, Product(None, parse_term("sin(phi)", scope)), -1.0),)


SIZES = {
    "kinetic": {
        "x_dot**2": 0, "x_dot*phi_dot": 0, "x_dot*phi_dot*cos(phi)": 1, "x_dot**2*cos(2*phi)": 2, "r**2*phi_dot**2": 2,
        "r*phi_dot": 0, "phi_dot**2*cos(phi - psi)": 1, "phi_dot**2*cos(2*phi - psi)": 2,
    },
    "potential": {
        "cos(phi)": 1, "cos(2*phi)": 2, "cos(phi + psi)": 1, "r**2": 2, "r*cos(phi)": 2, "exp(r)": 1, "r**-1": 1,
        "cos(0.5*phi)": 1, "sin(2*r)": 1, "cos(phi)**2": 2,
    },
    "dissipation": {"x_dot**2": 1, "abs(x_dot)": 0, "abs(x_dot)**3": 2, "(x_dot - r_dot)**2": 2},
}  # fmt: skip


@pytest.mark.parametrize(("kind", "term"), [(kind, term) for kind, terms in SIZES.items() for term in terms])
def test_how_elaborate_a_term_is(kind, term):
    coordinates = (*CART, Coordinate("psi", 2, angle=True), Coordinate("r", 2))
    first = [f"{c.derivative(1)}**2" for c in coordinates] if kind == "kinetic" else []
    mechanism = only(coordinates, **{kind: [*first, term]})[-1 if term != "x_dot**2" else 0]
    assert mechanism.size == SIZES[kind][term]


def test_a_force_is_as_elaborate_as_its_powers():
    assert [m.size for m in only(CART, FORCE, forces={"x": ["1", "u", "u*cos(phi)", "u*x_dot**2"]})] == [0, 1, 2, 3]


# what is refused

MOVING = ["x_dot**2", "phi_dot**2"]


@pytest.mark.parametrize(
    ("by_hand", "why"),
    [
        ({"potential": ["x_ddot*cos(phi)"]}, r"potential term x_ddot\*cos\(phi\) holds the acceleration x_ddot"),
        ({"kinetic": ["phi_dot*x_ddot"]}, "kinetic term phi_dot.x_ddot holds the acceleration x_ddot"),
        ({"dissipation": ["abs(x_dot - x_ddot)"]}, "dissipation term .* holds the acceleration x_ddot"),
        ({"forces": {"x": ["u", "u*phi_ddot"]}}, "force on x holds the acceleration phi_ddot"),
        ({"kinetic": ["u*x_dot**2"]}, r"kinetic term u\*x_dot\*\*2 holds the input u: .* forces"),
        ({"potential": ["u*cos(phi)"]}, "potential term .* holds the input u: .* forces"),
        ({"dissipation": ["u*abs(x_dot)"]}, "dissipation term .* holds the input u: .* forces"),
        ({"kinetic": ["cos(phi)"]}, r"kinetic term cos\(phi\) holds no velocity: .*phi_dot, x_dot.*potential"),
        ({"potential": ["cos(phi)*x_dot"]}, "potential term .* holds the velocity x_dot"),
        ({"dissipation": ["cos(phi)"]}, "dissipation term .* holds no velocity"),
        ({"potential": ["x**2"]}, r"potential term x\*\*2 holds the coordinate x itself.*cyclic"),
        ({"kinetic": ["x_dot**2*exp(-x)"]}, "kinetic term .* holds the coordinate x itself.*cyclic"),
        ({"dissipation": ["x_dot**2*abs(x)"]}, "dissipation term .* holds the coordinate x itself.*cyclic"),
        ({"forces": {"phi": ["u*x"]}}, "force on phi holds the coordinate x itself.*cyclic"),
        ({"forces": {"phj": ["u"]}}, r"no coordinate 'phj' .*did you mean 'phi'\?"),
        ({"forces": {"weight": ["u"]}}, "no coordinate 'weight' .*there are: x, phi"),
        ({"potential": ["1"]}, "potential term 1 adds nothing to any equation"),
        ({"kinetic": [*MOVING, "phi_dot"]}, "kinetic term phi_dot adds nothing"),
        ({"kinetic": [*MOVING, "phi_dot*cos(phi)"]}, "kinetic term .* adds nothing"),
        ({"dissipation": ["sign(x_dot)"]}, "dissipation term .* adds nothing"),
        ({"kinetic": ["x_dot**2"]}, r"no kinetic term gives the equation of phi an acceleration: .*phi_dot\*\*2"),
        ({"kinetic": ["x_dot*cos(phi)", "phi_dot**2"]}, "equation of x an acceleration"),
        ({"potential": ["cos(fi)"]}, "no state or input is called 'fi'"),
        ({"potential": ["cos(phi) + sin(phi)"]}, "cannot read the term"),
    ],
)
def test_terms_that_cannot_be_what_they_are_said_to_be(by_hand, why):
    with pytest.raises(InputError, match=why):
        mechanisms_of(CART, FORCE, **by_hand)


@pytest.mark.parametrize("order", [1, 3])
def test_all_coordinates_are_of_second_order(order):
    coordinates = (Coordinate("x", 2), Coordinate("temperature", order))
    with pytest.raises(InputError, match=rf"'temperature' has order {order}: set its order to 2"):
        mechanisms_of(coordinates)


def test_brackets_that_would_grow_without_bound_are_refused():
    coordinates = positions(6)
    sums = [" + ".join(f"{k + n}*{c.derivative(1)}" for k, c in enumerate(coordinates)) for n in range(1, 6)]
    (few,) = only(coordinates, dissipation=["*".join(f"identity({s})" for s in sums[:3])])
    assert len({p.product for p in few.parts}) == 21
    with pytest.raises(InputError, match=r"is too long: .* more than 1000 products; name its products one by one"):
        only(coordinates, dissipation=["*".join(f"identity({s})" for s in sums)])
