"""The table of coefficients, and what shows it: text, a prompt, a notebook."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from built_models import build
from found_models import cart, enzyme

import odescope
from odescope.export.languages.text import to_text
from odescope.export.model_file import from_json, to_json
from odescope.model.model import Model
from odescope.model.relation import FoundParameter, Relation
from odescope.model.scores import DelayScore, ModelScores, OffsetScore
from odescope.recordings.coordinate import Coordinate, Input

X, U = Coordinate("x", order=2), Input("u")


def with_errors(model, errors):
    """Standard errors of the terms of relations, in their order."""
    relations = [
        Relation(tuple(replace(t, std_error=e) for t, e in zip(r.terms, row, strict=True)))
        for r, row in zip(model.relations, errors, strict=True)
    ]
    return replace(model, relations=tuple(relations))


PLAIN = with_errors(
    build([X], [U], [("x_ddot", "1", 1.0), (None, "x", 4.0), (None, "x_dot", -0.3), (None, "u", -1.5)]),
    [[None, 0.02, 0.1, 0.0]],
)
RATIONAL = build([X], [U], [("x_ddot", "1", 1.0), ("x_ddot", "x**2", 0.25), (None, "u", -1.5)])


def test_a_term_has_the_sign_of_the_explicit_equation():
    """Checked on the values of the equation itself: the targets from the relations, and from the rows."""
    table = pd.DataFrame(PLAIN.coefficients)
    assert list(table.columns) == ["equation", "term", "coefficient", "std_error", "lower", "upper", "z", "kind"]
    assert dict(zip(table.term, table.coefficient, strict=True)) == {"x": -4.0, "x_dot": 0.3, "u": 1.5}
    state = {"x": 0.7, "x_dot": -0.2, "u": 0.4}
    (acceleration,) = (
        np.dot([c for c, _ in q.numerator.parts], [state[t.text] for _, t in q.numerator.parts])
        for q in PLAIN.quotients
    )
    assert sum(row.coefficient * state[row.term] for row in PLAIN.coefficients) == pytest.approx(acceleration)


def test_intervals_and_z_are_those_of_a_normal():
    x, x_dot, u = PLAIN.coefficients
    assert (x.lower, x.upper) == pytest.approx((-4.0 - 1.96 * 0.02, -4.0 + 1.96 * 0.02), abs=1e-5)
    assert (x.z, x_dot.z) == pytest.approx((-200.0, 3.0))
    assert (u.std_error, u.z) == (0.0, None)  # an error of 0 makes no z
    bare = RATIONAL.coefficients[0]
    assert (bare.std_error, bare.lower, bare.upper, bare.z) == (None,) * 4


def test_terms_with_the_target_are_on_the_left_of_an_implicit_equation():
    rows = [(r.equation, r.term, r.coefficient) for r in RATIONAL.coefficients]
    assert rows == [("x_ddot", "x_ddot", 1.0), ("x_ddot", "x_ddot*x**2", 0.25), ("x_ddot", "u", 1.5)]


MAGNET = with_errors(
    build(
        [Coordinate("z", order=2)],
        [Input("i")],
        [("z_ddot", "z**2", 1.0), (None, "i**2", 2e-4), (None, "z**2", -9.81)],
    ),
    [[None, 1e-6, 0.01]],
)


def test_a_product_of_the_target_is_divided_out_as_people_write_it():
    """z**2 z_ddot = 9.81 z**2 - 2e-4 i**2; what model.json holds stays as it is."""
    assert to_text(MAGNET).splitlines() == [
        "z_ddot = -0.0002*i**2/z**2 + 9.81",
        "# z_ddot  i**2/z**2  -0.0002000 +- 0.0000010",
        "# z_ddot  1          9.810 +- 0.010",
    ]
    assert [t.text for r in from_json(to_json(MAGNET)).relations for t in r.terms] == ["z_ddot*z**2", "i**2", "z**2"]
    state = {"z": 0.4, "i": 70.0}
    (quotient,) = MAGNET.quotients
    fraction = eval(quotient.text, {}, state)  # noqa: S307
    assert eval(MAGNET.equations[0].text, {}, state) == pytest.approx(fraction)  # noqa: S307
    assert fraction == pytest.approx(9.81 - 2e-4 * 70.0**2 / 0.4**2)


@pytest.mark.parametrize(
    ("model", "kinds"), [(cart, ["kinetic", "potential", "dissipation", "force"]), (enzyme, ["reaction"])]
)
def test_mechanisms_come_first_and_terms_after_them(model, kinds):
    found = model()
    table = pd.DataFrame(found.coefficients)
    assert list(dict.fromkeys(table.kind)) == [*kinds, "term"]
    own = table[table.kind != "term"]
    assert list(own.term) == [m.name for m in found.mechanisms]
    assert list(own.coefficient) == [m.coefficient for m in found.mechanisms]
    assert own.equation.isna().all()


def test_constants_offsets_and_delays_have_rows():
    model = build(
        [Coordinate("phi", 2, True, offset=0.1)],
        [Input("u", delay=0.02)],
        [("phi_ddot", "1", 1.0), (None, "tanh(phi_dot/0.05)", 3.0), (None, "u", -1.0)],
    )
    scores = ModelScores(delays={"u": DelayScore(0.02, 1e-4)}, offsets={"phi": OffsetScore(0.1, 1e-3)})
    width = FoundParameter("v0", 0.05, 0.002, ("tanh(phi_dot/0.05)",), ("tanh(phi_dot/v0)",))
    model = replace(model, scores=scores, parameters=(width,))
    for m in (model, from_json(to_json(model))):
        rows = {(r.kind, r.term): (r.coefficient, r.std_error) for r in m.coefficients}
        assert rows == {
            ("term", "tanh(phi_dot/v0)"): (-3.0, None),
            ("term", "u"): (1.0, None),
            ("constant", "v0"): (0.05, 0.002),
            ("offset", "phi"): (0.1, 1e-3),
            ("delay", "u"): (0.02, 1e-4),
        }
    assert to_text(model).splitlines()[-2:] == [
        "# offset  phi  0.1000 +- 0.0010",
        "# delay   u    0.02000 +- 0.00010 s",
    ]


@pytest.mark.parametrize("model", [PLAIN, RATIONAL, cart(), enzyme()])
def test_a_model_read_back_has_the_same_table_and_shows_the_same(model, tmp_path):
    model.save(str(tmp_path / "model.json"))
    again = odescope.read_model(str(tmp_path / "model.json"))
    assert again.coefficients == model.coefficients
    assert repr(again) == repr(model)


def test_standard_errors_are_in_text_at_a_prompt_and_in_a_notebook():
    assert to_text(PLAIN, 3).splitlines() == [
        "x_ddot = 1.5*u - 4.0*x + 0.3*x_dot",
        "# x_ddot  x      -4.000 +- 0.020",
        "# x_ddot  x_dot  0.30 +- 0.10",
        "# x_ddot  u      1.5 +- 0",
    ]
    assert repr(PLAIN) == to_text(PLAIN, 6)
    html = PLAIN._repr_html_()
    assert "<tr><td>x_ddot</td><td>x</td><td>-4.000</td><td>0.020</td></tr>" in html
    assert "<table>" not in RATIONAL._repr_html_()
    assert "<table>" not in cart()._repr_html_()  # mechanisms are shown with theirs
    assert "+- " in to_text(cart())
    assert "x_ddot" not in [line.split()[1] for line in to_text(cart()).splitlines() if line[0] == "#"]


def test_a_prompt_shows_no_more_than_a_screen():
    count = 60
    names = [Coordinate(f"long_name_{k}") for k in range(count)]
    relations = [
        [(c.target, "1", 1.0), *((None, n.name, 0.1234567 * k) for k, n in enumerate(names[1:20], 1))] for c in names
    ]
    large = build(names, [], *relations)
    lines = repr(large).splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 120
    assert lines[0].startswith("long_name_0_dot = ")
    assert lines[-1] == "(more: odescope.to_text(model), model.coefficients)"
    assert isinstance(large, Model)


def test_relations_in_another_order_are_named_by_the_target_that_they_hold():
    """Of three, two hold more than one target: there is one order in which each holds its own."""
    x, y, z = Coordinate("x"), Coordinate("y"), Coordinate("z")
    of_z = [("z_dot", "1", 1.0), ("x_dot", "y", 0.5), (None, "z", 3.0)]
    of_x = [("x_dot", "1", 1.0), (None, "x", 7.0)]
    of_y = [("z_dot", "x", 0.1), ("y_dot", "1", 1.0), (None, "y", -2.0)]
    model = from_json(to_json(build([x, y, z], [], of_z, of_y, of_x)))
    named = {(row.equation, row.term): row.coefficient for row in model.coefficients}
    assert named["x_dot", "x"] == -7.0
    assert named["y_dot", "y"] == 2.0
    assert named["z_dot", "z"] == -3.0
    assert model == build([x, y, z], [], of_x, of_y, of_z)


def test_coupled_relations_stay_in_their_order():
    both = [("x_dot", "1", 0.5), ("y_dot", "1", 1.0), (None, "x", 3.0)], [("x_dot", "1", 1.0), ("y_dot", "1", 0.1)]
    model = build([Coordinate("x"), Coordinate("y")], [], *both)
    assert model.coefficients[0].equation == "x_dot"
    assert [r.terms[0].coefficient for r in model.relations] == [0.5, 1.0]
