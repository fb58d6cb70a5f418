"""Ties: linear equalities between coefficients, which merge mechanisms or give a coefficient its value."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from odescope.errors import InputError, nearest
from odescope.library.mechanism import Mechanism, Part, merged
from odescope.library.parse import MAXIMUM_LENGTH, Scope, parse_combination, parse_term
from odescope.library.product import Product

CANCELLED = 1e-13  # of what a share is the sum of: what is left is rounding
EQUAL = 1e-12  # relative difference of two numbers that are the same but for rounding

_PLACE = re.compile(r"(?P<what>.+?)\s+in\s+(?P<place>[A-Za-z_]\w*(?: on \w+)?)", re.ASCII | re.DOTALL)
_FACTOR = re.compile(r"(?P<factor>[+-]?\s*[\d.]+(?:[eE][+-]?\d+)?)\s*\*(?!\*)\s*(?P<what>.+)", re.ASCII | re.DOTALL)
_SIGN = re.compile(r"(?P<factor>[+-])\s*(?P<what>[^>].*)", re.ASCII | re.DOTALL)


@dataclass(frozen=True)
class _Tie:
    """coefficient of `first` = factor * coefficient of `second`, as `text` says."""

    first: int
    second: int
    factor: float
    text: str


@dataclass(frozen=True)
class _Value:
    """coefficient of `first` = value, as `text` says."""

    first: int
    value: float
    text: str


def tied(mechanisms: Sequence[Mechanism], ties: Sequence[str], scope: Scope) -> tuple[Mechanism, ...]:
    """Return the mechanisms with the equalities between their coefficients built in.

    "a = b", "a = -2*b" and "2*a = 3*b" merge two mechanisms into one of kind tie, whose coefficient is that of b;
    "a = 0.5" gives a coefficient its value. A mechanism is called by its name, in parentheses or quotes where that
    helps, or by its term, and the constant term on the right is (1). "a in x_ddot" is the one of that place; without a
    place a tie holds in every place with both, and between places only where each side names one mechanism.

    Coefficients are those of sum of coefficient * parts = 0. That of a plain candidate which is given a value is
    relative to its bare target, which thereby becomes known to be 1. So do both bare targets where a tie is between
    candidates without a target in two relations, which would else only say how one is scaled to the other.

    Args:
        mechanisms: all candidates.
        ties: texts, which are never evaluated.
        scope: what terms may name, targets included.

    Raises:
        InputError: a tie cannot be read, names no mechanism or several, contradicts what is known, or leaves only zero.
    """
    if not ties:
        return tuple(mechanisms)
    index = _Index.of(mechanisms, scope)
    stated = [statement for text in ties for statement in _statements(text, index)]
    bonds = [s for s in stated if isinstance(s, _Tie)]
    values = [_Value(k, m.known, "") for k, m in enumerate(mechanisms) if m.known is not None]
    for statement in stated:
        if isinstance(statement, _Value):
            values += [statement, *_scale(statement, mechanisms)]
    found, seen = list[Mechanism](), set[int]()
    for k in range(len(mechanisms)):
        if k not in seen:
            members = _group(k, bonds)
            seen |= members.keys()
            found.append(_together(members, mechanisms, bonds, values))
    return tuple(_bare_held(found))


def _bare_held(found: Sequence[Mechanism]) -> list[Mechanism]:
    """Return the mechanisms with the bare targets known to be 1 in relations that a tie without a target joins."""
    joined = {
        p.relation
        for m in found
        if m.kind == "tie" and len(m.relations) > 1 and all(p.product.factor is None for p in m.parts)
        for p in m.parts
    }
    return [
        replace(m, known=1.0)
        if m.kind == "term" and m.known is None and m.relations <= joined and m.parts[0].product == Product(m.place)
        else m
        for m in found
    ]


@dataclass(frozen=True)
class _Index:
    """Which mechanisms a text may mean."""

    mechanisms: Sequence[Mechanism]
    scope: Scope
    names: Mapping[str, list[int]]
    terms: Mapping[str, list[int]]

    @staticmethod
    def of(mechanisms: Sequence[Mechanism], scope: Scope) -> _Index:
        names, terms = dict[str, list[int]](), dict[str, list[int]]()
        for k, m in enumerate(mechanisms):
            if m.name:
                names.setdefault(_dense(m.name), []).append(k)
            for key in {_dense(m.term), _canonical(m.term, scope)}:
                terms.setdefault(key, []).append(k)
        return _Index(mechanisms, scope, names, terms)

    def find(self, text: str, tie: str) -> tuple[float, list[int]]:
        """Return the factor on one side of a tie, and the mechanisms that it stands before."""
        for factor, what in _readings(text):
            if factor == 0.0:
                raise _nothing(text, tie)
            for known in (self.names, self.terms):
                if _dense(what) in known:
                    return factor, known[_dense(what)]
        try:
            combination = parse_combination(_unwrapped(text, "\"'"), self.scope)
        except InputError:
            raise self.unknown(text, tie) from None
        if not combination.parts:
            raise _nothing(text, tie)
        if len(combination.parts) > 1:
            raise _unreadable(tie)
        ((factor, term),) = combination.parts
        if term.text not in self.terms:
            raise self.unknown(term.text, tie)
        return factor, self.terms[term.text]

    def unknown(self, text: str, tie: str) -> InputError:
        what = [what for _, what in _readings(text)][-1]
        known = dict.fromkeys(name for m in self.mechanisms for name in (m.name, m.term) if name)
        return InputError(f"the tie {tie!r} names {what!r}, which is no candidate; {nearest(what, known)}")

    def label(self, k: int) -> str:
        m = self.mechanisms[k]
        return repr(m.name or str(m))


def _unreadable(tie: str) -> InputError:
    shown = tie if len(tie) <= 60 else tie[:57] + "..."
    return InputError(
        f"cannot read the tie {shown!r}: expected a candidate, one '=', and a candidate, a number times a candidate or"
        " a number, such as 'a = -2*b' or 'a = 0.5'; the constant term on the right is (1)"
    )


def _nothing(side: str, tie: str) -> InputError:
    return InputError(f"the tie {tie!r} leaves only zero: {side!r} is zero; leave the candidate out instead")


def _dense(text: str) -> str:
    return "".join(text.split())


def _unwrapped(text: str, marks: str = "\"'(") -> str:
    """Return a text without the quotes or parentheses at its ends."""
    closing = {"(": ")"}.get(text[:1], text[:1])
    wrapped = len(text) > 2 and text[0] in marks and text[-1] == closing
    return text[1:-1].strip() if wrapped else text


def _canonical(text: str, scope: Scope) -> str:
    try:
        return parse_term(text, scope).text
    except InputError:
        return _dense(text)  # what is called in another language than that of terms


def _readings(text: str) -> list[tuple[float, str]]:
    """Return a text as one name, and where it can be as a number times a name."""
    found = [(1.0, _unwrapped(text))]
    for match in (_FACTOR.fullmatch(text), _SIGN.fullmatch(text)):
        if match is None:
            continue
        factor = _dense(match["factor"])
        value = _number(factor + "1" if factor in "+-" else factor)
        if value is not None:
            found.append((value, _unwrapped(match["what"].strip())))
    return found


def _number(text: str) -> float | None:
    """Return the number that a text spells out, None where it is none; (1) is the constant term."""
    if "(" in text or "'" in text or '"' in text:
        return None
    try:
        parts = parse_combination(text, Scope(frozenset(), {})).parts
    except InputError:
        return None
    return sum((value for value, _ in parts), 0.0)


def _statements(text: str, index: _Index) -> list[_Tie | _Value]:
    """Return what one tie says of coefficients."""
    sides = [side.strip() for side in text.split("=")]
    if len(text) > MAXIMUM_LENGTH or len(sides) != 2 or not all(sides):
        raise _unreadable(text)
    value = _number(sides[1])
    if _number(sides[0]) not in (None, 1.0):
        raise _unreadable(text)
    ours, first = _named(sides[0], text, index)
    if value is not None:
        if value == 0.0:
            raise _nothing(sides[1], text)
        if len(first) > 1:
            raise InputError(
                f"the tie {text!r} may mean several: {', '.join(map(index.label, first.values()))}; say which, such as"
                f" '{sides[0]} in {next(iter(first))} = {sides[1]}'"
            )
        return [_Value(k, value / ours, text) for k in first.values()]
    theirs, second = _named(sides[1], text, index)
    shared = [(first[place], second[place]) for place in first if place in second]
    if not shared:
        if len(first) > 1 or len(second) > 1:
            left, right = (", ".join(map(index.label, side.values())) for side in (first, second))
            raise InputError(
                f"the tie {text!r} may mean several: no place has both sides, the first is {left} and the second"
                f" {right}; say which, such as 'a in {next(iter(first))} = b in {next(iter(second))}'"
            )
        shared = [(next(iter(first.values())), next(iter(second.values())))]
    factor = theirs / ours
    for a, b in shared:
        if a == b:
            so = "says nothing: both sides are" if factor == 1.0 else "leaves only zero for"
            raise InputError(f"the tie {text!r} {so} {index.label(a)}")
    return [_Tie(a, b, factor, text) for a, b in shared]


def _named(side: str, tie: str, index: _Index) -> tuple[float, dict[str, int]]:
    """Return the factor on one side of a tie, and the mechanism meant in every place that has one."""
    match = _PLACE.fullmatch(side)
    what, place = (match["what"], match["place"]) if match else (side, None)
    factor, found = index.find(what, tie)
    places = dict[str, list[int]]()
    for k in found:
        places.setdefault(index.mechanisms[k].place, []).append(k)
    if place is not None:
        if place not in places:
            raise InputError(f"the tie {tie!r} names {what!r} in {place!r}, where it is not: {nearest(place, places)}")
        places = {place: places[place]}
    for several in places.values():
        if len(several) > 1:
            meant = " or ".join(map(index.label, several))
            raise InputError(f"the tie {tie!r} names {what!r}, which may mean {meant}: say which")
    return factor, {where: k for where, (k,) in places.items()}


def _scale(given: _Value, mechanisms: Sequence[Mechanism]) -> list[_Value]:
    """Return that the bare target is 1 to which the given coefficient of a plain candidate is relative."""
    m = mechanisms[given.first]
    if m.kind != "term":
        return []
    bare = [
        k
        for k, other in enumerate(mechanisms)
        if any(p.product == Product(m.place) and p.relation in m.relations for p in other.parts)
    ]
    if not bare:
        raise InputError(
            f"the tie {given.text!r} gives a coefficient relative to that of {m.place}, which is not among the"
            f" candidates of its relation; add {m.place} to them"
        )
    return [_Value(k, 1.0, given.text) for k in bare]


def _group(start: int, bonds: Sequence[_Tie]) -> dict[int, float]:
    """Return all mechanisms tied to one, and what their coefficients are over that of the leading one.

    Leading is one that stands on no left side: the others are said in terms of it.
    """
    members = _reached(start, bonds)
    inside = [b for b in bonds if b.first in members]
    if not inside:
        return members
    lefts = {b.first for b in inside}
    lead = next((b.second for b in inside if b.second not in lefts), inside[0].second)
    ratios = _reached(lead, inside)
    for b in inside:
        if not math.isclose(ratios[b.first], b.factor * ratios[b.second], rel_tol=EQUAL):
            said = " and ".join(map(repr, _texts(inside)))
            raise InputError(f"the ties {said} together leave only zero; correct one of them")
    return ratios


def _reached(start: int, bonds: Sequence[_Tie]) -> dict[int, float]:
    ratios, pending = {start: 1.0}, [start]
    while pending:
        k = pending.pop()
        for b in bonds:
            for here, there, ratio in ((b.second, b.first, b.factor), (b.first, b.second, 1.0 / b.factor)):
                if here == k and there not in ratios:
                    ratios[there] = ratio * ratios[k]
                    pending.append(there)
    return ratios


def _texts(statements: Sequence[_Tie | _Value]) -> list[str]:
    return list(dict.fromkeys(s.text for s in statements if s.text))


def _together(
    ratios: Mapping[int, float], mechanisms: Sequence[Mechanism], bonds: Sequence[_Tie], values: Sequence[_Value]
) -> Mechanism:
    """Return one mechanism for those that are tied, with its coefficient where it is given."""
    inside = [b for b in bonds if b.first in ratios]
    known: float | None = None
    for given in [v for v in values if v.first in ratios]:
        value = given.value / ratios[given.first]
        if known is not None and not math.isclose(value, known, rel_tol=EQUAL):
            m, other = mechanisms[given.first], known * ratios[given.first]
            said = " and ".join(map(repr, _texts([*(v for v in values if v.first in ratios), *inside])))
            raise InputError(
                f"the coefficient of {m.name or str(m)!r} cannot be both {other:g} and {given.value:g}, as {said} with"
                " what is known would have it"
            )
        known = value
    lead = mechanisms[next(iter(ratios))]
    if len(ratios) == 1:
        return replace(lead, known=known)
    parts = _sum([replace(p, share=r * p.share) for k, r in ratios.items() for p in mechanisms[k].parts])
    texts = _texts(inside)
    if not parts:
        raise InputError(f"{' and '.join(map(repr, texts))} leaves only zero: all that is tied cancels")
    size = min(mechanisms[k].size for k in ratios)
    return Mechanism("tie", lead.term, lead.place, parts, size, name="; ".join(texts), known=known)


def _sum(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Return the parts added up, without those of which only rounding is left."""
    sizes = {(p.relation, p.product): p.share for p in merged(replace(p, share=abs(p.share)) for p in parts)}
    return tuple(p for p in merged(parts) if abs(p.share) > CANCELLED * sizes[p.relation, p.product])
