"""Mechanisms of mass-action kinetics: one rate, a flux that is a product of amounts, and its stoichiometry."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from math import comb

from odescope.errors import InputError, nearest
from odescope.library.candidates import MAXIMUM_CANDIDATES
from odescope.library.conservation import moieties_of, species_of
from odescope.library.expression import Call, Combination, Name, Term
from odescope.library.mechanism import Mechanism, Part
from odescope.library.parse import MAXIMUM_LENGTH, MAXIMUM_POWER, Scope, parse_term
from odescope.library.product import Product
from odescope.recordings.coordinate import Coordinate, Input

_COUNTED = re.compile(r"(?:(?P<count>[1-9]\d?)\s*\*?\s*)?(?P<name>[A-Za-z_]\w*)", re.ASCII)


@dataclass(frozen=True)
class _Reaction:
    """What goes in and what comes out, in the order in which it is written."""

    reactants: tuple[tuple[str, int], ...]
    products: tuple[tuple[str, int], ...]
    other_flux: Term | None = None

    @property
    def name(self) -> str:
        return f"{_side(self.reactants)} -> {_side(self.products)}".strip()

    @property
    def flux(self) -> Term:
        """The product of the reactants, unless the reaction says otherwise."""
        mass_action = Term.of((Name(name), count) for name, count in self.reactants)
        return mass_action if self.other_flux is None else self.other_flux

    @property
    def key(self) -> tuple[frozenset[tuple[str, int]], frozenset[tuple[str, int]], Term]:
        """The same for reactions that differ only in order."""
        return frozenset(self.reactants), frozenset(self.products), self.flux

    def saturated(self, name: str) -> _Reaction:
        """Return the same with a flux that no longer grows where there is much of a reactant, a/(K_a + a) for a."""
        constant, own = Term(((Name(saturation(name)), 1),)), Term(((Name(name), 1),))
        level = Call("", Combination.of(((1.0, constant), (1.0, own))))
        return replace(self, other_flux=self.flux.over(level))


def saturation(species: str) -> str:
    """Return the name of the amount of a species at which half of a saturating flux is reached."""
    return f"K_{species}"


def reactions(
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    *,
    named: Sequence[str] | None,
    composition: Mapping[str, str] | None,
    molecules: int = 2,
    saturating: Sequence[str] = (),
    scope: Scope | None = None,
) -> tuple[Mechanism, ...]:
    """Return the rate of change of every species, known to stand with coefficient 1, then candidate reactions.

    The coefficient of a reaction is its rate: sum of rates times parts = 0 reads x' = stoichiometry * rate * flux. Its
    size is the number of molecules in the flux, and one more for every distinct product after the first.

    A reaction is written as "S + E -> C", "2 A -> B" or, for two of them, "C <-> P + E". An input may stand on the
    left: it multiplies the flux and is not used up ("u -> S" is an inflow). A side without species is the world
    outside: "-> S" flows in at a constant rate, "S ->" out or decays. A flux that is not the product of the reactants
    follows a colon: "S -> P: S/(K + S)".

    Args:
        coordinates: the species, of order 1, one a relation.
        inputs: what drives the system.
        named: the reactions to choose from; None or none for all that the composition allows between complexes of so
            many molecules, and every input into every species.
        composition: moieties by species, such as {"S": "s", "C": "2 s e"} (see `moieties_of`); named reactions are
            checked against it, but for those with a side without species.
        molecules: the most on one side of a reaction that is not named.
        saturating: species of which one molecule's flux may saturate: reactions that use one compete with a flux of
            theirs over (K + amount), too.
        scope: what fluxes may name; by default species and inputs.

    Raises:
        InputError: neither reactions nor a composition are given; one of them cannot be read, names what there is not
            or does not balance; a coordinate is not of order 1; or there would be more than 20 000 reactions.
    """
    species = species_of(coordinates)
    driven = tuple(i.name for i in inputs)
    scope = Scope.of([*species, *driven]) if scope is None else scope
    if not named and composition is None:
        raise InputError(
            "no reactions are given: give reactions, such as ['S + E -> C'], or the composition of every species, such"
            " as {S = 's', E = 'e', C = 's e'}, for all reactions that it allows"
        )
    held = None if composition is None else _held(composition, species)
    if named:
        found = _distinct([r for text in named for r in _read(text, species, driven, scope)])
        if held is not None:
            for reaction in found:
                _check_balance(reaction, held, driven)
    else:
        assert held is not None
        inflows = (_Reaction(((u, 1),), ((s, 1),)) for u in driven for s in species)
        found = [*_balanced(species, held, molecules), *inflows]
    found += _saturated(found, saturating, species)
    rates = (
        Mechanism("term", c.target, c.target, (Part(i, Product(c.target)),), 0.0, known=1.0)
        for i, c in enumerate(coordinates)
    )
    return (*rates, *(_mechanism(r, species) for r in found))


def _saturated(found: Sequence[_Reaction], saturating: Sequence[str], species: Sequence[str]) -> list[_Reaction]:
    """Return the reactions with a flux that saturates, one for each of the species that they use one molecule of."""
    for name in saturating:
        if name not in species:
            raise InputError(f"[library] saturating names {name!r}, which is no species; {nearest(name, species)}")
    mass_action = [r for r in found if r.other_flux is None]
    return [r.saturated(name) for name in saturating for r in mass_action if (name, 1) in r.reactants]


def _mechanism(reaction: _Reaction, species: Sequence[str]) -> Mechanism:
    flux, used, made = reaction.flux, dict(reaction.reactants), dict(reaction.products)
    gains = [made.get(s, 0) - used.get(s, 0) for s in species]
    parts = tuple(Part(i, Product(None, flux), -float(gain)) for i, gain in enumerate(gains) if gain)
    size = float(sum(used.values()) + max(len(made) - 1, 0) + (reaction.other_flux is not None))
    return Mechanism("reaction", flux.text, "reaction", parts, size, name=reaction.name)


def _side(complex_: Sequence[tuple[str, int]]) -> str:
    return " + ".join(name if count == 1 else f"{count} {name}" for name, count in complex_)


def _held(composition: Mapping[str, str], species: Sequence[str]) -> dict[str, Counter[str]]:
    """Return the moieties of every species, one entry each."""
    for name in composition:
        if name not in species:
            raise InputError(f"the composition names {name!r}, which is no species; {nearest(name, species)}")
    missing = [s for s in species if s not in composition]
    if missing:
        raise InputError(
            f"the composition does not say what {', '.join(missing)} is made of: give the moieties of every species,"
            " such as 's e'"
        )
    return moieties_of(composition)


def _balanced(species: Sequence[str], held: Mapping[str, Counter[str]], molecules: int) -> list[_Reaction]:
    """Return every reaction between two complexes that are made of the same moieties."""
    if isinstance(molecules, bool) or molecules not in range(1, MAXIMUM_POWER + 1):
        raise InputError(f"molecules must be a whole number from 1 to {MAXIMUM_POWER}, got {molecules!r}")
    advice = "allow fewer molecules on a side, or name the reactions"
    count = comb(len(species) + molecules, molecules)
    if count > MAXIMUM_CANDIDATES:
        raise InputError(f"{len(species)} species make {count} complexes of {molecules} molecules at most: {advice}")
    alike = dict[frozenset[tuple[str, int]], list[tuple[tuple[str, int], ...]]]()
    for k in range(molecules + 1):
        for chosen in combinations_with_replacement(species, k):
            complex_ = tuple(Counter(chosen).items())
            alike.setdefault(frozenset(_total(complex_, held).items()), []).append(complex_)
    count = sum(len(group) * (len(group) - 1) for group in alike.values())
    if count > MAXIMUM_CANDIDATES:
        raise InputError(f"the composition allows {count} reactions, more than {MAXIMUM_CANDIDATES}: {advice}")
    return [_Reaction(a, b) for group in alike.values() for a in group for b in group if a != b]


def _total(complex_: Sequence[tuple[str, int]], held: Mapping[str, Counter[str]]) -> Counter[str]:
    total = Counter[str]()
    for name, count in complex_:
        for moiety, times in held[name].items():
            total[moiety] += count * times
    return total


def _check_balance(reaction: _Reaction, held: Mapping[str, Counter[str]], driven: Sequence[str]) -> None:
    reactants = [r for r in reaction.reactants if r[0] not in driven]
    if not reactants or not reaction.products:
        return  # matter crosses the border of the system, as it says
    before, after = _total(reactants, held), _total(reaction.products, held)
    for moiety in sorted(before | after):
        if before[moiety] != after[moiety]:
            raise InputError(
                f"the reaction {reaction.name!r} does not balance: it has {before[moiety]} of {moiety!r} on the left"
                f" and {after[moiety]} on the right; correct the reaction or the composition"
            )


def _distinct(found: list[_Reaction]) -> list[_Reaction]:
    seen = set[object]()
    for reaction in found:
        if reaction.key in seen:
            raise InputError(f"the reaction {reaction.name!r} is named twice; leave one out ('<->' stands for both)")
        seen.add(reaction.key)
    return found


def _read(text: str, species: Sequence[str], driven: Sequence[str], scope: Scope) -> list[_Reaction]:
    """Return the reaction that a text names, or the two where its arrow has two heads."""
    shown = text if len(text) <= 60 else text[:57] + "..."
    equation, colon, rate = text.partition(":")
    sides = re.split(r"<?->", equation) if len(text) <= MAXIMUM_LENGTH else []
    if len(sides) != 2:
        raise InputError(
            f"cannot read the reaction {shown!r}: expected one arrow, '->' or '<->', between sums of species, such as"
            " 'S + E -> C'"
        )
    left, right = (_complex(side, shown, species, driven) for side in sides)
    if frozenset(left) == frozenset(right):
        raise InputError(f"the reaction {shown!r} changes nothing: its two sides are the same")
    flux = parse_term(rate.strip(), scope) if colon else None
    if flux is not None and "<->" in equation:
        raise InputError(f"the reaction {shown!r} goes both ways with one flux: write two reactions, with a flux each")
    found = [_Reaction(left, right), _Reaction(right, left)] if "<->" in text else [_Reaction(left, right, flux)]
    for reaction in found:
        for name, _ in reaction.products:
            if name in driven:
                raise InputError(f"the reaction {shown!r} makes the input {name!r}, which is given from outside")
    return found


def _complex(side: str, reaction: str, species: Sequence[str], driven: Sequence[str]) -> tuple[tuple[str, int], ...]:
    counts = Counter[str]()
    for piece in side.split("+") if side.strip() else ():
        match = _COUNTED.fullmatch(piece.strip())
        if match is None:
            raise InputError(
                f"cannot read {piece.strip()!r} in the reaction {reaction!r}: expected a species, or a whole number and"
                " a species, such as '2 A'"
            )
        name = match["name"]
        if name not in species and name not in driven:
            known = (*species, *driven)
            raise InputError(f"the reaction {reaction!r} names {name!r}, which is no species; {nearest(name, known)}")
        counts[name] += int(match["count"] or 1)
        if counts[name] > MAXIMUM_POWER:
            raise InputError(f"the reaction {reaction!r} has more than {MAXIMUM_POWER} of {name!r} on one side")
    return tuple(counts.items())
