"""A second reader of term texts, for tests: Python's own operators on whatever values and functions it is given."""

import ast
import operator

import numpy as np
import sympy
from hypothesis import settings
from hypothesis import strategies as st

from odescope.library.functions import FUNCTIONS
from odescope.library.parse import Scope
from odescope.library.tape import evaluate, write_tape

NAMES = ("phi", "phi_dot", "u", "x")
SCOPE = Scope.of(NAMES)
SYMBOLS = {name: sympy.Symbol(name, real=True) for name in NAMES}
NUMPY = {f: getattr(np, f) for f in FUNCTIONS}
SYMPY = {f: getattr(sympy, {"abs": "Abs"}.get(f, f.replace("arc", "a"))) for f in FUNCTIONS}

_BINARY = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def read(text, names, functions):
    def walk(node):
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name):
            return names[node.id]
        if isinstance(node, ast.UnaryOp):
            return -walk(node.operand)
        if isinstance(node, ast.BinOp):
            return _BINARY[type(node.op)](walk(node.left), walk(node.right))
        return functions[node.func.id](*map(walk, node.args))

    return walk(ast.parse(text, mode="eval").body)


def values(text, columns):
    """The values of a text over columns (names, N) by numpy."""
    with np.errstate(all="ignore"):
        return read(text, dict(zip(NAMES, columns, strict=True)), NUMPY) * np.ones(columns.shape[1])


def derivative(text, name, columns):
    """The values of the derivative over columns (names, N) by sympy."""
    slope = sympy.sympify(read(text, SYMBOLS, SYMPY)).diff(SYMBOLS[name])
    with np.errstate(all="ignore"):
        found = sympy.lambdify(list(SYMBOLS.values()), slope, [{"DiracDelta": np.zeros_like}, "numpy"])(*columns)
    return found * np.ones(columns.shape[1])


def steady(expression, columns):
    """Where the values of an expression are finite and do not hang on the last digits of the columns, (N,)."""
    tape = write_tape(NAMES, [expression])
    moved = columns * (1.0 + 1e-13 * np.array([[1.0], [-0.7], [0.4], [-1.3]]))
    here, there = evaluate(tape, columns)[0], evaluate(tape, moved)[0]
    with np.errstate(invalid="ignore"):
        return np.isfinite(here) & (np.abs(here - there) <= 1e-10 * np.abs(here))


def columns(rng, samples, low=0.3, high=0.9):
    return rng.uniform(low, high, (len(NAMES), samples))


# The same examples every time: a rounding error must not fail a build at random.
repeatable = settings(derandomize=True, deadline=None, max_examples=60)

_name = st.sampled_from(NAMES)
_coefficient = st.sampled_from(["", "2*", "0.5*", "1.7*", "0.1*"])


@st.composite
def _sums(draw, inner):
    parts = draw(st.lists(st.tuples(_coefficient, inner), min_size=1, max_size=3))
    constant = draw(st.sampled_from(["", "", " + 1", " + 0.25"]))
    return " + ".join(c + t for c, t in parts) + constant


@st.composite
def _factors(draw, inner):
    base = draw(
        st.one_of(
            inner.map("({})".format),
            st.builds("{}({})".format, st.sampled_from(sorted(NUMPY)), _sums(inner)),
            st.builds("({})".format, _sums(inner)),
        )
    )
    return base + draw(st.sampled_from(["", "", "", "**2", "**3", "**-1", "**-2"]))


_simple = st.lists(_factors(_name), min_size=1, max_size=3).map("*".join)

# Texts of one term or of a number times one; every sum in them is positive where all names are.
texts = st.lists(_factors(st.one_of(_name, _name, _simple)), min_size=1, max_size=4).map("*".join)
