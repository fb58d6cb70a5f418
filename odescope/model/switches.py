"""Signs of states, as in dry friction, taken out of a model's equations: inputs of their own that the simulation sets.

At v = 0 the equations with sign(v) have no solution in the usual sense. The right-hand side is affine in the value of
the sign there, and that value is whatever in [-1, 1] keeps v at zero, if there is one (Filippov): see `standstill`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray
from odescope.library.expression import ONE, Atom, Call, Combination, Name, Power, Term
from odescope.library.tape import Tape, write_tape
from odescope.model.relation import Relation

NARROW = 1e-4  # of the largest that an edge is in the domain: a sign that is smoothed goes from -1 to 1 within


@dataclass(frozen=True, eq=False)
class Switched:
    """Equations of motion without signs.

    `tape` computes A, row by row, then b, from states, inputs and the values of K signs, called `names`. The k-th sign
    is that of edges[k] (x, 1): edges (K, n + 1) over n states. `entries` are A, row by row, then b, in these names.
    """

    tape: Tape
    edges: FloatArray
    names: tuple[str, ...]
    entries: tuple[Combination, ...]


@dataclass(frozen=True, eq=False)
class WithoutSigns:
    """Right-hand sides in which names stand for signs of states.

    `right` has one combination a relation; signs[k] is the name of the sign of edges[k] (x, 1), edges (K, n + 1).
    """

    right: tuple[Combination, ...]
    signs: tuple[str, ...]
    edges: FloatArray


def without_signs(relations: Sequence[Relation], targets: Sequence[str], states: Sequence[str]) -> WithoutSigns:
    """Return the right-hand sides of relations, signs of linear combinations of states apart.

    A sign of anything else, one that multiplies a target and signs that multiply each other stay as they are.

    Args:
        relations: of the model.
        targets: of the model.
        states: of the model.
    """
    right = [r.right for r in relations]
    barred = {
        atom for r in relations for target in targets for _, term in r.part(target).parts for atom, _ in term.factors
    }
    signs = dict[Call, FloatArray]()
    for combination in right:
        for _, term in combination.parts:
            found = {a: e for a, _ in term.factors if isinstance(a, Call) and (e := _edge(a, states)) is not None}
            if len(found) == 1:
                signs |= found
            else:
                barred |= set(found)
    signs = {atom: edge for atom, edge in signs.items() if atom not in barred}
    return WithoutSigns(
        tuple(_replaced(combination, signs) for combination in right),
        tuple(atom.text for atom in signs),
        np.array(list(signs.values())).reshape(len(signs), len(states) + 1),
    )


def switched(
    relations: Sequence[Relation], targets: Sequence[str], states: Sequence[str], inputs: Sequence[str]
) -> Switched:
    """Return the equations of motion, signs of linear combinations of states apart, as in `without_signs`.

    Args:
        relations: of the model.
        targets: of the model.
        states: of the model.
        inputs: names of the model's inputs.
    """
    apart = without_signs(relations, targets, states)
    matrix = [r.part(target) for r in relations for target in targets]
    names, entries = (*states, *inputs, *apart.signs), (*matrix, *apart.right)
    return Switched(write_tape(names, entries), apart.edges, names, entries)


def smoothed(combination: Combination, states: Sequence[str], domain: Mapping[str, tuple[float, float]]) -> Combination:
    """Return the combination with tanh(v/w) in place of sign(v), for integrators that know no sticking.

    Args:
        combination: part of a relation.
        states: of the model.
        domain: range of each state in the data. w is a small share of the largest |v| there; a sign of something
            whose range is not known stays.
    """

    def smooth(atom: Atom) -> Atom:
        edge = _edge(atom, states) if isinstance(atom, Call) else None
        if not isinstance(atom, Call) or edge is None:
            return atom
        ranges = [domain.get(s, (0.0, np.inf)) if c else (0.0, 0.0) for s, c in zip(states, edge, strict=False)]
        width = NARROW * float(abs(edge) @ [*(max(map(abs, r)) for r in ranges), 1.0])
        if not 0.0 < width < np.inf:
            return atom
        return Call("tanh", Combination.of((c / width, t) for c, t in atom.argument.parts))

    return Combination.of((c, Term.of((smooth(a), p) for a, p in term.factors)) for c, term in combination.parts)


def _edge(atom: Call, states: Sequence[str]) -> FloatArray | None:
    """Return what the sign is of, as coefficients of the states and a constant; None for another function."""
    edge = np.zeros(len(states) + 1)
    if atom.function != "sign":
        return None
    for coefficient, term in atom.argument.parts:
        if term != ONE and term.text not in states:
            return None
        edge[-1 if term == ONE else states.index(term.text)] = coefficient
    return edge


def _replaced(combination: Combination, signs: dict[Call, FloatArray]) -> Combination:
    """Return the combination with a name in place of each sign."""

    def value(atom: Atom, power: Power) -> tuple[Atom, Power]:
        # Even powers of a sign are 1 almost everywhere, odd ones the sign.
        return (Name(atom.text), int(power % 2)) if atom in signs else (atom, power)

    return Combination.of((c, Term.of(value(a, p) for a, p in term.factors)) for c, term in combination.parts)
