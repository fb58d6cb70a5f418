"""Which equations are shown, and how mechanisms read."""

import time
from dataclasses import replace

import numpy as np
import pytest
from found_models import FORCE, cart, enzyme, model_of

from odescope.export.languages.latex import to_latex
from odescope.export.languages.mathml import to_mathml
from odescope.export.languages.text import to_text
from odescope.export.model_file import from_json, to_json
from odescope.library.lagrangian import lagrangian
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.denominators import denominator_ranges
from odescope.model.explicit import Quotient
from odescope.model.mechanism_display import mechanisms_text
from odescope.model.model import Model
from odescope.model.relation import FoundMechanism, Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate


def coupled(count, width=1):
    """Every relation holds every target, each with so many products."""
    coordinates = tuple(Coordinate(f"q{k}") for k in range(count))
    scope = Scope.of([c.name for c in coordinates])
    rows = []
    for k, c in enumerate(coordinates):
        terms = [RelationTerm(Product(c.target), 1.0)]
        terms += [
            RelationTerm(Product(o.target, parse_term(f"{c.name}**{j + 1}*sin({o.name})", scope)), 0.1 + 0.01 * k)
            for o in coordinates
            for j in range(width)
            if o is not c
        ]
        rows.append(Relation((*terms, RelationTerm(Product(None, parse_term(c.name, scope)), 1.0))))
    return Model(coordinates, (), tuple(rows))


def test_a_cart_reads_as_its_energies_and_its_mass_matrix():
    text = to_text(cart(), 6).splitlines()
    assert text[:4] == [
        "# kinetic energy T",
        "#   0.9000 +- 0.0013      x_dot**2",
        "#   0.18000 +- 0.00025    phi_dot*x_dot*cos(phi)",
        "#   0.027500 +- 0.000039  phi_dot**2",
    ]
    assert [line for line in text if not line.startswith("#")] == [
        "1.8*x_ddot + 0.18*phi_ddot*cos(phi) = 0.18*phi_dot**2*sin(phi) + u - 10.0*x_dot",
        "0.055*phi_ddot + 0.18*x_ddot*cos(phi) = -1.8*sin(phi)",
    ]
    assert text[-4:-2] == ["# forces", "#   1  u on x"]


def test_reactions_read_with_their_rates():
    assert mechanisms_text(enzyme().mechanisms) == [
        "reactions",
        "  S + E -> C  k = 0.9800 +- 0.0098, flux E*S",
        "  C -> S + E  k = 0.4000 +- 0.0040, flux C",
    ]
    assert to_text(enzyme(), 6).splitlines()[-3:] == [
        "S_dot = 0.4*C - 0.98*E*S",
        "E_dot = 0.4*C - 0.98*E*S",
        "C_dot = -0.4*C + 0.98*E*S",
    ]


def test_latex_and_mathml_begin_with_the_mechanisms():
    lines = to_latex(cart()).split(" \\\\\n")
    assert [line.split(" = ")[0] for line in lines[:4]] == ["T", "V", "R", "F_{x}"]
    assert lines[1] == r"V = -\left(1.8000 \pm 0.0025\right) \, \cos\left(\phi\right)"
    assert lines[4].startswith(r"1.8 \, \ddot{x} + 0.18 \, ")
    assert len(lines) == 6
    assert to_latex(enzyme()).startswith(r"S + E \xrightarrow{0.9800 \pm 0.0098} C")
    assert to_mathml(cart()).count("<math") == 6
    assert "<mo>±</mo>" in to_mathml(enzyme()).splitlines()[0]


def test_a_file_brings_all_of_it_back():
    for model in (cart(), enzyme()):
        assert to_text(from_json(to_json(model))) == to_text(model)


def test_what_a_hostile_file_calls_a_mechanism_stays_text():
    hostile = FoundMechanism("<b>", "kinetic", "<script>", 1.0, 0.5)
    shown = to_mathml(replace(cart(), mechanisms=(hostile, FoundMechanism("<i> -> &", "reaction", "", 1.0))))
    assert "<script" not in shown
    assert "<i>" not in shown


def test_a_lone_relation_of_mechanisms_is_in_the_scale_of_its_energy():
    arm = (Coordinate("phi", 2, angle=True),)
    scope = Scope.of(["phi", "phi_dot", "phi_ddot", "u"])
    terms = {"kinetic": ["phi_dot**2"], "potential": ["cos(phi)"], "dissipation": [], "forces": {"phi": ["u"]}}
    model = model_of(arm, FORCE, lagrangian(arm, FORCE, scope, **terms), [0.25, -4.5, 1.0], 0.0)
    assert to_text(model, 6).splitlines()[-1] == "0.5*phi_ddot = -4.5*sin(phi) + u"


def test_few_coupled_targets_are_shown_as_fractions_and_many_as_relations():
    assert all(isinstance(e, Quotient) for e in coupled(2).equations)
    assert coupled(4).equations == coupled(4).relations
    assert coupled(3, width=6).equations == coupled(3, width=6).relations
    assert to_text(coupled(4), 6).splitlines()[0].startswith("q0_dot + 0.1*q1_dot*q0*sin(q1) + ")


@pytest.mark.parametrize(("count", "width"), [(5, 8), (9, 2)])
def test_long_fractions_are_not_even_computed(count, width):
    model = coupled(count, width)
    begin = time.perf_counter()
    text = to_json(model)
    assert to_text(model).count("\n") == count - 1
    assert to_latex(model).count(r"\dot") >= count**2
    assert time.perf_counter() - begin < 2.0
    assert '"explicit": {}' in text
    assert from_json(text).relations == model.relations


def test_denominators_of_many_coupled_targets_are_determinants():
    model = coupled(7)
    columns = np.random.default_rng(3).uniform(0.2, 0.9, (7, 50))
    ranges = denominator_ranges(model, columns, np.random.default_rng(0))
    exact = []
    for q in columns.T:
        matrix = np.array(
            [[1.0 if i == j else (0.1 + 0.01 * i) * q[i] * np.sin(q[j]) for j in range(7)] for i in range(7)]
        )
        exact.append(np.linalg.det(matrix))
    assert ranges["q3_dot"]["data"] == pytest.approx([min(exact), max(exact)], rel=1e-12)


def test_relations_that_say_the_same_but_for_rounding_have_the_denominator_zero():
    pair = (Coordinate("a"), Coordinate("b"))
    terms = [(0.1, 0.7), (0.1 * 0.3, 0.7 * 0.3)]
    rows = [
        Relation(tuple(RelationTerm(Product(c.target), v) for c, v in zip(pair, row, strict=True))) for row in terms
    ]
    ranges = denominator_ranges(Model(pair, (), tuple(rows)), np.ones((2, 3)), np.random.default_rng(0))
    assert ranges["a_dot"]["data"] == [0.0, 0.0]
    shown = Model(pair, (), tuple(rows))
    assert shown.equations == shown.relations
