"""MathML read back by a small evaluator: an oracle that knows presentation MathML and nothing of odescope."""

from xml.etree import ElementTree

import numpy as np
import pytest
from hand_models import MODELS

from odescope.export.languages.mathml import to_mathml
from odescope.library.mathml import MATHML, math, mathml_name, mathml_number
from odescope.library.parse import Scope, parse_term
from odescope.library.printer import print_term
from odescope.model.display import relation_mathml

SPACE = "{http://www.w3.org/1998/Math/MathML}"
FUNCTIONS = {f: getattr(np, f) for f in ("sin", "cos", "tan", "exp", "log", "abs", "sign", "tanh", "sinh", "cosh")}


def tokens(node):
    """Flatten rows and tables of lines to the list of what they hold."""
    tag = node.tag.removeprefix(SPACE)
    if tag in ("math", "mrow", "mtable", "mtr", "mtd"):
        return [t for child in node for t in tokens(child)]
    return [node]


class Reader:
    def __init__(self, names):
        self.names = names  # markup of a name -> its value

    def row(self, node):
        return self.sum(grouped(self, tokens(node)))

    def sum(self, items):
        total, sign, product, empty = 0.0, 1.0, [], True
        for item in [*items, None]:
            mark = self.operator(item)
            if item is None or mark in ("+", "−"):
                if not empty:
                    total += sign * self.product(product)
                sign, product, empty = (-1.0 if mark == "−" else 1.0), [], True
            else:
                product.append(item)
                empty = False
        return total

    def operator(self, item):
        return None if item is None or isinstance(item, float) or item.tag != f"{SPACE}mo" else item.text

    def product(self, items):
        value, k = 1.0, 0
        while k < len(items):
            mark = self.operator(items[k])
            if mark in ("\u2062", "×"):
                k += 1
            elif k + 1 < len(items) and self.operator(items[k + 1]) == "\u2061":
                inner = items[k + 2]
                value *= self.function(items[k])(inner)
                k += 3
            else:
                value *= self.value(items[k])
                k += 1
        return value

    def function(self, node):
        if node.tag == f"{SPACE}msup":
            base, power = node
            return lambda x: FUNCTIONS[base.text](x) ** self.row(power)
        return FUNCTIONS[node.text]

    def value(self, node):
        if isinstance(node, float):
            return node
        tag = node.tag.removeprefix(SPACE)
        if tag == "mn":
            return float(node.text)
        if markup(node) in self.names:
            return self.names[markup(node)]
        children = list(node)
        if tag == "mfrac":
            return self.row(children[0]) / self.row(children[1])
        if tag == "msqrt":
            return np.sqrt(self.sum(grouped(self, [t for c in children for t in tokens(c)])))
        if tag == "msup":
            return self.row(children[0]) ** self.row(children[1])
        raise AssertionError(f"what is {tag}?")


def markup(node):
    return ElementTree.tostring(node, encoding="unicode").replace(' xmlns:ns0="http://www.w3.org/1998/Math/MathML"', "")


def grouped(reader, items):
    """Put the value of every pair of brackets in its place."""
    out, stack = [], []
    for item in items:
        mark = reader.operator(item)
        if mark == "(":
            stack.append(out)
            out = []
        elif mark == ")":
            value, out = float(reader.sum(out)), stack.pop()
            out.append(value)
        else:
            out.append(item)
    assert not stack
    return out


def reader(values):
    names = {}
    for name, value in values.items():
        node = ElementTree.fromstring(math(mathml_name(name)))[0][0]
        names[markup(node)] = value
    assert len(names) == len(values)  # no two names look the same
    return Reader(names)


@pytest.mark.parametrize("name", MODELS)
def test_the_equations_have_the_value_of_the_model(name):
    model = MODELS[name]
    rng = np.random.default_rng(1)
    for _ in range(5):
        values = dict(zip(model.variables, rng.uniform(0.3, 1.2, len(model.variables)), strict=True))
        scope = FUNCTIONS | {"sqrt": np.sqrt} | values
        a, b = np.zeros((len(model.targets),) * 2), np.zeros(len(model.targets))
        for row, relation in enumerate(model.relations):
            for t in relation.terms:
                worth = t.coefficient * eval(t.term.text, {"__builtins__": {}}, scope)  # noqa: S307 (our own text)
                if t.factor is None:
                    b[row] -= worth
                else:
                    a[row, model.targets.index(t.factor)] += worth
        exact = dict(zip(model.targets, np.linalg.solve(a, b), strict=True))
        reading = reader(values | exact)
        for line, target in zip(to_mathml(model).split("\n"), model.targets, strict=True):
            items = tokens(ElementTree.fromstring(line))
            (equals,) = (k for k, item in enumerate(items) if reading.operator(item) == "=")
            left, right = items[:equals], items[equals + 1 :]
            assert reading.sum(left) == exact[target]
            assert reading.sum(grouped(reading, right)) == pytest.approx(exact[target], rel=1e-4, abs=1e-5)
        for relation in model.relations:
            items = tokens(ElementTree.fromstring(math(relation_mathml(relation))))
            size = sum(abs(t.coefficient) for t in relation.terms)
            assert abs(reading.sum(grouped(reading, items[:-2]))) < 1e-4 * size


TERMS = {
    "sqrt(x)**3*y": lambda x, y: np.sqrt(x) ** 3 * y,
    "cos(x - 2.5*y)**-2": lambda x, y: np.cos(x - 2.5 * y) ** -2,
    "(x + 1.0)**-1*sin(y)**2": lambda x, y: np.sin(y) ** 2 / (x + 1),
    "x**-3*y**0.5": lambda x, y: x**-3.0 * y**0.5,
    "x/sqrt(x + y)**3": lambda x, y: x / np.sqrt(x + y) ** 3,
    "tanh(x/y)/(x*y)": lambda x, y: np.tanh(x / y) / (x * y),
    "exp(-1e-9*x)": lambda x, y: np.exp(-1e-9 * x),
    "1": lambda x, y: 1.0,
}


@pytest.mark.parametrize("text", TERMS)
def test_terms_have_their_value(text):
    term = parse_term(text, Scope.of(["x", "y"]))
    values = {"x": 0.7, "y": 1.3}
    found = reader(values).row(ElementTree.fromstring(math(print_term(MATHML, term))))
    assert found == pytest.approx(TERMS[text](**values), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("phi_ddot", "φ¨"),
        ("phi1_dot", "φ˙1"),
        ("x", "x"),
        ("speed_max", "speedmax"),
        ("x_dddot", "x(3)"),
        ("x_1_dot", "x˙1"),
        ("Position_1_dot", "Position_1_dot"),
        ("vx_dddot", "vx_dddot"),
        ("Omega", "Ω"),
    ],
)
def test_names(name, shown):
    assert "".join(ElementTree.fromstring(math(mathml_name(name))).itertext()) == shown


def test_every_letter_of_the_greek_alphabet_has_a_sign():
    from odescope.library import names

    for letter in names._GREEK:
        (sign,) = "".join(ElementTree.fromstring(math(mathml_name(letter))).itertext())
        assert "\u0391" <= sign <= "\u03c9"


def test_numbers():
    assert mathml_number("0.3") == "<mn>0.3</mn>"
    assert "".join(ElementTree.fromstring(math(mathml_number("1.25e-17"))).itertext()) == "1.25×10−17"


def test_a_long_sum_goes_over_lines_and_a_short_one_does_not():
    first, second = to_mathml(MODELS["rational"]).split("\n")
    assert "<mtable" in first + second
    assert "<mtable" not in math(print_term(MATHML, parse_term("x*y", Scope.of(["x", "y"]))))
