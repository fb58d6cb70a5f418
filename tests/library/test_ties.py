import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from term_oracle import repeatable

from odescope.errors import InputError
from odescope.library.conservation import conserved
from odescope.library.mechanism import Mechanism, Part, candidate, candidates_of
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.library.reactions import reactions
from odescope.library.tape import evaluate, write_tape
from odescope.library.ties import tied
from odescope.model.assembled import relations_of
from odescope.recordings.coordinate import Coordinate

TARGETS = ("x_ddot", "phi_ddot")
NAMES = ("x", "phi", "x_dot", "phi_dot", "u")
SCOPE = Scope.of([*NAMES, *TARGETS])


def products(*texts):
    return [Product.of(parse_term(t, SCOPE), TARGETS) for t in texts]


CART = candidates_of(
    [
        products("x_ddot", "phi_ddot*cos(phi)", "phi_dot**2*sin(phi)", "x_dot", "u", "1"),
        products("phi_ddot", "x_ddot*cos(phi)", "sin(phi)", "phi_dot", "u", "1", "x_ddot*phi"),
    ],
    TARGETS,
)
ENZYME = reactions(
    [Coordinate(s) for s in "SECP"], [], named=["S + E <-> C", "C -> P + E", "S + E -> P + E"], composition=None
)
ENZYME_SCOPE = Scope.of([*"SECP", *(f"{s}_dot" for s in "SECP")])


def tie(*ties):
    return tied(CART, ties, SCOPE)


def found(mechanisms, text):
    """The one mechanism of this name or description."""
    (one,) = (m for m in mechanisms if text in (m.name, str(m)))
    return one


def parts(mechanism):
    return {(p.relation, p.product.text): p.share for p in mechanism.parts}


def test_without_ties_nothing_changes():
    assert tie() == CART


@pytest.mark.parametrize(
    ("text", "factor"),
    [
        ("phi_dot**2*sin(phi) = -2*x_dot", -2.0),
        ("phi_dot**2*sin(phi) = - x_dot", -1.0),
        ("phi_dot**2*sin(phi) = x_dot", 1.0),
        ("sin(phi)*phi_dot**2=1e-1 * (x_dot)", 0.1),
        ("2*phi_dot**2*sin(phi) = -3*'x_dot'", -1.5),
        ("phi_dot**2*sin(phi) = x_dot/4", 0.25),
        ("phi_dot**2*sin(phi) in x_ddot = -2*x_dot in x_ddot", -2.0),
        ("phi_dot**2*sin(phi) = -2*x_dot in x_ddot", -2.0),
    ],
)
def test_a_tie_in_one_relation_merges_two_candidates(text, factor):
    merged = tie(text)
    one = found(merged, text)
    assert (one.kind, one.term, one.place, one.size, one.known) == ("tie", "x_dot", "x_ddot", 1, None)
    assert parts(one) == {(0, "x_dot"): 1.0, (0, "phi_dot**2*sin(phi)"): pytest.approx(factor, rel=1e-15)}
    assert len(merged) == len(CART) - 1
    assert [m for m in merged if m != one] == [
        m for m in CART if str(m) not in ("x_dot in x_ddot", "phi_dot**2*sin(phi) in x_ddot")
    ]


def test_a_tie_holds_in_every_relation_that_has_both():
    merged = tie("u = 3*(1)")
    assert [parts(m) for m in merged if m.kind == "tie"] == [
        {(0, "1"): 1.0, (0, "u"): 3.0},
        {(1, "1"): 1.0, (1, "u"): 3.0},
    ]
    assert [parts(m) for m in tie("1 in x_ddot = u") if m.kind == "tie"] == [{(0, "1"): 1.0, (0, "u"): 1.0}]


