"""Mechanisms as people read them: energies, forces and reactions with standard errors, in text, LaTeX and MathML."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from html import escape

from odescope.errors import InputError
from odescope.library.expression import ONE, Term
from odescope.library.latex import LATEX, latex_joined, latex_name, latex_number
from odescope.library.mathml import MATHML, TIMES, mathml_joined, mathml_name, mathml_number
from odescope.library.mechanism import FORCE_ON, Kind
from odescope.library.parse import Scope, parse_term
from odescope.library.printer import print_term
from odescope.model.relation import FoundMechanism, RelationTerm
from odescope.model.rounding import rounded

HEADINGS: dict[Kind, str] = {
    "kinetic": "kinetic energy T",
    "potential": "potential energy V",
    "dissipation": "dissipation function R",
    "force": "forces",
    "reaction": "reactions",
    "tie": "ties",
}
_SIGNS: dict[Kind, str] = {"kinetic": "T", "potential": "V", "dissipation": "R"}
_WORDS = re.compile(r"[A-Za-z_]\w*|\d+|\S", re.ASCII)


def by_kind(mechanisms: Sequence[FoundMechanism]) -> dict[Kind, list[FoundMechanism]]:
    """Return mechanisms by their kinds, energies first."""
    found = {kind: [m for m in mechanisms if m.kind == kind] for kind in HEADINGS}
    return {kind: members for kind, members in found.items() if members}


def mechanisms_text(mechanisms: Sequence[FoundMechanism]) -> list[str]:
    """Return lines of plain text: a heading a kind, and below it a mechanism a line, standard errors after +-."""
    lines = list[str]()
    for kind, members in by_kind(mechanisms).items():
        lines.append(HEADINGS[kind])
        numbers = [rounded(m.coefficient, m.std_error) for m in members]
        sizes = [value + (f" +- {error}" if error else "") for value, error in numbers]
        named, wide = max(len(m.name) for m in members), max(map(len, sizes))
        for m, size in zip(members, sizes, strict=True):
            if kind == "reaction":
                lines.append(f"  {m.name:{named}}  k = {size}, flux {m.term}")
            elif kind == "tie":
                lines.append(f"  {m.name:{named}}  {size:{wide}}  {m.term}")
            else:
                lines.append(f"  {size:{wide}}  {m.name}")
    return lines


def mechanisms_latex(mechanisms: Sequence[FoundMechanism], names: Sequence[str]) -> list[str]:
    """Return lines of LaTeX: an energy a line, and a force or a reaction a line.

    Args:
        mechanisms: of the model.
        names: its states and inputs.
    """
    scope, lines = Scope.of(names, constants=names), list[str]()

    def product(m: FoundMechanism) -> tuple[bool, str]:
        term = read_term(m.term, scope)
        body = r"\mathtt{" + _escaped(m.term) + "}" if term is None else print_term(LATEX, term)
        size = latex_size(m)
        parts = [size] if term == ONE else [body] if size == "1" else [size, body]
        return m.coefficient < 0.0, r" \, ".join(parts)

    for left, members in _sums(mechanisms):
        index = "".join(f"_{{{latex_name(name)}}}" for name in left[1:])
        lines.append(f"{left[0]}{index} = {latex_joined(map(product, members))}")
    for m in mechanisms:
        if m.kind == "reaction":
            rate = ("-" if m.coefficient < 0.0 else "") + latex_size(m, bracketed=False)
            left_side, right_side = (" ".join(_latex_word(w) for w in _WORDS.findall(s)) for s in _sides(m.name))
            lines.append(rf"{left_side} \xrightarrow{{{rate}}} {right_side}".strip())
    return lines


def mechanisms_mathml(mechanisms: Sequence[FoundMechanism], names: Sequence[str], errors: bool = True) -> list[str]:
    """Return formulas in MathML: an energy each, and a force or a reaction each.

    Args:
        mechanisms: of the model.
        names: its states and inputs.
        errors: whether standard errors stand in them.
    """
    scope, formulas = Scope.of(names, constants=names), list[str]()

    def product(m: FoundMechanism) -> tuple[bool, str]:
        size = _mathml_size(m, errors)
        body, one = term_mathml(m.term, scope), read_term(m.term, scope) == ONE
        return m.coefficient < 0.0, size if one else body if size == "<mn>1</mn>" else size + TIMES + body

    for left, members in _sums(mechanisms):
        head = mathml_name(left[0])
        if len(left) > 1:
            head = f"<msub>{head}<mrow>{mathml_name(left[1])}</mrow></msub>"
        formulas.append(f"{head}<mo>=</mo>{mathml_joined(map(product, members))}")
    for m in mechanisms:
        if m.kind == "reaction":
            sign = "<mo>−</mo>" if m.coefficient < 0.0 else ""
            rate = f"<mrow>{sign}{_mathml_size(m, errors, bracketed=False)}</mrow>"
            formulas.append(reaction_mathml(m.name, rate))
    return formulas


def reaction_mathml(name: str, rate: str = "") -> str:
    """Return a reaction in MathML, its rate above the arrow."""
    left, right = ("".join(_mathml_word(w) for w in _WORDS.findall(side)) for side in _sides(name))
    arrow = '<mo stretchy="true">⟶</mo>'
    return f"<mrow>{left}</mrow>{f'<mover>{arrow}{rate}</mover>' if rate else arrow}<mrow>{right}</mrow>"


def term_mathml(text: str, scope: Scope) -> str:
    """Return the term of a mechanism in MathML; one that cannot be read as text."""
    term = read_term(text, scope)
    return f"<mtext>{escape(text)}</mtext>" if term is None else print_term(MATHML, term)


def _sums(mechanisms: Sequence[FoundMechanism]) -> Iterator[tuple[tuple[str, ...], list[FoundMechanism]]]:
    """Yield what is on the left, T or F and the coordinate that it acts on, and the mechanisms that add up to it."""
    for kind, sign in _SIGNS.items():
        if members := [m for m in mechanisms if m.kind == kind]:
            yield (sign,), members
    on = dict.fromkeys(m.name.rpartition(FORCE_ON)[2] for m in mechanisms if m.kind == "force")
    for name in on:
        members = [m for m in mechanisms if m.kind == "force" and m.name.rpartition(FORCE_ON)[2] == name]
        yield ("F", name), members


def read_term(text: str, scope: Scope) -> Term | None:
    """Return the term of a mechanism, None where it cannot be read."""
    try:
        return parse_term(text, scope)
    except InputError:  # of a file that anyone may have written
        return None


def _sides(reaction: str) -> tuple[str, str]:
    left, _, right = reaction.partition("->")
    return left or "∅", right or "∅"


def latex_size(m: FoundMechanism | RelationTerm, bracketed: bool = True) -> str:
    """Return LaTeX of the size of a coefficient with its standard error, where it has one."""
    value, error = rounded(abs(m.coefficient), m.std_error)
    if not error:
        return latex_number(value)
    body = rf"{latex_number(value)} \pm {latex_number(error)}"
    return rf"\left({body}\right)" if bracketed else body


def _mathml_size(m: FoundMechanism, errors: bool, bracketed: bool = True) -> str:
    value, error = rounded(abs(m.coefficient), m.std_error if errors else None)
    if not error:
        return mathml_number(value)
    body = f"{mathml_number(value)}<mo>±</mo>{mathml_number(error)}"
    return f"<mrow><mo>(</mo>{body}<mo>)</mo></mrow>" if bracketed else body


def _latex_word(word: str) -> str:
    if word == "∅":
        return r"\varnothing"
    return latex_name(word) if word[0].isalpha() or word[0] == "_" else _escaped(word)


def _mathml_word(word: str) -> str:
    if word[0].isalpha() or word[0] == "_":
        return mathml_name(word)
    return f"<mn>{word}</mn>" if word.isdigit() else f"<mo>{escape(word)}</mo>"


def _escaped(text: str) -> str:
    return re.sub(r"([\\{}_^%$#&~])", r"\\\1", text)
