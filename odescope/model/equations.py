"""Which equations people are shown: fractions where these are short, else the relations with their targets on the left.

Relations of Lagrange's equations are shown in the scale of their energies, so that what multiplies the accelerations is
the mass matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from odescope.errors import InputError
from odescope.library.expression import Combination, Term
from odescope.library.product import Product
from odescope.model.energy import mass_matrix
from odescope.model.explicit import Coupled, Quotient, blocks, short_explicit
from odescope.model.relation import FoundMechanism, Relation, RelationTerm
from odescope.recordings.coordinate import Coordinate, Input

LONGEST = 60  # products in numerator and denominator of a fraction that is shown
MOST_COUPLED = 3  # targets that share relations and are shown as fractions

Equation = Quotient | Relation
# Terms with the names of constants by the same with numbers, each as so many times that: (x/K)**n is K**-n times x**n.
Named = Mapping[Term, tuple[float, Term]]


def shown_equations(
    relations: Sequence[Relation],
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    mechanisms: Sequence[FoundMechanism],
) -> tuple[Equation, ...]:
    """Return the equations as they are shown, as many as there are targets.

    Relations that stand for mechanisms are shown as fractions only where that takes fewer products. Relations that do
    not determine their targets are shown as they are.

    Args:
        relations: of the model.
        coordinates: of the model.
        inputs: of the model.
        mechanisms: what the relations add up from, where that is known.
    """
    targets = tuple(c.target for c in coordinates)
    scaled = _in_scale_of_energies(relations, coordinates, inputs, mechanisms)
    try:
        found = {block: _shown(relations, block, bool(mechanisms)) for block in blocks(relations, targets)}
    except InputError:
        return scaled
    equations = list[Equation]()
    for target in targets:
        block = next(b for b in found if target in b.targets)
        place = block.targets.index(target)
        equations.append(found[block][target] if found[block] else scaled[block.rows[place]])
    return tuple(equations)


def _shown(relations: Sequence[Relation], block: Coupled, stand_for_mechanisms: bool) -> dict[str, Quotient]:
    """Return the fractions of a block by target; none where its relations are shown instead."""
    if len(block.rows) > MOST_COUPLED:
        return {}
    found = short_explicit(relations, block)
    sizes = [_products(q) for q in found.values()]
    if stand_for_mechanisms:
        shorter = sum(sizes) + len(sizes) < sum(len(relations[r].terms) for r in block.rows)
        return found if shorter else {}
    return found if max(sizes, default=0) <= LONGEST else {}


def _products(quotient: Quotient) -> int:
    return len(quotient.numerator.parts) + (0 if quotient.plain else len(quotient.denominator.parts))


def _in_scale_of_energies(
    relations: Sequence[Relation],
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    mechanisms: Sequence[FoundMechanism],
) -> tuple[Relation, ...]:
    """Return relations multiplied by what stands before their leading product in the mass matrix, where that is known.

    Standard errors are dropped: those of the mechanisms say more.
    """
    matrix = mass_matrix(coordinates, inputs, mechanisms)
    if matrix is None:
        return tuple(relations)
    targets = [c.target for c in coordinates]
    scaled = list[Relation]()
    for relation, row in zip(relations, matrix, strict=True):
        lead = next((t for t in relation.terms if t.factor in targets and t.coefficient == 1.0), None)
        entry = Combination() if lead is None else row[targets.index(str(lead.factor))]
        scale = next((c for c, term in entry.parts if lead is not None and term == lead.term), 1.0)
        terms = tuple(replace(t, coefficient=scale * t.coefficient, std_error=None) for t in relation.terms)
        scaled.append(Relation(terms))
    return tuple(scaled)


def with_names(equation: Equation, written: Named) -> Equation:
    """Return an equation with the names of constants in its terms.

    Args:
        equation: with numbers.
        written: terms with names.
    """
    if not written:
        return equation
    if isinstance(equation, Quotient):
        top, bottom = (
            Combination(tuple((c / share, named) for c, t in part.parts for share, named in [written.get(t, (1.0, t))]))
            for part in (equation.numerator, equation.denominator)
        )
        return replace(equation, numerator=top, denominator=bottom)
    return relation_with_names(equation, written)


def relation_with_names(relation: Relation, written: Named) -> Relation:
    """Return a relation with the names of constants in its terms, as `with_names`."""
    terms = list[RelationTerm]()
    for t in relation.terms:
        share, named = written.get(t.term, (1.0, t.term))
        error = None if t.std_error is None else t.std_error / abs(share)
        terms.append(RelationTerm(Product(t.factor, named), t.coefficient / share, error))
    return Relation(tuple(terms))