def test_a_tie_between_relations():
    one = found(tie("u in x_ddot = -2*u in phi_ddot"), "u in x_ddot = -2*u in phi_ddot")
    assert parts(one) == {(0, "u"): -2.0, (1, "u"): 1.0}
    assert (one.term, one.place) == ("u", "phi_ddot")
    # x_dot is in the first relation alone and phi_dot in the second: nothing else can be meant.
    assert parts(found(tie("x_dot = phi_dot"), "x_dot = phi_dot")) == {(0, "x_dot"): 1.0, (1, "phi_dot"): 1.0}


def test_terms_with_a_target_are_found_in_either_order():
    for text in ("x_ddot*phi = x_ddot*cos(phi)", "phi*x_ddot = cos(phi)*x_ddot"):
        assert parts(found(tie(text), text)) == {(1, "x_ddot*cos(phi)"): 1.0, (1, "x_ddot*phi"): 1.0}


@repeatable
@given(st.lists(st.sampled_from([-3.0, -0.5, 0.1, 2.0, 7.0]), min_size=3, max_size=3), st.permutations(range(3)))
def test_chains_of_ties_multiply_whatever_their_order(factors, order):
    a, b, c = factors
    texts = [f"phi_dot**2*sin(phi) = {a!r}*x_dot", f"x_dot = {b!r}*(1) in x_ddot", f"u in x_ddot = {c!r}*x_dot"]
    (one,) = (m for m in tie(*(texts[k] for k in order)) if m.kind == "tie")
    assert one.term == "1"
    assert parts(one) == pytest.approx(
        {(0, "1"): 1.0, (0, "x_dot"): b, (0, "phi_dot**2*sin(phi)"): a * b, (0, "u"): c * b}, rel=1e-14
    )


def test_what_is_said_twice_is_said_once():
    both = tie("x_dot = 3*u in x_ddot", "u in x_ddot = x_dot/3")
    assert parts(found(both, "x_dot = 3*u in x_ddot; u in x_ddot = x_dot/3")) == pytest.approx(
        {(0, "u"): 1.0, (0, "x_dot"): 3.0}
    )


def test_a_value_is_relative_to_the_bare_target():
    given = tie("x_dot = 0.5")
    assert {str(m): m.known for m in given if m.known is not None} == {"x_ddot in x_ddot": 1.0, "x_dot in x_ddot": 0.5}
    in_both = tie("u in x_ddot = 1/2", "u in phi_ddot = 1/2")
    assert {str(m): m.known for m in in_both if m.known is not None} == {
        "x_ddot in x_ddot": 1.0,
        "u in x_ddot": 0.5,
        "phi_ddot in phi_ddot": 1.0,
        "u in phi_ddot": 0.5,
    }
    with pytest.raises(InputError, match="may mean several: 'u in x_ddot', 'u in phi_ddot'; say which"):
        tie("u = 1/2")
    assert found(tie("x_ddot in x_ddot = 1"), "x_ddot in x_ddot").known == 1.0


def test_values_pass_through_ties():
    one = found(tie("x_dot = -4*u in x_ddot", "x_dot = 2"), "x_dot = -4*u in x_ddot")
    assert one.known == -0.5
    assert parts(one) == {(0, "u"): 1.0, (0, "x_dot"): -4.0}


def test_tied_relations_are_the_untied_ones_with_equal_coefficients():
    """Oracle: the untied candidates with coefficients that satisfy the ties, written by hand."""
    merged = tie("u in x_ddot = -2*u in phi_ddot", "x_dot = 0.25*phi_dot")
    values = {"u in phi_ddot": 1.5, "phi_dot in phi_ddot": 0.8, "sin(phi) in phi_ddot": 9.0}
    values |= {"x_ddot in x_ddot": 1.0, "phi_ddot in phi_ddot": 1.0}
    untied = values | {"u in x_ddot": -3.0, "x_dot in x_ddot": 0.2}

    def shown(mechanisms, coefficients):
        theta = np.array([coefficients.get(str(m), 0.0) for m in mechanisms])
        relations = relations_of(mechanisms, theta, None, TARGETS)
        return [{t.product.text: pytest.approx(t.coefficient, rel=1e-14) for t in r.terms} for r in relations]

    assert shown(merged, values) == shown(CART, untied)


