from itertools import combinations_with_replacement, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from term_oracle import repeatable

from odescope.errors import InputError
from odescope.library.mechanism import Part
from odescope.library.product import Product
from odescope.library.reactions import reactions
from odescope.library.tape import evaluate, write_tape
from odescope.recordings.coordinate import Coordinate, Input

ENZYME = {"S": "s", "E": "e", "C": "s e", "P": "s"}


def species(names):
    return [Coordinate(name) for name in names]


def named(*texts, of="SECP", inputs=(), composition=None):
    found = reactions(species(of), [Input(u) for u in inputs], named=texts, composition=composition)
    return found[len(of) :]


def allowed(composition, inputs=(), molecules=2):
    found = reactions(
        species(composition),
        [Input(u) for u in inputs],
        named=None,
        composition=composition,
        molecules=molecules,
    )
    return {m.name: m for m in found[len(composition) :]}


def changes(mechanism, count):
    """What one unit of flux adds to every species."""
    out = np.zeros(count)
    for part in mechanism.parts:
        out[part.relation] -= part.share
    return out


def rates(mechanisms, coefficients, names, values):
    """The rates of change that relations with bare targets give."""
    out = np.zeros(values.shape)
    for m, k in zip(mechanisms, coefficients, strict=True):
        for part in m.parts:
            tape = write_tape(names, [part.product.term])
            out[part.relation] -= k * part.share * evaluate(tape, values)[0]
    return out


def test_the_parts_add_up_to_the_mass_action_rates_written_by_hand():
    names, rng = ["A", "B", "C", "D", "u"], np.random.default_rng(0)
    values = rng.uniform(0.2, 2.0, (5, 40))
    a, b, c, d, u = values
    texts = ["2 A <-> B", "B + C -> 2 D + C", "-> A", "D ->", "u -> C", "u + A ->", "A + B -> 3 B"]
    found = named(*texts, of=names[:4], inputs=["u"])
    k1, k2, k3, k4, k5, k6, k7, k8 = k = rng.uniform(0.5, 2.0, 8)
    expected = [
        -2 * k1 * a**2 + 2 * k2 * b + k4 - k7 * u * a - k8 * a * b,
        k1 * a**2 - k2 * b - k3 * b * c + 2 * k8 * a * b,
        k6 * u,
        2 * k3 * b * c - k5 * d,
    ]
    np.testing.assert_allclose(rates(found, k, names, values)[:4], expected, rtol=1e-13)


def test_rates_of_change_come_first_with_coefficient_one():
    found = reactions(species("AB"), [], named=["A -> B"], composition=None)
    assert [(m.kind, m.term, m.place, m.known, m.size) for m in found[:2]] == [
        ("term", "A_dot", "A_dot", 1.0, 0.0),
        ("term", "B_dot", "B_dot", 1.0, 0.0),
    ]
    assert found[1].parts == (Part(1, Product("B_dot")),)
    assert [(m.kind, m.term, m.place, m.known, m.name) for m in found[2:]] == [
        ("reaction", "A", "reaction", None, "A -> B")
    ]


@pytest.mark.parametrize(
    ("text", "name", "term", "size"),
    [
        ("S+E->C", "S + E -> C", "E*S", 2),
        ("S + S -> 2P", "2 S -> 2 P", "S**2", 2),
        ("C -> P + E", "C -> P + E", "C", 2),
        ("2*S -> P", "2 S -> P", "S**2", 2),
        ("-> S", "-> S", "1", 0),
        ("S ->", "S ->", "S", 1),
        ("u + E -> E + S", "u + E -> E + S", "E*u", 3),
    ],
)
def test_names_fluxes_and_sizes(text, name, term, size):
    (found,) = named(text, inputs=["u"])
    assert (found.name, found.term, found.size) == (name, term, size)


def test_a_reaction_is_called_by_its_name_as_several_have_one_flux():
    one, other = named("S + E -> C", "S + E -> P + E")
    assert one.term == other.term
    assert (str(one), str(other)) == ("S + E -> C", "S + E -> P + E")


def test_a_catalyst_stays_in_the_flux_and_has_no_part():
    (found,) = named("S + E -> P + E")
    assert found.term == "E*S"
    assert found.relations == {0, 3}


def test_an_arrow_with_two_heads_is_two_mechanisms():
    assert [m.name for m in named("C <-> P + E")] == ["C -> P + E", "P + E -> C"]


def test_the_enzyme_has_all_that_balances_and_nothing_else():
    found = allowed(ENZYME)
    assert {"S + E -> C", "C -> S + E", "C -> E + P", "E + P -> C", "S -> P"} <= set(found)
    assert not any(name.startswith("->") or name.endswith("->") for name in found)
    # The complexes by hand: s in S, P; se in C, SE, EP; ss in SS, SP, PP; sse in SC, CP; the others are alone.
    assert len(found) == 2 * 1 + 3 * 2 + 3 * 2 + 2 * 1


