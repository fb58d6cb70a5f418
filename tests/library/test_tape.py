import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from term_oracle import NAMES, SCOPE, columns, repeatable, texts, values

from odescope.errors import InputError
from odescope.library.expression import Combination, Term
from odescope.library.functions import FUNCTIONS
from odescope.library.parse import parse_term
from odescope.library.tape import LANES, evaluate, write_tape

TEXTS = (
    "1", "u", "x**3", "x**-2", "x**2.5", "sin(phi)", "sin(phi)*cos(phi)*phi_dot**2", "exp(-x)*u", "tan(0.3*phi - u)",
    "(x - 2*u + 0.25)**2", "log(x)*sqrt(x*u)", "tanh(x)/abs(u)", "sign(x - u)*x",
)  # fmt: skip


def term(text):
    return parse_term(text, SCOPE)


@pytest.mark.parametrize("samples", [1, 2, LANES - 1, LANES, LANES + 1, 3 * LANES + 17])
def test_values_are_numpys_for_any_number_of_samples(samples):
    x = columns(np.random.default_rng(samples), samples)
    found = evaluate(write_tape(NAMES, [term(t) for t in TEXTS]), x)
    for row, text in zip(found, TEXTS, strict=True):
        np.testing.assert_allclose(row, values(text, x), rtol=1e-13, atol=1e-15, err_msg=text)


@repeatable
@given(st.lists(texts, min_size=1, max_size=4))
def test_a_term_has_the_same_values_alone_as_among_others(spelled):
    terms = []
    for text in spelled:
        try:
            terms.append(term(text))
        except InputError:
            continue
    x = columns(np.random.default_rng(6), 4)
    together = evaluate(write_tape(NAMES, terms), x)
    for row, t in zip(together, terms, strict=True):
        np.testing.assert_array_equal(row, evaluate(write_tape(NAMES, [t]), x)[0])


def test_a_sample_does_not_see_its_neighbours():
    tape = write_tape(NAMES, [term(t) for t in TEXTS])
    x = columns(np.random.default_rng(7), 2 * LANES + 5)
    whole = evaluate(tape, x)
    for i in (0, LANES - 1, LANES, 2 * LANES + 4):
        np.testing.assert_allclose(whole[:, i], evaluate(tape, x[:, i : i + 1])[:, 0], rtol=1e-15)


def test_common_parts_are_computed_once():
    terms = [term(t) for t in ("sin(phi)", "sin(phi)**2", "sin(phi)*u", "cos(sin(phi))", "sin(phi)*u*x")]
    tape = write_tape(NAMES, terms)
    assert list(tape.instructions.code).count(FUNCTIONS["sin"].code) == 1
    twice = write_tape(NAMES, [*terms, *terms])
    assert twice.slots == tape.slots
    assert list(twice.outputs) == 2 * list(tape.outputs)


def test_combinations_add_up():
    x = columns(np.random.default_rng(8), 6)
    parts = [(2.0, term("x")), (-0.5, term("sin(u)")), (3.0, Term())]
    found = evaluate(write_tape(NAMES, [Combination.of(parts), Combination()]), x)
    np.testing.assert_allclose(found[0], values("2*x - 0.5*sin(u) + 3", x), rtol=1e-14)
    np.testing.assert_array_equal(found[1], np.zeros(6))


def test_the_layout_of_the_columns_does_not_matter():
    x = columns(np.random.default_rng(9), 40)
    tape = write_tape(NAMES, [term(t) for t in TEXTS])
    expected = evaluate(tape, x)
    np.testing.assert_array_equal(evaluate(tape, np.asfortranarray(x)), expected)
    np.testing.assert_array_equal(evaluate(tape, x[:, ::2]), expected[:, ::2])
    before = x.copy()
    evaluate(tape, x)
    np.testing.assert_array_equal(x, before)


@pytest.mark.parametrize(
    ("text", "x", "expected"),
    [
        ("log(x)", -1.0, np.nan),
        ("log(x)", 0.0, -np.inf),
        ("sqrt(x)", -1.0, np.nan),
        ("x**0.5", -1.0, np.nan),
        ("x**-1", 0.0, np.inf),
        ("1/x**2", 0.0, np.inf),
        ("exp(x)", 1e4, np.inf),
        ("x**16", 1e30, np.inf),
        ("sin(x)", np.nan, np.nan),
        ("sign(x)", np.nan, np.nan),
        ("abs(x)", -np.inf, np.inf),
    ],
)
def test_domain_errors_are_values_not_exceptions(text, x, expected):
    found = evaluate(write_tape(["x"], [term(text)]), np.array([[x, 1.0]]))[0]
    np.testing.assert_array_equal(found[0], expected)
    assert np.isfinite(found[1])
