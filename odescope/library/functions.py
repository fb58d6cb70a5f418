"""The functions a term may use: one row a function, from which values, derivatives, LaTeX and code all follow."""

from __future__ import annotations

from dataclasses import dataclass

# Instruction codes of the tape (see tape.py). Functions of one argument start at FIRST_FUNCTION.
CONSTANT, ADD, MULTIPLY, SCALE, INTEGER_POWER, REAL_POWER = range(6)
FIRST_FUNCTION = 6


@dataclass(frozen=True, slots=True)
class Function:
    """A function of one argument.

    `derivative` is the sum of products that differentiates it, each a coefficient and powers of functions of the
    same argument; the function "" is the argument itself.
    """

    name: str
    code: int
    latex: str
    derivative: tuple[tuple[float, tuple[tuple[str, int], ...]], ...]


_ROWS: tuple[tuple[str, str, tuple[tuple[float, tuple[tuple[str, int], ...]], ...]], ...] = (
    ("sin", r"\sin", ((1.0, (("cos", 1),)),)),
    ("cos", r"\cos", ((-1.0, (("sin", 1),)),)),
    ("tan", r"\tan", ((1.0, ()), (1.0, (("tan", 2),)))),
    ("exp", r"\exp", ((1.0, (("exp", 1),)),)),
    ("log", r"\log", ((1.0, (("", -1),)),)),
    ("sqrt", r"\sqrt", ((0.5, (("sqrt", -1),)),)),
    ("abs", r"\operatorname{abs}", ((1.0, (("sign", 1),)),)),
    ("sign", r"\operatorname{sign}", ()),
    ("tanh", r"\tanh", ((1.0, ()), (-1.0, (("tanh", 2),)))),
)

FUNCTIONS: dict[str, Function] = {
    name: Function(name, FIRST_FUNCTION + k, latex, derivative) for k, (name, latex, derivative) in enumerate(_ROWS)
}