@st.composite
def compositions(draw):
    names = "ABCDE"[: draw(st.integers(2, 5))]
    return {s: {m: draw(st.integers(0, 2)) for m in "xyz"} for s in names}


@repeatable
@given(compositions(), st.integers(1, 2))
def test_every_reaction_conserves_every_moiety_and_none_is_missing(held, molecules):
    found = allowed({s: " ".join(f"{n} {m}" for m, n in h.items() if n) for s, h in held.items()}, (), molecules)
    stock = np.array([[h[m] for h in held.values()] for m in "xyz"])
    for mechanism in found.values():
        net = changes(mechanism, len(held))
        assert net.any()
        assert not (stock @ net).any(), mechanism.name
    complexes = [c for k in range(molecules + 1) for c in combinations_with_replacement(range(len(held)), k)]
    totals = [tuple(stock[:, list(c)].sum(axis=1)) for c in complexes]
    pairs = [(a, b) for (a, s), (b, t) in product(zip(complexes, totals, strict=True), repeat=2) if a != b and s == t]
    assert len(found) == len(pairs)


def test_repeated_moieties_and_counts_are_the_same():
    assert allowed({"A": "2 s", "B": "s"}).keys() == allowed({"A": "s s", "B": "s"}).keys() == {"A -> 2 B", "2 B -> A"}


def test_every_input_into_every_species_is_a_candidate():
    found = allowed(ENZYME, inputs=["u", "v"])
    assert {name for name in found if name[:2] in ("u ", "v ")} == {f"{u} -> {s}" for u in "uv" for s in ENZYME}
    (part,) = found["u -> E"].parts
    assert (part.relation, part.product.text, part.share) == (1, "u", -1.0)


def test_reactions_with_an_open_side_need_no_balance():
    assert len(named("u -> S", "-> S", "P ->", "u + C ->", composition=ENZYME, inputs=["u"])) == 4


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["S + E -> P"], "'S [+] E -> P' does not balance: it has 1 of 'e' on the left and 0 on the right"),
        (["u + C -> P"], "does not balance.*'e'"),
        (["S + Q -> C"], "'S [+] Q -> C' names 'Q', which is no species; there are: S, E, C, P, u"),
        (["S + E"], "one arrow"),
        (["S -> C -> P"], "one arrow"),
        (["S => C"], "one arrow"),
        (["S + -> C"], "cannot read ''"),
        (["0 S -> C"], "cannot read '0 S'"),
        (["1.5 S -> C"], "cannot read '1.5 S'"),
        (["S**2 -> C"], r"cannot read 'S\*\*2'"),
        (["17 S -> C"], "more than 16"),
        (["S + E -> E + S"], "changes nothing"),
        (["->"], "changes nothing"),
        (["C -> u"], "makes the input 'u'"),
        (["u <-> S"], "makes the input 'u'"),
        (["S + E -> C", "E + S -> C"], "named twice"),
        (["S <-> P", "P -> S"], "named twice"),
        (["S -> " + "P + " * 400 + "P"], "one arrow"),
    ],
)
def test_a_reaction_that_makes_no_sense_is_refused(texts, message):
    with pytest.raises(InputError, match=message):
        named(*texts, composition=ENZYME, inputs=["u"])


@pytest.mark.parametrize(
    ("composition", "message"),
    [
        ({"S": "s", "E": "e", "C": "s e"}, "does not say what P is made of"),
        (ENZYME | {"subs": "s"}, "names 'subs', which is no species"),
        (ENZYME | {"C": "s:2 e"}, "composition of 'C'.*':2 e' on|composition of 'C'.*'s:2 e' on"),
        (ENZYME | {"C": "2"}, "composition of 'C'"),
        (ENZYME | {"C": "0 s"}, "composition of 'C'"),
    ],
)
def test_a_composition_that_makes_no_sense_is_refused(composition, message):
    with pytest.raises(InputError, match=message):
        reactions(species("SECP"), [], named=None, composition=composition)


def test_what_is_missing_is_said():
    with pytest.raises(InputError, match="give reactions, such as"):
        reactions(species("AB"), [], named=None, composition=None)
    with pytest.raises(InputError, match="'x' cannot be a species of a reaction: its order is 2"):
        reactions([Coordinate("x", order=2)], [], named=["x ->"], composition=None)
    many = {f"A{k}": "a" for k in range(30)}
    with pytest.raises(InputError, match="name the reactions"):
        allowed(many)
    with pytest.raises(InputError, match="molecules must be"):
        allowed(ENZYME, molecules=0)


@repeatable
@given(
    st.lists(st.sampled_from(["S", "E", "u", "Q", " + ", "+", " -> ", "->", "<->", "2 ", "0", "-", "*", "(", "\u0663"]))
)
def test_whatever_is_written_is_read_or_refused(pieces):
    try:
        found = named("".join(pieces), inputs=["u"])
    except InputError:
        return
    assert all(changes(m, 4).any() for m in found)
