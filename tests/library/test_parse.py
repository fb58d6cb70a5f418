import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from term_oracle import NAMES, SCOPE, columns, repeatable, steady, texts, values

from odescope.errors import InputError
from odescope.library.expression import ONE
from odescope.library.functions import FUNCTIONS
from odescope.library.parse import MAXIMUM_DEPTH, MAXIMUM_LENGTH, MAXIMUM_POWER, Definition, Scope, parse_term
from odescope.library.tape import evaluate, write_tape


def term(text, *definitions):
    return parse_term(text, Scope.of(NAMES, definitions))


def valued(t, x):
    return evaluate(write_tape(NAMES, [t]), x)[0]


# what is read


@repeatable
@given(texts)
def test_a_text_is_refused_or_means_what_python_says_and_reads_back(text):
    try:
        t = term(text)
    except InputError:
        return
    x = columns(np.random.default_rng(4), 8)
    x = x[:, steady(t, x)]
    np.testing.assert_allclose(valued(t, x), values(text, x), rtol=1e-10)
    assert term(t.text) == t
    assert term(t.text).text == t.text


TOKENS = [*NAMES, *FUNCTIONS, *"+-*/(),.", "**", "(", ")", "1", "2", "0.5", "16", "1e99", "f(", "g(", "identity("]
OWN = (Definition("f", ("v",), "abs(v)*v"), Definition("g", ("a", "b"), "(a - 2*b)**2*sin(a)"))


@repeatable
@given(st.lists(st.sampled_from(TOKENS), max_size=14).map("".join))
def test_any_string_of_tokens_is_refused_or_reads_back(text):
    try:
        t = term(text, *OWN)
    except InputError:
        return
    assert term(t.text) == t


@repeatable
@given(st.text(max_size=30))
def test_any_text_is_refused_or_reads_back(text):
    try:
        t = term(text)
    except InputError:
        return
    assert term(t.text) == t


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("1", "1"),
        (" u ", "u"),
        ("x/phi_dot**2", "phi_dot**-2*x"),
        ("x/x", "1"),
        ("x*x**2.0", "x**3"),
        ("(x*u)**2", "u**2*x**2"),
        ("2*x*0.5", "x"),
        ("sin(-phi)", "sin(-phi)"),
        ("identity(x)", "x"),
        ("identity(x - u)", "(-u + x)**1"),
        ("x**0.5", "x**0.5"),
        ("(4*x)**0.5/2", "x**0.5"),
        ("x**0.5*x**0.5", "x"),
        ("((x + u)**2)**3", "(u + x)**6"),
        ("x*(u - x)/x", None),
        ("-(-x)", "x"),
        ("x**16", "x**16"),
        ("x/((1 + u)*(2 + x))", "x*(1.0 + u)**-1*(2.0 + x)**-1"),
        ("1/(x*(u + x))", "x**-1*(u + x)**-1"),
        ("sin(0.1*x + 0.2*x)", "sin(0.30000000000000004*x)"),
    ],
)
def test_canonical_texts(text, canonical):
    if canonical is None:
        with pytest.raises(InputError, match="without sums"):
            term(text)
    else:
        assert term(text).text == canonical
        assert term(canonical) == term(text)


# what is refused


