"""Terms: products of powers of functions of states and inputs, the one truth behind name, values, gradient and LaTeX.

A term is a product of atoms raised to powers; an atom is a name (`phi_dot`), a function of a linear combination of
terms (`sin(phi1 - phi2)`), or such a combination itself (`(x - 3.0)**1`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from odescope.library.functions import FUNCTIONS

Power = int | float


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
        return f"{self.function}({self.argument.text})"


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

    def power_of(self, atom: Atom) -> Power:
        """Return the power of `atom` in this product, 0 where it is absent."""
        return next((power for own, power in self.factors if own == atom), 0)

    def gradient(self, name: str) -> Combination:
        """Return the partial derivative with respect to `name`, by the product and chain rules."""
        parts: list[tuple[float, Term]] = []
        for atom, power in self.factors:
            rest = self * Term.of([(atom, -1)])
            parts += [(power * c, rest * inner) for c, inner in _atom_gradient(atom, name).parts]
        return Combination.of(parts)


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


def signed_sum(parts: Iterable[tuple[float, str]]) -> str:
    """Return `a*x - b*y` for pairs of coefficient and text; floats by repr, so that they round-trip."""
    out = ""
    for coefficient, text in parts:
        size = abs(coefficient)
        body = repr(float(size)) if text == "1" else text if size == 1.0 else f"{float(size)!r}*{text}"
        negative = coefficient < 0
        out += (("-" if negative else "") if not out else (" - " if negative else " + ")) + body
    return out or "0.0"


def _whole(power: Power) -> Power:
    return int(power) if float(power).is_integer() else float(power)


def _power_text(atom: Atom, power: Power) -> str:
    bare = isinstance(atom, Call) and not atom.function
    return atom.text if power == 1 and not bare else f"{atom.text}**{power}"


def _atom_gradient(atom: Atom, name: str) -> Combination:
    if isinstance(atom, Name):
        return Combination(((1.0, Term()),)) if atom.name == name else Combination()
    inner = [(c * k, t) for c, term in atom.argument.parts for k, t in term.gradient(name).parts]
    if not atom.function or not inner:
        return Combination.of(inner)
    outer = [
        (c, Term.of([f for fn, power in factors for f in _of_argument(fn, atom.argument, power)]))
        for c, factors in FUNCTIONS[atom.function].derivative
    ]
    return Combination.of([(c * k, f * t) for c, f in outer for k, t in inner])


def _of_argument(function: str, argument: Combination, power: int) -> tuple[tuple[Atom, Power], ...]:
    # The function "" of a lone product is that product, not an atom around it.
    if not function and len(argument.parts) == 1 and argument.parts[0][0] == 1.0:
        return tuple((atom, p * power) for atom, p in argument.parts[0][1].factors)
    return ((Call(function, argument), power),)


ONE = Term()

_GREEK = frozenset(
    [
        "alpha",
        "beta",
        "gamma",
        "delta",
        "epsilon",
        "zeta",
        "eta",
        "theta",
        "iota",
        "kappa",
        "lambda",
        "mu",
        "nu",
        "xi",
        "pi",
        "rho",
        "sigma",
        "tau",
        "upsilon",
        "phi",
        "chi",
        "psi",
        "omega",
        "Gamma",
        "Delta",
        "Theta",
        "Lambda",
        "Xi",
        "Pi",
        "Sigma",
        "Upsilon",
        "Phi",
        "Psi",
        "Omega",
    ]
)
_DERIVED = re.compile(r"^(?P<base>.+)_(?P<order>d+)ot$")


def is_greek(stem: str) -> bool:
    """Say whether a name is that of a Greek letter."""
    return stem in _GREEK


def split_name(name: str) -> tuple[str, str, int]:
    """Return what a name is made of, stem, index and order of the derivative: `phi1_ddot` is phi, 1 and 2."""
    derived = _DERIVED.match(name)
    base, order = (derived["base"], len(derived["order"])) if derived else (name, 0)
    stem, _, index = base.partition("_")
    if not (stem and index):
        stem, index = base, ""
    digits = re.match(r"^([A-Za-z]+)(\d+)$", stem)
    if digits:
        stem, index = digits[1], ",".join(filter(None, (digits[2], index)))
    return stem, index, order


def latex_name(name: str) -> str:
    r"""Return LaTeX of a state, target or input: `phi1_ddot` becomes \ddot{\phi}_{1}."""
    stem, index, order = split_name(name)
    stem, index = stem.replace("_", r"\_"), index.replace("_", r"\_")
    body = f"\\{stem}" if is_greek(stem) else stem if len(stem) == 1 else rf"\mathrm{{{stem}}}"
    if order:
        body = rf"\{'d' * order}ot{{{body}}}" if order <= 4 else rf"{{{body}}}^{{({order})}}"
    return body + (f"_{{{index}}}" if index else "")


def latex(term: Term) -> str:
    """Return LaTeX of a term."""
    out = []
    for atom, power in term.factors:
        if isinstance(atom, Name):
            body = latex_name(atom.name)
            body = body if power == 1 else rf"{{{body}}}^{{{power}}}"
        else:
            inner = latex_combination(atom.argument)
            if atom.function == "sqrt":
                body = rf"\sqrt{{{inner}}}" + ("" if power == 1 else f"^{{{power}}}")
            else:
                head = FUNCTIONS[atom.function].latex if atom.function else ""
                up = "" if power == 1 else f"^{{{power}}}"
                if head and power > 0:
                    body = rf"{head}{up}\left({inner}\right)"
                elif head:  # cos^{-1}(x) would read as the inverse function
                    body = rf"\left({head}\left({inner}\right)\right){up}"
                else:
                    body = rf"\left({inner}\right){up}"
        out.append(body)
    return r" \, ".join(out) or "1"


def latex_combination(combination: Combination, digits: int = 6) -> str:
    """Return LaTeX of a combination, coefficients to `digits` significant digits."""
    return latex_sum([(c, latex(term)) for c, term in combination.parts], digits)


def latex_sum(parts: Iterable[tuple[float, str]], digits: int = 6) -> str:
    """Return LaTeX of a signed sum of coefficient and text."""
    out = ""
    for coefficient, text in parts:
        size = f"{abs(coefficient):.{digits}g}"
        if "e" in size:
            mantissa, exponent = size.split("e")
            size = rf"{mantissa} \cdot 10^{{{int(exponent)}}}"
        body = size if text == "1" else text if size == "1" else rf"{size} \, {text}"
        out += (("-" if coefficient < 0 else "") if not out else (" - " if coefficient < 0 else " + ")) + body
    return out or "0"
