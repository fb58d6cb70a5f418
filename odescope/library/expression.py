"""Terms: products of powers of functions of states and inputs, the one truth behind all that is said of them.

Their values come from the tape, their derivatives from `derivative`, what is printed of them from `printer`.

A term is a product of atoms raised to powers; an atom is a name (`phi_dot`), a function of a linear combination of
terms (`sin(phi1 - phi2)`), or such a combination itself (`(x - 3.0)**1`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

Power = int | float
MANY_DIGITS, FEW_DIGITS = 10, 7  # characters: 0.0123 is written instead of 81.30081300813008


@dataclass(frozen=True)
class Name:
    """A state, target or input."""

    name: str

    def __hash__(self) -> int:
        return hash(self.text)

    @cached_property
    def text(self) -> str:
        """The name itself."""
        return self.name


@dataclass(frozen=True)
class Call:
    """A function of a linear combination of terms; the function "" is the combination itself."""

    function: str
    argument: Combination

    def __hash__(self) -> int:
        return hash(self.text)

    @cached_property
    def text(self) -> str:
        """Python syntax."""
        return f"{self.function}({signed_sum(((c, t.text) for c, t in self.argument.parts), inverse=True)})"


Atom = Name | Call


@dataclass(frozen=True)
class Term:
    """A product of atoms raised to powers, in canonical order: equal products are equal objects."""

    factors: tuple[tuple[Atom, Power], ...] = ()

    def __hash__(self) -> int:
        return hash(self.text)

    @staticmethod
    def of(factors: Iterable[tuple[Atom, Power]]) -> Term:
        """Return the canonical product: powers of equal atoms added, factors sorted, names first."""
        powers: dict[Atom, Power] = {}
        for atom, power in factors:
            powers[atom] = powers.get(atom, 0) + power
        kept = [(atom, _whole(power)) for atom, power in powers.items() if power != 0]
        return Term(tuple(sorted(kept, key=lambda f: (isinstance(f[0], Call), f[0].text))))

    @cached_property
    def text(self) -> str:
        """Python syntax, "1" for the empty product."""
        return "*".join(_power_text(atom, power) for atom, power in self.factors) or "1"

    def __str__(self) -> str:
        return self.text

    def __mul__(self, other: Term) -> Term:
        return Term.of((*self.factors, *other.factors))

    @cached_property
    def names(self) -> frozenset[str]:
        """The states, targets and inputs that appear."""
        found: set[str] = set()
        for atom, _ in self.factors:
            found |= {atom.name} if isinstance(atom, Name) else atom.argument.names
        return frozenset(found)

    @property
    def inverse(self) -> Term:
        """One over the term."""
        return Term(tuple((atom, -power) for atom, power in self.factors))

    def over(self, atom: Atom) -> Term:
        """Return the product divided by an atom."""
        return Term.of((*self.factors, (atom, -1)))

    def power_of(self, atom: Atom) -> Power:
        """Return the power of `atom` in this product, 0 where it is absent."""
        return self._powers.get(atom, 0)

    @cached_property
    def _powers(self) -> dict[Atom, Power]:
        return dict(self.factors)


@dataclass(frozen=True)
class Combination:
    """A linear combination of terms, in canonical order."""

    parts: tuple[tuple[float, Term], ...] = ()

    @staticmethod
    def of(parts: Iterable[tuple[float, Term]]) -> Combination:
        """Return the canonical combination: equal terms added, zeros dropped."""
        sums: dict[Term, float] = {}
        for coefficient, term in parts:
            sums[term] = sums.get(term, 0.0) + coefficient
        return Combination(tuple(sorted(((c, t) for t, c in sums.items() if c != 0.0), key=lambda p: p[1].text)))

    @cached_property
    def names(self) -> frozenset[str]:
        """The states, targets and inputs that appear."""
        return frozenset().union(*(term.names for _, term in self.parts))

    @cached_property
    def text(self) -> str:
        """Python syntax; floats round-trip."""
        return signed_sum((c, term.text) for c, term in self.parts)


def signed_sum(parts: Iterable[tuple[float, str]], inverse: bool = False) -> str:
    """Return `a*x - b*y` for pairs of coefficient and text; floats by repr, so that they round-trip.

    With `inverse`, x/0.0123 stands for 81.30081300813008*x: the same number, and the one that people know.
    """
    out = ""
    for coefficient, text in parts:
        size = abs(float(coefficient))
        times = text.removeprefix("1") if text.startswith("1/") else f"*{text}"
        body = repr(size) if text == "1" else text if size == 1.0 else f"{size!r}{times}"
        if inverse and text != "1" and len(repr(size)) > MANY_DIGITS:
            over = 1.0 / size
            body = f"{text}/{over!r}" if len(repr(over)) <= FEW_DIGITS and 1.0 / over == size else body
        negative = coefficient < 0
        out += (("-" if negative else "") if not out else (" - " if negative else " + ")) + body
    return out or "0.0"


def _whole(power: Power) -> Power:
    return int(power) if float(power).is_integer() else float(power)


def _power_text(atom: Atom, power: Power) -> str:
    bare = isinstance(atom, Call) and not atom.function
    return atom.text if power == 1 and not bare else f"{atom.text}**{power}"


ONE = Term()
