"""Reciprocals of states and inputs where quotients stand: a force of a magnet goes with i**2/x**2, a pressure with 1/V.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterator

from odescope.events import Progress
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.suspicion import values_of_variables
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.wider import (
    basis_of,
    evidently_better,
    promises,
    quotients,
    regressed_with,
    searched_with,
    with_basis,
)
from odescope.pipeline.work import Work

DEGREE = 4  # of products with reciprocals: i**2/x**2


def with_reciprocals(
    work: Work, filtered: Filtered, posed: Posed, regressed: Regressed, refinement: Refinement | None
) -> tuple[Posed, Refinement | None]:
    """Return the relations and their model: with reciprocals of states and inputs, where that is evidently better.

    Multiplied by what is below, a law with several powers of a reciprocal is of a high degree, and quotients of a lower
    one imitate it. Nothing is tried where the model holds no quotient of what is positive, or a library was written by
    hand.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        posed: the relations.
        regressed: what regression in the default library found.
        refinement: the model so far, if there is one.
    """
    if refinement is None or work.study.library.by_hand or not filtered.sample.complete:
        return posed, refinement
    tried = ((wide, regressed_with(wide, filtered)) for wide in _wider(work, refinement))
    found = [(wide, f) for wide, f in tried if f is not None and promises(f, regressed)]
    if not found:
        return posed, refinement
    wide, best = min(found, key=lambda one: one[1].criterion)
    work.monitor.tell(Progress("suspicion", "search with reciprocals", 0, 1))
    wider, other = searched_with(wide, filtered, best, refinement)
    return (wider, other) if other is not None and evidently_better(other, refinement) else (posed, refinement)


def _wider(work: Work, refinement: Refinement) -> Iterator[Work]:
    """Yield the work with the reciprocal of each of what is positive and stands in a quotient, and with those of all.

    These take the place of what they are of, or stand beside it and what else the model holds: a planet's distance is a
    factor of one force and below another, and nothing goes with its angle.

    Args:
        work: for the study.
        refinement: the model.
    """
    values, basis = values_of_variables(refinement.space), basis_of(work.study)
    below = quotients(refinement)
    positive = [n for n in work.study.suspects if n in below and values[n].min() > 0.0]
    for some in (*((n,) for n in positive), *([tuple(positive)] if len(positive) > 1 else [])):
        yield with_basis(work, tuple(f"1/{n}" if n in some else n for n in basis), DEGREE)
    terms = (p.product.term for k in refinement.fit.present for p in refinement.space.mechanisms[k].parts)
    factors = {atom.text for term in terms for atom, _ in term.factors}
    held = [n for n in basis if n in factors]
    for n in positive:
        yield with_basis(work, (*held, f"1/{n}"), DEGREE - 1)
