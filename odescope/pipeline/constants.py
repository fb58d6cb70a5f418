"""Constants within the functions of a library: their ranges, and where regression would have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from odescope.errors import InputError
from odescope.library.candidates import Library
from odescope.library.constants import Constant, grid_of, term_at
from odescope.library.expression import Call, Combination, Name, Term
from odescope.library.families import laid_out
from odescope.library.product import Product
from odescope.library.tape import evaluate, write_tape
from odescope.model.relation import Relation, RelationTerm
from odescope.signals.estimate import Signals
from odescope.study.options import Study

MOST = 2  # constants of a term
COARSE = (36, 6)  # points of a constant that is alone, and of each of two, at which regression proposes relations
SIZES = (1e-3, 3.0)  # times what it is compared with: the range of a constant whose scale the data say
ARGUMENTS = (0.1, 30.0)  # of a function whose argument is a constant times something
EXPONENTS = (0.25, 8.0)


def constants_of(study: Study, terms: Sequence[Term], signals: Signals) -> tuple[Constant, ...]:
    """Return the constants that a study declares, their ranges as numbers, in the middle of these.

    Args:
        study: whose library names them.
        terms: all candidates.
        signals: where candidates must have values.

    Raises:
        InputError: no term holds a constant, one holds more than two, or as a plain factor, divides by one whose range
            holds zero, or has no values on the data within the range.
    """
    spans, found = study.parameters, list[Constant]()
    if not spans:
        return ()
    for term in terms:
        named = sorted(term.names & set(spans))
        if len(named) > MOST:
            raise InputError(f"the term {term} holds {len(named)} constants, {', '.join(named)}; at most {MOST} may be")
        for name in named:
            if term.power_of(Name(name)):
                raise InputError(
                    f"in the term {term} the constant {name} is a factor, as its coefficient is: leave it out there"
                )
    for name, span in spans.items():
        holding = [t for t in terms if name in t.names]
        if not holding:
            raise InputError(f"no candidate term holds the constant {name}: name one that does, or leave it out")
        low, high = _span_of(name, holding, set(spans), signals) if span == "scale" else span
        if low <= 0.0 <= high and (dividing := next((t for t in holding if _divides(t, name)), None)) is not None:
            raise InputError(
                f"the term {dividing} divides by the constant {name}, and its range in [library.parameters],"
                f" {low:g} to {high:g}, holds zero: give a range of one sign, such as [0.1, 10.0]"
            )
        constant = Constant(name, float(low), float(high), float(low))
        found.append(replace(constant, nominal=float(constant.evenly(1)[0])))
    found = [replace(c, grid=_grid(c, found, terms, signals)) for c in found]
    _check_values(found, terms, signals)
    return tuple(found)


def _divides(term: Term, name: str) -> bool:
    """Say whether a term divides by a constant, within its functions."""
    inner = (t for a, _ in term.factors if isinstance(a, Call) for _, t in a.argument.parts)
    return term.power_of(Name(name)) < 0 or any(_divides(t, name) for t in inner)


def _grid(
    constant: Constant, constants: Sequence[Constant], terms: Sequence[Term], signals: Signals
) -> tuple[float, ...]:
    """Return where a constant is looked for, the others in the middle of their ranges; its functions alone are seen."""
    atoms = dict.fromkeys(a for t in terms for a, _ in t.factors if constant.name in Term(((a, 1),)).names)
    return laid_out(constant, constants, [Term(((a, 1),)) for a in atoms], signals.names, signals.joined()).grid


def _check_values(constants: Sequence[Constant], terms: Sequence[Term], signals: Signals) -> None:
    """Refuse a constant within whose range a term has no values on the data."""
    names = {c.name for c in constants}
    holding = [t for t in terms if t.names & names]
    tape = write_tape([*signals.names, *(c.name for c in constants)], holding)
    joined = signals.joined()
    for values in grid_of(constants, *COARSE):
        fixed = np.tile(np.array([*values.values()])[:, None], joined.shape[1])
        finite = np.isfinite(evaluate(tape, np.vstack([joined, fixed]))).all(axis=1)
        if not finite.all():
            at = ", ".join(f"{name} = {v:.4g}" for name, v in values.items())
            raise InputError(
                f"the term {holding[int(np.argmin(finite))]} has no value on the data at {at}: it divides by zero or"
                " leaves the domain of a function; change the range in [library.parameters], or the term"
            )


def _span_of(name: str, terms: Sequence[Term], constants: set[str], signals: Signals) -> tuple[float, float]:
    """Return a range from the data: of the size of what a constant is added to or divides, or of argument over factor.

    Args:
        name: of the constant.
        terms: that hold it.
        constants: the names of all.
        signals: the data.
    """
    spans = [s for t in terms for a, _ in t.factors for s in _spans_in(a, name, constants, signals)]
    return min(low for low, _ in spans), max(high for _, high in spans)


def _spans_in(atom: Name | Call, name: str, constants: set[str], signals: Signals) -> list[tuple[float, float]]:
    if isinstance(atom, Name) or name not in atom.argument.names:
        return []
    deeper = [s for _, t in atom.argument.parts for a, _ in t.factors for s in _spans_in(a, name, constants, signals)]
    here, constant = list[tuple[float, float]](), Name(name)
    for _, term in atom.argument.parts:
        power = term.power_of(constant)
        if not power:
            continue
        rest = Term(tuple(f for f in term.factors if f[0] != constant))
        if any(isinstance(a, Call) and a.function == "log" for a, _ in rest.factors):
            here.append(EXPONENTS)
        elif rest.names - constants:
            size = _size(Combination(((1.0, rest),)), constants, signals)
            here.append((SIZES[0] * size, SIZES[1] * size) if power < 0 else (ARGUMENTS[0] / size, ARGUMENTS[1] / size))
        else:
            others = Combination(tuple(p for p in atom.argument.parts if p[1] != term))
            size = _size(others, constants, signals)
            here.append((SIZES[0] * size, SIZES[1] * size))
    return deeper + here


def _size(combination: Combination, constants: set[str], signals: Signals) -> float:
    """Return the largest size of a combination on the data, constants left out."""
    bare = [(c, Term(tuple(f for f in t.factors if f[0].text not in constants))) for c, t in combination.parts]
    values = evaluate(write_tape(signals.names, [t for _, t in bare if not t.names & constants]), signals.joined())
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max(initial=0.0)) or 1.0


@dataclass(frozen=True, eq=False)
class Substituted:
    """Libraries with the nominal values of constants, and the number that each such product is times one with names."""

    constants: tuple[Constant, ...] = ()
    libraries: tuple[Library, ...] = ()
    named: Mapping[Product, tuple[float, Product]] = field(default_factory=dict)

    @property
    def values(self) -> dict[str, float]:
        """The values that constants have here, by name."""
        return {c.name: c.nominal for c in self.constants}

    def relation(self, relation: Relation) -> Relation:
        """Return a relation with the names of constants again."""
        terms = []
        for t in relation.terms:
            share, product = self.named.get(t.product, (1.0, t.product))
            terms.append(RelationTerm(product, t.coefficient / share))
        return Relation(tuple(terms))

    def product(self, product: Product) -> Product:
        """Return a product with the names of constants again."""
        return self.named.get(product, (1.0, product))[1]


def substituted_at(
    libraries: Sequence[Library], constants: Sequence[Constant], values: Mapping[str, float], targets: Sequence[str]
) -> Substituted:
    """Return libraries with numbers for constants; of terms that become equal the first stays.

    Args:
        libraries: one a target.
        constants: of these.
        values: of the constants, by name.
        targets: that terms may hold.
    """
    constants = [replace(c, nominal=values[c.name]) for c in constants]
    named, found = dict[Product, tuple[float, Product]](), list[Library]()
    for library in libraries:
        terms = dict[Term, None]()
        for term in library:
            share, plain = term_at(term, dict(values))
            if plain in terms:
                continue
            terms[plain] = None
            if plain != term:
                named[Product.of(plain, targets)] = share, Product.of(term, targets)
        found.append(Library(tuple(terms), library.removed))
    return Substituted(tuple(constants), tuple(found), named)


def substitute(
    libraries: Sequence[Library], constants: Sequence[Constant], targets: Sequence[str]
) -> list[Substituted]:
    """Return the libraries at the nominal values of their constants, then at every point of a coarse grid.

    Args:
        libraries: one a target.
        constants: of these.
        targets: that terms may hold.
    """
    points = [{c.name: c.nominal for c in constants}, *(grid_of(constants, *COARSE) if libraries else ())]
    return [substituted_at(libraries, constants, values, targets) for values in points]
