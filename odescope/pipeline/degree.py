"""Polynomials and quotients of a higher degree, where those of the default library do not follow the record.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from odescope.events import Progress
from odescope.likelihood.beginnings import EVIDENT
from odescope.likelihood.refinement import Refinement
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.wider import (
    basis_of,
    evidently_better,
    outranks,
    promises,
    quotients,
    regressed_with,
    searched_with,
    with_basis,
)
from odescope.pipeline.work import Work

DEGREES = (6, 5, 4)  # the highest with no more than so many candidates is taken:
FEW_ENOUGH = 60
FEW = 20  # where functions were found: less is to be expected


def with_higher_degree(
    work: Work,
    filtered: Filtered,
    posed: Posed,
    regressed: Regressed,
    refinement: Refinement | None,
    functions: bool,
) -> tuple[Posed, Refinement | None]:
    """Return the relations and their model: with products of higher degree, where that is evidently better.

    Quotients imitate these, and functions that are found in place of quotients. Nothing is tried where a model without
    either follows the record, or a library was written by hand.

    Args:
        work: whose study says of which states functions may be looked for.
        filtered: the records and their signals.
        posed: the relations.
        regressed: what regression in the default library found.
        refinement: the model so far, if there is one.
        functions: whether it holds some that the library lacks.
    """
    study, signals = work.study, filtered.signals
    angles = any(c.angle for c in signals.coordinates)
    if study.library.by_hand or angles or not study.suspects or not filtered.sample.complete:
        return posed, refinement
    follows = refinement is not None and (refinement.exact or refinement.lacks_nothing)
    if refinement is not None and follows and not (functions or quotients(refinement)):
        return posed, refinement
    wides, many = (with_basis(work, basis_of(study), degree) for degree in DEGREES), FEW if functions else FEW_ENOUGH
    wide, found = next(((w, f) for w in wides if (f := regressed_with(w, filtered, many)) is not None), (work, None))
    if found is None or not promises(found, regressed, EVIDENT if follows else 0.0):
        return posed, refinement
    if refinement is not None and follows and not outranks(wide, filtered, refinement):
        return posed, refinement
    work.monitor.tell(Progress("suspicion", "search with products of higher degree", 0, 1))
    wider, other = searched_with(wide, filtered, found, refinement)
    return (wider, other) if other is not None and evidently_better(other, refinement) else (posed, refinement)
