"""The functions of one argument that a term may use: a row and a compiled branch each, and all else follows.

To add one, write its row in `_ROWS` and its branch in `call`, with the same code. Values, derivatives, LaTeX, MathML,
code and units read the row; library evaluation, simulation and likelihood run the branch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from odescope.parallel.kernels import kernel


@dataclass(frozen=True, slots=True)
class Function:
    """A function of one argument, z.

    Attributes:
        name: in the text of a term; NumPy has it by the same name.
        code: of its branch in `call`; the instructions of the tape have the codes below it (see tape.py).
        derivative: with respect to z, in the syntax of terms: an expression of z.
        latex: command that writes the name.
        unit_power: of the argument's unit that the value carries; 0 for a function whose values are numbers.
    """

    name: str
    code: int
    derivative: str
    latex: str
    unit_power: float = 0.0


_ROWS = (
    Function("sin", 6, "cos(z)", r"\sin"),
    Function("cos", 7, "-sin(z)", r"\cos"),
    Function("tan", 8, "1 + tan(z)**2", r"\tan"),
    Function("exp", 9, "exp(z)", r"\exp"),
    Function("log", 10, "1/z", r"\log"),
    Function("sqrt", 11, "0.5/sqrt(z)", r"\sqrt", unit_power=0.5),
    Function("abs", 12, "sign(z)", r"\operatorname{abs}", unit_power=1.0),
    Function("sign", 13, "0", r"\operatorname{sign}"),
    Function("tanh", 14, "1 - tanh(z)**2", r"\tanh"),
    Function("sinh", 15, "cosh(z)", r"\sinh"),
    Function("cosh", 16, "sinh(z)", r"\cosh"),
)


@kernel()
def call(code: int, z: float) -> float:
    """Return the value at z of the function with this code; NaN outside its domain, and where no branch has the code.

    It raises nothing: kernels that might be left in the middle of a tape are six times slower.
    """
    if code == 6:
        return np.sin(z)
    if code == 7:
        return np.cos(z)
    if code == 8:
        return np.tan(z)
    if code == 9:
        return np.exp(z)
    if code == 10:
        return np.log(z) if z >= 0.0 else np.nan
    if code == 11:
        return np.sqrt(z) if z >= 0.0 else np.nan
    if code == 12:
        return abs(z)
    if code == 13:
        return np.sign(z)
    if code == 14:
        return np.tanh(z)
    if code == 15:
        return np.sinh(z)
    if code == 16:
        return np.cosh(z)
    return np.nan


FUNCTIONS: dict[str, Function] = {row.name: row for row in _ROWS}


def code_of(name: str) -> int:
    """Return the code of a function, for whoever writes a tape.

    Raises:
        ValueError: the function's row has no branch in `call`.
    """
    row = FUNCTIONS[name]
    if not _has_branch(row.code):
        raise ValueError(f"the function {name} has a row but no branch in library/functions.py: write the branch")
    return row.code


@cache
def _has_branch(code: int) -> bool:
    """Say whether `call` has a value somewhere; functions of one argument have one near zero or further out."""
    sizes = np.geomspace(1e-3, 1e3, 13)
    return any(call(code, z) == call(code, z) for z in (*sizes, *-sizes))  # NaN is no number's equal
