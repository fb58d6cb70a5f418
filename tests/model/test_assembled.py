"""Relations of mechanisms, by hand, against Monte Carlo, and back."""

import numpy as np
import pytest

from odescope.library.mechanism import Mechanism, Part, candidates_of
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.model.assembled import coefficients_of, relations_of, stated, sureness
from odescope.model.coefficients import term_rows
from odescope.model.relation import NORMAL

TARGETS = ("x_ddot", "phi_ddot")
NAMES = ["x", "phi", "x_dot", "phi_dot", "u"]


def product(text, target=None):
    return Product(target, parse_term(text, Scope.of(NAMES)))


def tied(name, *parts):
    """Return a mechanism of parts (relation, share, product)."""
    return Mechanism("kinetic", name, "kinetic", tuple(Part(r, p, share) for r, share, p in parts), 1.0)


BARE_X, BARE_PHI = product("1", "x_ddot"), product("1", "phi_ddot")
# A pendulum on a cart, each coefficient one of its energies, its friction or its force.
CART = (
    tied("x_dot**2", (0, 1.0, BARE_X)),
    tied(
        "x_dot*phi_dot*cos(phi)",
        (0, 1.0, product("cos(phi)", "phi_ddot")),
        (0, -1.0, product("phi_dot**2*sin(phi)")),
        (1, 1.0, product("cos(phi)", "x_ddot")),
    ),
    tied("phi_dot**2", (1, 2.0, BARE_PHI)),
    tied("-cos(phi)", (1, 1.0, product("sin(phi)"))),
    # Friction between both: the sum of two mechanisms stands before x_dot.
    tied(
        "(x_dot - phi_dot)**2", (0, 1.0, product("x_dot")), (0, -1.0, product("phi_dot")), (1, -1.0, product("x_dot"))
    ),
    tied("x_dot**2 friction", (0, 1.0, product("x_dot"))),
    tied("u", (0, 1.0, product("u"))),
)
THETA = np.array([2.0, 0.5, 0.4, -3.0, 0.3, 0.6, -1.5])


def as_dict(relation):
    return {t.text: t.coefficient for t in relation.terms}


def test_tied_mechanisms_add_up_to_relations_with_the_leading_target_first():
    first, second = relations_of(CART, THETA, None, TARGETS)
    assert as_dict(first) == pytest.approx(
        {
            "x_ddot": 1.0, "phi_ddot*cos(phi)": 0.25, "phi_dot**2*sin(phi)": -0.25, "x_dot": 0.45, "phi_dot": -0.15,
            "u": -0.75,
        }
    )  # fmt: skip
    assert as_dict(second) == pytest.approx(
        {"phi_ddot": 1.0, "x_ddot*cos(phi)": 0.625, "sin(phi)": -3.75, "x_dot": -0.375}
    )
    for relation, target in zip((first, second), TARGETS, strict=True):
        assert relation.terms[0].text == target
        assert relation.terms[0].coefficient == 1.0
        assert all(t.std_error is None and t.interval is None for t in relation.terms)


@pytest.mark.parametrize("scale", [1e-6, -2.5, 1e8])
def test_relations_and_their_errors_do_not_depend_on_the_scale(scale):
    root = np.random.default_rng(0).standard_normal((7, 7)) * 0.02 * np.abs(THETA)
    covariance = root.T @ root
    one = relations_of(CART, THETA, covariance, TARGETS)
    other = relations_of(CART, scale * THETA, scale**2 * covariance, TARGETS)
    for a, b in zip(one, other, strict=True):
        assert [t.text for t in a.terms] == [t.text for t in b.terms]
        np.testing.assert_allclose([t.coefficient for t in b.terms], [t.coefficient for t in a.terms], rtol=1e-12)
        errors = [[t.std_error for t in r.terms[1:]] for r in (a, b)]
        np.testing.assert_allclose(errors[1], errors[0], rtol=1e-9)


