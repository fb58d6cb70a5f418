import numpy as np
import pytest
import sympy
from hypothesis import assume, given
from hypothesis import strategies as st
from term_oracle import NAMES, SCOPE, SYMBOLS, columns, derivative, read, repeatable, steady, texts, values

from odescope.errors import InputError
from odescope.library.derivative import derivative as ours
from odescope.library.expression import ONE, Combination, Name, Term, signed_sum
from odescope.library.latex import LATEX, latex_name, latex_sum
from odescope.library.parse import Scope, parse_term
from odescope.library.printer import print_term
from odescope.library.readable import readable
from odescope.library.tape import evaluate, write_tape

powers = st.sampled_from([-3, -2, -1, 1, 2, 3, 0.5, 1.5])
products = st.lists(st.tuples(st.sampled_from([Name(n) for n in NAMES]), powers), max_size=5).map(Term.of)


def term(text):
    return parse_term(text, SCOPE)


def parsed(text):
    """The term of a random text, ONE where the text carries a number besides."""
    try:
        return term(text)
    except InputError:
        return ONE


# products


@repeatable
@given(products, products, products)
def test_products_form_a_commutative_group(a, b, c):
    inverse = Term.of((atom, -power) for atom, power in a.factors)
    assert a * b == b * a
    assert hash(a * b) == hash(b * a)
    assert (a * b) * c == a * (b * c)
    assert a * ONE == a
    assert a * inverse == ONE


@repeatable
@given(products, products)
def test_powers_add_in_a_product(a, b):
    for name in NAMES:
        assert (a * b).power_of(Name(name)) == a.power_of(Name(name)) + b.power_of(Name(name))


@repeatable
@given(products, products)
def test_the_values_of_a_product_are_the_products_of_the_values(a, b):
    x = columns(np.random.default_rng(0), 7)
    one, other, both = evaluate(write_tape(NAMES, [a, b, a * b]), x)
    np.testing.assert_allclose(both, one * other, rtol=1e-13)


def test_equal_products_have_one_text_whatever_the_order_of_factors():
    assert term("sin(phi)*u*phi_dot**2").text == term("phi_dot*u*sin(phi)*phi_dot").text == "phi_dot**2*u*sin(phi)"
    assert term("sin(u - 2*phi)").text == term("sin(-phi + u - phi)").text


def test_names_are_found_inside_functions_too():
    assert term("u*sin(phi - 2*x*phi_dot)").names == {"u", "phi", "x", "phi_dot"}
    assert ONE.names == frozenset()


# derivatives


@repeatable
@given(texts, st.sampled_from(NAMES))
def test_the_gradient_is_sympys_derivative(text, name):
    t = parsed(text)
    slope = ours(t, name)
    x = columns(np.random.default_rng(1), 8)
    x = x[:, steady(t, x) & (steady(slope, x) if slope.parts else True)]
    assume(x.size)
    found = evaluate(write_tape(NAMES, [slope]), x)[0]
    parts = evaluate(write_tape(NAMES, [p for _, p in slope.parts]), x) * np.array(
        [[c] for c, _ in slope.parts] or [[0.0]]
    )
    assert np.all(np.abs(found - derivative(t.text, name, x)) <= 1e-9 * np.abs(parts).sum(axis=0))


@pytest.mark.parametrize(
    "text", ["abs(x)*x", "tan(x)**2", "(x - u)**3*tanh(x)", "x**-3*cos(x - u)", "sign(x)*x**2", "exp(-x*u)*sin(x)**2"]
)
def test_the_gradient_holds_on_either_side_of_zero(text):
    x = columns(np.random.default_rng(2), 6, -1.4, 1.4)
    slope = evaluate(write_tape(NAMES, [ours(term(text), "x")]), x)[0]
    np.testing.assert_allclose(slope, derivative(text, "x", x), rtol=1e-11)


def test_the_gradient_in_a_name_that_does_not_appear_is_nothing():
    assert ours(term("u*sin(phi)"), "x") == Combination()


# text


