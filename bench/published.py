"""Systems that others have published as benchmarks, written down as facts in bench/chaotic.txt and bench/odebench.txt.

A right-hand side is a sum of products, or a quotient of two such sums: from that both its values and the terms of its
relation are read.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from truths import multiplied_out

from odescope.errors import InputError
from odescope.library.parse import Scope, parse_term
from odescope.model.model import Model
from odescope.model.relation import Relation

HERE = Path(__file__).parent
SECONDS = 10.0  # of a run of ODEBench
NAMES = ("x", "y", "z", "w", "v", "s")
Key = tuple[bool, str]  # whether the term multiplies the target, and its text without constants inside functions

_BINARY: dict[type[ast.operator], Callable] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


@dataclass(frozen=True)
class System:
    """A system: the texts of its right-hand sides, states to start from, and the span that is recorded, in seconds.

    For a chaotic system the span is its dominant period.
    """

    name: str
    title: str
    states: tuple[str, ...]
    rates: tuple[str, ...]
    starts: tuple[tuple[float, ...], ...]
    span: float
    order: int = 1

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The states that are measured."""
        return self.states[: len(self.states) // self.order]

    @cached_property
    def rate(self) -> Callable[[float, np.ndarray], list[float]]:
        """The right-hand side as solve_ivp calls it."""
        found = [_compiled(ast.parse(text, mode="eval").body, self.states) for text in self.rates]
        return lambda _, state: [f(state) for f in found]

    @cached_property
    def laws(self) -> tuple[dict[Key, float], ...]:
        """The coefficients of every relation: sum of coefficient * term * (target or 1) = 0, the bare target's 1.

        Every right-hand side that is a quotient has 1 in its denominator, unless the denominator is one term.
        """
        return tuple(_law(text, Scope.of(self.states)) for text in self.rates[-len(self.coordinates) :])

    @property
    def from_positions(self) -> System | None:
        """The same system with equations of order 2, where the rates of half of its states are the other half."""
        half = len(self.states) // 2
        if len(self.states) % 2 or self.rates[:half] != self.states[half:]:
            return None
        rates = tuple(f"{name}_dot" for name in self.states[:half])
        renamed = dict(zip(self.states[half:], rates, strict=True))
        written = tuple(re.sub(r"\b[a-z]\b", lambda m: renamed.get(m[0], m[0]), text) for text in self.rates)
        return replace(self, states=self.states[:half] + rates, rates=written, order=2)


def _compiled(node: ast.expr, names: Sequence[str]) -> Callable[[np.ndarray], float]:
    """Return an expression as nested functions of the state."""
    match node:
        case ast.Constant(value=int() | float() as value):
            return lambda _: value
        case ast.Name(id=name):
            k = names.index(name)
            return lambda state: state[k]
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            f = _compiled(inner, names)
            return lambda state: -f(state)
        case ast.BinOp(left=left, op=op, right=right):
            f, g, combine = _compiled(left, names), _compiled(right, names), _BINARY[type(op)]
            return lambda state: combine(f(state), g(state))
        case ast.Call(func=ast.Name(id=name), args=[inner]):
            f, function = _compiled(inner, names), getattr(np, name)
            return lambda state: function(f(state))
    raise ValueError(f"{ast.unparse(node)!r} is not in the tables' language")


def _summands(node: ast.expr, sign: float = 1.0) -> list[tuple[float, ast.expr]]:
    match node:
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            return _summands(left, sign) + _summands(right, -sign if isinstance(op, ast.Sub) else sign)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return _summands(inner, -sign)
    return [(sign, node)]


def _split(node: ast.expr) -> tuple[float, str]:
    """Return coefficient and the rest of a product; unary minus binds its first factor."""
    match node:
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            c, rest = _split(left)
            return c, ast.unparse(right) if rest == "1" else f"{rest}*{ast.unparse(right)}"
        case ast.Constant(value=value):
            return float(value), "1"
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            c, rest = _split(inner)
            return -c, rest
    return 1.0, ast.unparse(node)


def skeleton(text: str) -> str:
    """Return the text of a term, its constants inside functions replaced by a sign that stands for any."""
    return (
        re.sub(r"(?<![\w.*])-?\d+\.?\d*(?:e-?\d+)?\*", "#*", re.sub(r"\(-(?=[a-z])", "(-1*", text))
        if "(" in text
        else text
    )


def _canonical(text: str, scope: Scope) -> str:
    try:
        return skeleton(parse_term(text, scope).text)
    except InputError:  # a power that no library has, say
        return text


def _law(text: str, scope: Scope) -> dict[Key, float]:
    whole = ast.parse(text, mode="eval").body
    quotient = isinstance(whole, ast.BinOp) and isinstance(whole.op, ast.Div)
    above, below = (whole.left, whole.right) if quotient else (whole, ast.Constant(1))
    found: dict[Key, float] = {}
    for target, side, sign in ((True, below, 1.0), (False, above, -1.0)):
        for s, product in _summands(side, sign):
            c, rest = _split(product)
            found[target, _canonical(rest, scope)] = s * c
    return found


def law_of(relation: Relation) -> dict[tuple[str | None, str], float]:
    """Return the coefficients of a relation, by factor and text."""
    return {(t.factor, skeleton(t.term.text)): t.coefficient for t in relation.terms}


@dataclass(frozen=True)
class Comparison:
    """What a model has that the system has not, and the reverse, by target; relative errors where nothing."""

    failures: dict[str, str]
    errors: dict[str, float]

    @property
    def exact(self) -> bool:
        """Whether every relation has the right terms and no other."""
        return not any(self.failures.values())


def compared(system: System, model: Model) -> Comparison:
    """Compare a model's relations with the system's, term by term, as they are and multiplied out."""
    failures, errors = dict[str, str](), dict[str, float]()
    for target, law, relation in zip(model.targets, system.laws, model.relations, strict=True):
        wanted = {(target if with_target else None, text): c for (with_target, text), c in law.items()}
        found, other = law_of(relation), law_of(multiplied_out(relation))
        found = other if wanted.keys() == other.keys() else found
        missing, extra = sorted(map(_shown, wanted.keys() - found)), sorted(map(_shown, found.keys() - wanted))
        failures[target] = f"missing {missing}, extra {extra}" if missing or extra else ""
        if failures[target]:
            continue
        lead = next(k for k in wanted if k[0] is not None and found[k] == 1.0)
        scale = wanted[lead]
        errors |= {f"{target}: {_shown(k)}": abs(found[k] * scale / c - 1.0) for k, c in wanted.items() if k != lead}
    return Comparison(failures, errors)


def _shown(key: tuple[str | None, str]) -> str:
    return key[1] if key[0] is None else key[0] if key[1] == "1" else f"{key[0]}*{key[1]}"


def chaotic() -> dict[str, System]:
    return {
        name: _system(name, name, rates, (_numbers(start),), float(period))
        for name, period, start, rates in _rows("chaotic.txt")
    }


def odebench() -> dict[str, System]:
    return {
        number: _system(number, title, rates, (_numbers(first), _numbers(second)), SECONDS)
        for number, title, rates, first, second in _rows("odebench.txt")
    }


def _system(name: str, title: str, rates: str, starts: tuple[tuple[float, ...], ...], span: float) -> System:
    texts = tuple(rates.split("; "))
    return System(name, title, NAMES[: len(texts)], texts, starts, span)


def _rows(file: str) -> list[list[str]]:
    lines = (HERE / file).read_text(encoding="utf-8").splitlines()
    return [[cell.strip() for cell in line.split("|")] for line in lines if not line.startswith("#")]


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(map(float, text.split()))


def solved(system: System, start: Sequence[float], t: np.ndarray, **options: float | str) -> np.ndarray:
    """Return the states (N, n) of a system from a start, by SciPy."""
    run = solve_ivp(system.rate, (t[0], t[-1]), start, t_eval=t, **options)
    assert run.success, f"{system.name}: {run.message}"
    return run.y.T