HOSTILE = {
    "nothing": "",
    "blank": "   ",
    "attribute": "x.real",
    "dunder": "x.__class__.__mro__",
    "import": "__import__('os')",
    "method": "phi.sin()",
    "called call": "sin(phi)(phi)",
    "unknown function": "eval(x)",
    "variable called": "x(u)",
    "function alone": "sin",
    "no argument": "sin()",
    "two arguments": "sin(phi, u)",
    "keyword": "sin(x=phi)",
    "unpacked keyword": "sin(**phi)",
    "starred": "sin(*phi)",
    "lambda": "(lambda: x)()",
    "comprehension": "[x for x in (1, 2)]",
    "generator": "sum(x for u in x)",
    "set": "{x}",
    "dict": "{x: u}",
    "f-string": "f'{x}'",
    "string": "'x'",
    "bytes": "b'x'",
    "escape": r"'\d'",
    "walrus": "(x := u)",
    "statement": "x = u",
    "two statements": "x; u",
    "two lines": "x\nu",
    "if": "x if u else phi",
    "if glued": "1if x else u",
    "boolean": "x*True",
    "none": "None",
    "ellipsis": "...",
    "and": "x and u",
    "not": "not x",
    "comparison": "x < u",
    "subscript": "x[0]",
    "tuple": "x, u",
    "await": "await x",
    "yield": "(yield x)",
    "plus sign": "+x",
    "invert": "~x",
    "matrix product": "x @ u",
    "floor": "x // u",
    "modulo": "x % u",
    "caret": "x^2",
    "shift": "x << 2",
    "imaginary": "x*1j",
    "no number": "nan",
    "unknown name": "y",
    "sum": "x + u",
    "coefficient": "2*x",
    "minus": "-x",
    "zero": "0*x",
    "cancelled": "x - x",
    "function of a constant": "sin(2)",
    "function of what cancels": "sin(x - x + 1)",
    "product of sums": "sin((x + u)*(x - u))",
    "division by zero": "x/0",
    "division by what cancels": "x/(u - u)",
    "power of zero": "(x - x)**2",
    "power zero": "x**0",
    "power of a name": "x**u",
    "power of itself": "x**x",
    "computed power": "x**(1 + 1)",
    "power in text": "x**'2'",
    "boolean power": "x**True",
    "twice signed power": "x**--2",
    "imaginary power": "x**2j",
    "tower": "x**9**9**9",
    "bare tower": "9**9**9",
    "tower in a function": "sin(9**9**9*x)",
    "high power": f"x**{MAXIMUM_POWER + 1}",
    "high negative power": f"x**-{MAXIMUM_POWER + 1}",
    "high power of a sum": f"(u + x)**{MAXIMUM_POWER + 1}",
    "power zero of a sum": "(u + x)**0",
    "power of a power": "(x**8)**8",
    "powers that add up": "x**16*x**16",
    "powers that add up inside": "sin(x**16*x)",
    "huge power": "x**1e300",
    "infinite power": "x**1e999",
    "long power": "x**" + "9" * 900,
    "infinity": "1e999*x",
    "huge number": "1e200*x",
    "long number": "9" * 900 + "*x",
    "long hexadecimal": "0x" + "f" * 900 + "*x",
    "infinite product": "sin(" + "1e100*" * 4 + "x)",
    "no number by cancelling": "sin(1e100*1e100*1e100*1e100*x - 1e100*1e100*1e100*1e100*x + u)",
    "high power of a number": "sin((1e100*x)**16)",
    "negative under a root": "(-4*x)**0.5",
    "root of a square": "(x**2)**0.5",
    "root of a product": "(x*u)**0.5",
    "deep": "(" * 3000 + "x" + ")" * 3000,
    "deep functions": "sin(" * 3000 + "x" + ")" * 3000,
    "deep within the length": "(" * 450 + "x" + ")" * 450,
    "functions within the length": "sin(" * 190 + "x" + ")" * 190,
    "functions just too deep": "sin(" * (MAXIMUM_DEPTH + 1) + "x" + ")" * (MAXIMUM_DEPTH + 1),
    "signs": "-" * 900 + "x",
    "long chain": "x" + "*x" * 400,
    "long sum": "sin(x" + "+x*u" * 200 + ")",
    "long": "x*" * 500_000 + "x",
    "open bracket": "sin(phi",
    "open brackets": "(" * 900,
    "null byte": "x\0",
    "null byte inside": "sin(ph\0i)",
    "surrogate": "\ud800",
    "mathematical letter": "\U0001d431",
    "long s": "\u017fin(phi)",
    "ligature": "\ufb01",
    "full width digit": "x**\uff12",
    "no-break space": "x\u00a0*u",
    "greek": "\u03c6",
    "byte order mark": "\ufeffx",
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_text_is_an_input_error_with_a_short_message(text):
    with pytest.raises(InputError, match="cannot read the term") as caught:
        term(text)
    assert len(str(caught.value)) < 300


def test_a_letter_that_python_takes_for_another_names_nothing():
    assert term("sin(x)").text == "sin(x)"
    for text in ("sin(\U0001d431)", "\u017fin(x)", "sin(\uff58)"):
        with pytest.raises(InputError, match="ASCII"):
            term(text)


def test_numbers_that_multiply_beyond_all_bounds_do_not_become_names():
    # repr(float("inf")) is a plain identifier.
    with pytest.raises(InputError, match="a number in it is too large"):
        parse_term("sin(1e100*1e100*1e100*1e100*x)", Scope.of(["x", "inf"]))


@pytest.mark.parametrize("levels", [5, 9])
def test_products_with_sums_cannot_grow_without_bound(levels):
    # Each level repeats all within it once for each part of its sum: 8 levels made 56 million characters of 322.
    text = "sin(x)"
    for level in range(levels):
        parts = ["x", "u", "phi", "phi_dot", "x*u", "x*phi", "u*phi", "cos(x)", "cos(u)", "cos(phi)"][: 2 + level]
        text = f"sin({text}*({'+'.join(parts)}))"
    assert len(text) < MAXIMUM_LENGTH
    with pytest.raises(InputError, match="written out"):
        term(text)


def test_limits_are_where_they_say():
    deepest = MAXIMUM_DEPTH - 1
    assert term("sin(" * deepest + "x" + ")" * deepest).names == {"x"}
    assert term("x" + " " * (MAXIMUM_LENGTH - 1)).text == "x"
    with pytest.raises(InputError, match=f"{MAXIMUM_LENGTH + 1} characters"):
        term("x" + " " * MAXIMUM_LENGTH)
    with pytest.raises(InputError, match="nested deeper than"):
        term("-" * (MAXIMUM_DEPTH + 1) + "x")


@pytest.mark.parametrize(
    ("text", "hint"), [("phi_dt", "phi_dot"), ("sine(phi)", "sin"), ("sin(pih)", "phi"), ("drg(x)", "drag")]
)
def test_an_unknown_name_is_answered_with_the_nearest(text, hint):
    with pytest.raises(InputError, match=f"did you mean '{hint}'"):
        term(text, Definition("drag", ("v",), "abs(v)*v"))


# functions of one's own

DRAG = Definition("drag", ("v",), "abs(v)*v")
SPRING = Definition("spring", ("a", "b"), "(a - b)**3*exp(-2*(a - b)**2)")
MIXED = Definition("mixed", ("a", "b"), "a*sin(b) - 0.5*b + 2")


@pytest.mark.parametrize(
    ("text", "spelled"),
    [
        ("drag(x)", "abs(x)*x"),
        ("drag(x - 2*u)", "abs(x - 2*u)*(x - 2*u)"),
        ("u*drag(sin(phi))**2", "u*(abs(sin(phi))*sin(phi))**2"),
        ("drag(drag(x))", "abs(abs(x)*x)*(abs(x)*x)"),
        ("spring(x, u)", "(x - u)**3*exp(-2*(x - u)**2)"),
        ("spring(x, 0.25)", "(x - 0.25)**3*exp(-2*(x - 0.25)**2)"),
        ("mixed(x, phi)", "x*sin(phi) - 0.5*phi + 2"),
        ("mixed(x - u, phi*u)**2", "((x - u)*sin(phi*u) - 0.5*phi*u + 2)**2"),
        ("sin(mixed(x, phi) + x)", "sin(x*sin(phi) - 0.5*phi + 2 + x)"),
        ("cos(spring(2*x, 0.5*u) - x)", "cos((2*x - 0.5*u)**3*exp(-2*(2*x - 0.5*u)**2) - x)"),
    ],
)
def test_a_definition_stands_for_its_body(text, spelled):
    t = term(text, DRAG, SPRING, MIXED)
    x = columns(np.random.default_rng(5), 9, -1.0, 1.0)
    np.testing.assert_allclose(valued(t, x), values(spelled, x), rtol=1e-12, atol=1e-14)
    assert term(t.text) == t


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("v**16", "f(x**16)"),
        ("v**16", "f(1e100*x)"),
        ("v**0.5", "f(x**2)"),
        ("v**0.5", "sin(f(-x))"),
        ("abs(v)*v", "f(0*x)"),
        ("abs(v)*v", "sin(f(2)*x)"),
        ("abs(v)*v", "f(x, u)"),
        ("abs(v)*v", "f()"),
        ("abs(v)*x", "f(u)"),
        ("f(v)", "f(x)"),
        ("v.real", "f(x)"),
        ("lambda: v", "f(x)"),
        ("9**9**9*v", "f(x)"),
        ("(" * 3000 + "v" + ")" * 3000, "f(x)"),
        ("v - v", "f(x)"),
        ("1/v", "f(x - x)"),
        ("\U0001d42f", "f(x)"),
    ],
)
def test_a_definition_opens_no_way_round_the_limits(body, text):
    with pytest.raises(InputError, match="cannot read"):
        term(text, Definition("f", ("v",), body))


def test_definitions_within_definitions_cannot_grow_without_bound():
    body = "*".join(f"{f}({k}*v)" for f in ("sin", "cos") for k in range(2, 11))
    with pytest.raises(InputError, match="written out"):
        term("f(" * 15 + "x" + ")" * 15, Definition("f", ("v",), body))


@pytest.mark.parametrize("name", ["sin", "identity", "x"])
def test_a_definition_takes_no_name_that_is_taken(name):
    with pytest.raises(InputError, match="taken"):
        Scope.of(NAMES, [Definition(name, ("v",), "v")])


def test_the_constant_is_the_empty_product():
    assert parse_term("1", SCOPE) == ONE
    assert parse_term("x**2/x**2", SCOPE) == ONE


def test_a_name_that_is_not_known_may_be_an_input_or_a_constant():
    scope = Scope.of(("phi", "phi_dot"), (), ())
    with pytest.raises(InputError, match=r"--input torque or \[inputs.torque\] in a study; if it is a constant"):
        parse_term("phi*torque", scope)
    with pytest.raises(InputError, match=r"'torque'; there are: phi, phi_dot$"):
        parse_term("phi*torque", Scope.of(("phi", "phi_dot")))