@repeatable
@given(st.lists(st.tuples(st.floats(-1e6, 1e6).filter(bool), st.sampled_from(["1", *NAMES])), min_size=1, max_size=4))
def test_the_floats_of_a_sum_round_trip(parts):
    names = {name: sympy.Rational(k + 2, 7) for k, name in enumerate(NAMES)}

    def exact(x):
        return sympy.Rational(*x.as_integer_ratio())

    expected = sum(exact(c) * (names[t] if t != "1" else 1) for c, t in parts)
    text = signed_sum(parts)
    found = sympy.Integer(0)
    for piece in text.replace(" - ", " + -").split(" + "):
        number = read(piece, dict.fromkeys(NAMES, 1), {})
        found += exact(float(number)) * next((names[n] for n in sorted(NAMES, key=len)[::-1] if n in piece), 1)
    assert found == expected


@repeatable
@given(texts)
def test_the_text_means_what_the_term_does(text):
    t = parsed(text)
    x = columns(np.random.default_rng(3), 8)
    x = x[:, steady(t, x)]
    np.testing.assert_allclose(evaluate(write_tape(NAMES, [t]), x)[0], values(t.text, x), rtol=1e-11)


# LaTeX


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("x", "x"),
        ("phi", r"\phi"),
        ("x_dot", r"\dot{x}"),
        ("phi_ddot", r"\ddot{\phi}"),
        ("x_ddddddot", r"{x}^{(6)}"),
        ("phi1_ddot", r"\ddot{\phi}_{1}"),
        ("cart", r"\mathrm{cart}"),
        ("x_cart_dot", r"\dot{x}_{cart}"),
        ("T_in", r"T_{in}"),
        ("k12", "k_{12}"),
        ("x2_left_side", r"x_{2,left\_side}"),
    ],
)
def test_latex_of_names(name, expected):
    assert latex_name(name) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1", "1"),
        ("phi_dot**2*sin(phi)", r"{\dot{\phi}}^{2} \, \sin\left(\phi\right)"),
        ("cos(phi)**2", r"\cos^{2}\left(\phi\right)"),
        ("sqrt(x)", r"\sqrt{x}"),
        ("(x - 3)**2", r"\left(-3 + x\right)^{2}"),
        ("sin(phi - 2*u)", r"\sin\left(\phi - 2 \, u\right)"),
        ("tanh(phi_dot/u)", r"\tanh\left(\frac{\dot{\phi}}{u}\right)"),
        ("1/cos(phi)**2", r"\frac{1}{\cos^{2}\left(\phi\right)}"),
        ("x*u/(x + u)", r"\frac{u \, x}{\left(u + x\right)}"),
        ("x/sqrt(x)**3/u", r"\frac{x}{u \, \left(x\right)^{3/2}}"),
    ],
)
def test_latex_of_terms(text, expected):
    assert print_term(LATEX, term(text)) == expected


def test_latex_of_sums_signs_and_powers_of_ten():
    parts = [(-1.0, "x"), (1.0, "u"), (-2.5e-7, "y"), (1.0, "1"), (-0.123456789, "z")]
    assert latex_sum(parts) == r"-x + u - 2.5 \cdot 10^{-7} \, y + 1 - 0.123457 \, z"
    assert latex_sum(parts[-1:], digits=2) == r"-0.12 \, z"
    assert latex_sum([]) == "0"


def test_the_oracle_itself_reads_as_sympy_does():
    x, u = SYMBOLS["x"], SYMBOLS["u"]
    assert read("2*x**2*sin(u - x)", SYMBOLS, {"sin": sympy.sin}) == 2 * x**2 * sympy.sin(u - x)


@pytest.mark.parametrize(
    "text",
    ["exp((y - x)/s)", "exp((x - 2.0*y)/s)", "tanh((1.0 - x)/s)", "exp(-x/s)", "exp(1/s - 1/x)", "sin(x/s - y)"],
)
def test_what_divides_all_of_an_argument_stands_below_it_once_and_reads_back(text):
    scope = Scope.of(["x", "y", "s"])
    term = parse_term(text, scope)
    assert readable(term) == text
    assert parse_term(readable(term), scope) == term