def test_reactions_are_tied_by_name():
    merged = tied(ENZYME, ["(S + E -> C) = 2*(C -> P + E)", "'C -> S + E' = 0.5"], ENZYME_SCOPE)
    one = found(merged, "(S + E -> C) = 2*(C -> P + E)")
    assert parts(one) == {
        (0, "E*S"): 2.0,
        (1, "E*S"): 2.0,
        (2, "E*S"): -2.0,
        (1, "C"): -1.0,
        (2, "C"): 1.0,
        (3, "C"): -1.0,
    }
    assert (one.term, one.place, one.size) == ("C", "reaction", 2.0)
    assert found(merged, "C -> S + E").known == 0.5
    assert tied(ENZYME, ["S+E -> C = 2*C->P + E in reaction"], ENZYME_SCOPE)[4].kind == "tie"


def test_the_tied_enzyme_has_the_rates_written_by_hand():
    merged = tied(ENZYME, ["S + E -> C = 2*(C -> P + E)"], ENZYME_SCOPE)
    values = np.random.default_rng(0).uniform(0.5, 2.0, (4, 20))
    s, e, c, _ = values
    k = {"S + E -> C = 2*(C -> P + E)": 0.7, "C -> S + E": 0.3, "S + E -> P + E": 0.2}
    out = np.zeros((4, 20))
    for m in merged[4:]:
        for p in m.parts:
            out[p.relation] -= k[m.name] * p.share * evaluate(write_tape(list("SECP"), [p.product.term]), values)[0]
    bind, loose, turn, straight = 1.4 * s * e, 0.3 * c, 0.7 * c, 0.2 * s * e
    expected = [loose - bind - straight, loose + turn - bind, bind - loose - turn, turn + straight]
    np.testing.assert_allclose(out, expected, rtol=1e-13)


def test_ties_leave_what_reactions_conserve():
    merged = tied(ENZYME, ["S + E -> C = 0.3*(C -> P + E)", "C -> P + E = 3*(C -> S + E)"], ENZYME_SCOPE)
    coordinates = [Coordinate(s) for s in "SECP"]
    assert len(merged) == len(ENZYME) - 2
    assert conserved(coordinates, merged) == conserved(coordinates, ENZYME) != ()


def test_terms_that_the_scope_cannot_read_are_found_as_they_are():
    odd = Mechanism("kinetic", "|v|^2", "kinetic", (Part(0, Product("x_ddot")),), 1.0)
    merged = tied([odd, candidate(0, Product(None, parse_term("u", SCOPE)), "x_ddot")], ["|v|^2 = 2*u"], SCOPE)
    assert parts(merged[0]) == {(0, "x_ddot"): 2.0, (0, "u"): 1.0}