@pytest.mark.parametrize("held", [0, 1, 2, 6])
def test_errors_are_those_of_monte_carlo_whichever_coefficient_is_held(held):
    rng = np.random.default_rng(held)
    root = rng.standard_normal((7, 7)) * 0.01 * np.abs(THETA)
    root[:, held] = 0.0
    covariance = root.T @ root
    draws = THETA + rng.standard_normal((20_000, 7)) @ root
    stated = relations_of(CART, THETA, covariance, TARGETS)
    # The same division for every draw, written out.
    x, m, i, g, both, own, u = draws.T
    drawn = [
        {"phi_ddot*cos(phi)": m / x, "phi_dot**2*sin(phi)": -m / x, "x_dot": (both + own) / x, "phi_dot": -both / x,
         "u": u / x},
        {"x_ddot*cos(phi)": m / (2 * i), "sin(phi)": g / (2 * i), "x_dot": -both / (2 * i)},
    ]  # fmt: skip
    for relation, columns in zip(stated, drawn, strict=True):
        assert relation.terms[0].std_error is None
        assert {t.text for t in relation.terms[1:]} == columns.keys()
        for t in relation.terms[1:]:
            # 20000 draws know a standard deviation to 0.5 %; second order adds as much again.
            assert t.std_error == pytest.approx(columns[t.text].std(), rel=0.03)
            low, high = t.interval
            assert (low, high) == pytest.approx(
                (t.coefficient - NORMAL * t.std_error, t.coefficient + NORMAL * t.std_error)
            )
            assert np.mean((columns[t.text] > low) & (columns[t.text] < high)) == pytest.approx(0.95, abs=0.01)


def test_a_ratio_that_is_known_but_for_rounding_has_no_error():
    """Two products of one mechanism in one relation: their ratio is that of the shares, whatever the coefficient."""
    pair = (
        tied("pair", (0, 1.0, BARE_X), (0, 3.0, product("x"))),
        tied("force", (0, 1.0, product("u"))),
    )
    (relation,) = relations_of(pair, np.array([0.7, -1.0]), np.diag([0.04, 0.01]), ("x_ddot",))
    terms = {t.text: t for t in relation.terms}
    assert terms["x"].coefficient == pytest.approx(3.0)
    assert terms["x"].std_error is None
    # u / pair: relative variances add up.
    assert terms["u"].std_error == pytest.approx(np.hypot(0.2 / 0.7, 0.1) / 0.7)


def test_what_cancels_but_for_rounding_is_left_out():
    cancel = (
        tied("a", (0, 1.0, BARE_X), (0, 0.1, product("x"))),
        tied("b", (0, 0.3, product("x")), (0, 1.0, product("u"))),
    )
    (relation,) = relations_of(cancel, np.array([0.3, -0.1]), None, ("x_ddot",))
    assert [t.text for t in relation.terms] == ["x_ddot", "u"]
    (kept,) = relations_of(cancel, np.array([0.3, -0.1 + 1e-9]), None, ("x_ddot",))
    assert [t.text for t in kept.terms] == ["x_ddot", "x", "u"]


LEADS = {
    "bare before all": (["x_ddot*x", "x_ddot", "phi_ddot"], [50.0, 0.1, 9.0], "x_ddot"),
    "the simplest with its own target": (["phi_ddot", "x_ddot*x**2", "x_ddot*x"], [5.0, 5.0, 0.2], "x_ddot*x"),
    "of two as simple the larger": (["x_ddot*x", "x_ddot*u"], [1.0, -3.0], "x_ddot*u"),
    "another target where its own is absent": (["x", "phi_ddot*x", "phi_ddot"], [1.0, 2.0, 0.3], "phi_ddot"),
}


@pytest.mark.parametrize("name", LEADS)
def test_which_term_leads(name):
    texts, theta, lead = LEADS[name]
    products = [Product.of(parse_term(t, Scope.of([*NAMES, *TARGETS])), TARGETS) for t in texts]
    mechanisms = candidates_of([products], ["x_ddot"])
    (relation,) = relations_of(mechanisms, np.array(theta), None, ("x_ddot",))
    assert relation.terms[0].text == lead
    assert relation.terms[0].coefficient == 1.0
    ratio = theta[texts.index(lead)]
    assert as_dict(relation) == pytest.approx({t: c / ratio for t, c in zip(texts, theta, strict=True)})


PLAIN = candidates_of(
    [
        [product("cos(phi)", "phi_ddot"), BARE_X, product("x"), product("u"), product("x_dot")],
        [product("sin(phi)"), BARE_PHI, product("u"), product("cos(phi)", "x_ddot")],
    ],
    TARGETS,
)