def test_parts_that_cancel_but_for_rounding_are_left_out():
    term = Product(None, parse_term("u", SCOPE))
    one = Mechanism("force", "a", "force", (Part(0, term, 0.3), Part(1, term)), 1.0)
    other = Mechanism("force", "b", "force", (Part(0, term, 0.1),), 1.0)
    assert 0.3 - 3 * 0.1 != 0.0
    (merged,) = tied([one, other], ["b = -3*a"], Scope.of(["a", "b"]))
    assert parts(merged) == {(1, "u"): 1.0}


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["x_dot"], "cannot read the tie 'x_dot'"),
        (["x_dot = "], "cannot read"),
        (["x_dot == u"], "cannot read"),
        (["x_dot = u = 1"], "cannot read"),
        (["2 = x_dot"], "cannot read"),
        (["x_dot = u + phi_dot"], "cannot read"),
        (["x_dot = " + "1*" * 600 + "u"], "cannot read"),
        (["x_dott = 2*u"], "names 'x_dott', which is no candidate; did you mean 'x_dot'?"),
        (["x_dot = 2*v"], "names 'v', which is no candidate; there are: x_ddot, "),
        (["x_dot = 2*cos(phi)"], "names 'cos[(]phi[)]', which is no candidate; did you mean"),
        (["x_dot = __import__('os')"], "which is no candidate"),
        (["u in x_dddot = x_dot"], "names 'u' in 'x_dddot', where it is not: did you mean 'x_ddot'?"),
        (["u = x_ddot in x_ddot", "x_dot in phi_ddot = u"], "names 'x_dot' in 'phi_ddot', where it is not"),
        (["x_dot = u", "u = sin(phi) in x_ddot"], "names 'sin.phi.' in 'x_ddot', where it is not"),
        (["u = 2*u in x_ddot"], "leaves only zero for 'u in x_ddot'"),
        (["u = -u"], "leaves only zero for 'u in x_ddot'"),
        (["u = u"], "says nothing"),
        (["x_dot = 0"], "leaves only zero: '0' is zero; leave the candidate out"),
        (["x_dot = 0*u"], "leaves only zero"),
        (["0*x_dot = u"], "leaves only zero"),
        (["x_dot = 2*u", "x_dot = 3*u"], "the ties 'x_dot = 2[*]u' and 'x_dot = 3[*]u' together leave only zero"),
        (["x_dot = u", "u in x_ddot = (1)", "(1) in x_ddot = -x_dot"], "together leave only zero"),
        (["x_dot = 0.5", "x_dot = 0.6"], "cannot be both 0.5 and 0.6, as 'x_dot = 0.5' and 'x_dot = 0.6'"),
        (["x_dot = 0.5", "x_dot = u in x_ddot", "u in x_ddot = 1"], "cannot be both"),
        (["x_ddot in x_ddot = 2"], "of 'x_ddot in x_ddot' cannot be both 2 and 1"),
        (["x_dot = 1e999"], "which is no candidate|too large"),
    ],
)
def test_ties_that_make_no_sense_are_refused(texts, message):
    with pytest.raises(InputError, match=message):
        tie(*texts)


def test_a_tie_that_may_mean_several_is_refused():
    with pytest.raises(InputError, match="no place has both sides, the first is 'phi_dot in phi_ddot' and the second"):
        tied([*CART, candidate(0, products("phi")[0], "x_ddot"), candidate(2, products("phi")[0], "z")],
             ["phi_dot = phi"], SCOPE)  # fmt: skip
    with pytest.raises(InputError, match=r"names 'C', which may mean 'C -> S [+] E' or 'C -> P [+] E': say which"):
        tied(ENZYME, ["C = 2*(S + E -> C)"], ENZYME_SCOPE)


def test_a_value_without_a_bare_target_is_refused():
    rest = [m for m in CART if str(m) != "x_ddot in x_ddot"]
    with pytest.raises(InputError, match="relative to that of x_ddot, which is not among the candidates"):
        tied(rest, ["x_dot = 0.5"], SCOPE)


def test_ties_that_cancel_are_refused():
    there, back = (
        Mechanism("force", t, "force", (Part(0, Product(None, parse_term("u", SCOPE)), share),), 1.0)
        for t, share in (("x", 1.0), ("phi", -2.0))
    )
    with pytest.raises(InputError, match=r"'x = 2[*]phi' leaves only zero: all that is tied cancels"):
        tied([there, back], ["x = 2*phi"], SCOPE)
    with pytest.raises(InputError, match="cannot be both"):
        tied(ENZYME, ["S_dot = 2*E_dot"], ENZYME_SCOPE)


@repeatable
@given(
    st.lists(
        st.sampled_from(
            ["x_dot", "u", "(1)", "=", "*", "-", "2", "0", " in ", "x_ddot", "(", ")", "'", "->", ".", "e9"]
        )
    )
)
def test_whatever_is_written_is_read_or_refused(pieces):
    try:
        merged = tie("".join(pieces))
    except InputError:
        return
    assert all(m.parts and m.known != 0.0 for m in merged)