def test_coefficients_of_relations_are_those_of_plain_mechanisms_up_to_the_scale_of_each():
    theta = np.array([0.4, 2.0, -1.0, 0.0, 0.3, 8.8, -4.0, 0.5, 0.9])
    relations = relations_of(PLAIN, theta, None, TARGETS)
    back = coefficients_of(PLAIN, relations)
    np.testing.assert_allclose(back[:5], theta[:5] / 2.0, rtol=1e-14)
    np.testing.assert_allclose(back[5:], theta[5:] / -4.0, rtol=1e-14)
    # There and back once more changes nothing.
    assert relations_of(PLAIN, back, None, TARGETS) == relations


def test_coefficients_are_in_the_scale_of_what_is_known():
    known = tuple(
        Mechanism(m.kind, m.term, m.place, m.parts, m.size, m.name, 3.0 if m.term == "u" else None) for m in PLAIN
    )
    theta = np.array([0.4, 2.0, -1.0, 3.0, 0.3, 8.8, -4.0, 3.0, 0.9])
    np.testing.assert_allclose(coefficients_of(known, relations_of(known, theta, None, TARGETS)), theta, rtol=1e-12)


def test_coefficients_of_tied_mechanisms_come_back_where_each_relation_holds_one_that_is_known():
    theta = np.append(THETA[:4], -1.5)
    known = tuple(
        Mechanism(m.kind, m.term, m.place, m.parts, m.size, m.name, value)
        for m, value in zip((*CART[:4], CART[6]), (None, None, 0.4, None, -1.5), strict=True)
    )
    np.testing.assert_allclose(coefficients_of(known, relations_of(known, theta, None, TARGETS)), theta, rtol=1e-12)


def test_what_is_no_candidate_is_left_out_and_what_the_relations_lack_is_zero():
    theta = np.array([0.4, 2.0, -1.0, 0.5, 0.3, 8.8, -4.0, 0.5, 0.9])
    relations = relations_of(PLAIN, theta, None, TARGETS)
    fewer = (*PLAIN[:3], *PLAIN[5:], *candidates_of([[product("x_dot**2")]], ["x_ddot"]))
    back = coefficients_of(fewer, relations)
    np.testing.assert_allclose(back, [0.2, 1.0, -0.5, -2.2, 1.0, -0.125, -0.225, 0.0], rtol=1e-14)


# how sure a fraction is of its terms


FRACTION = candidates_of([[product("1", "x_ddot"), product("x**2", "x_ddot"), product("x"), product("u")]], ["x_ddot"])


def held_at(k, theta, covariance):
    """Return coefficients and their covariance in the scale in which the k-th is 1 and held."""
    slopes = (np.eye(len(theta)) - np.outer(theta / theta[k], np.eye(len(theta))[k])) / theta[k]
    return theta / theta[k], slopes @ covariance @ slopes.T


@pytest.mark.parametrize("k", range(4))
def test_how_sure_a_term_of_a_fraction_is_does_not_depend_on_what_a_fit_held(k):
    spread = np.random.default_rng(0).standard_normal((4, 4)) * [[0.1], [0.2], [1.0], [0.4]]
    theta, covariance = held_at(0, np.array([1.0, 0.5, 4.0, -2.0]), spread @ spread.T)
    found = sureness(FRACTION, *held_at(k, theta, covariance), ["x_ddot"])
    (relation,) = relations_of(FRACTION, theta, covariance, ["x_ddot"])
    rows = {row.term: row.z for row in term_rows([relation], ["x_ddot"]) if row.z is not None}
    told = [rows.get(m.term) for m in FRACTION]
    assert [s is None for s in found] == [t is None for t in told] == [True, False, False, False]
    assert found[1:] == pytest.approx([abs(z) for z in told[1:]], rel=1e-6)
    # What a fit holds has no error of its own: counted by the fit, this is another number.
    own = np.sqrt(np.diag(held_at(2, theta, covariance)[1]))
    assert abs(held_at(2, theta, covariance)[0][1] / own[1]) != pytest.approx(found[1], rel=0.05)


def test_what_is_tied_and_what_is_known_is_as_sure_as_it_is_stated():
    spread = 0.05 * np.random.default_rng(1).standard_normal((len(CART), len(CART)))
    covariance = spread @ spread.T
    covariance[0], covariance[:, 0] = 0.0, 0.0
    found = sureness(CART, THETA, covariance, TARGETS)
    sizes = [abs(m.coefficient) / m.std_error if m.std_error else None for m in stated(CART, THETA, covariance)]
    assert found == pytest.approx(sizes)
