"""Roots of states beside quotients: what flows out of a tank that is wider at the top is in no single function.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from odescope.events import Progress
from odescope.library.expression import Name
from odescope.likelihood.beginnings import EVIDENT
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.suspicion import values_of_variables
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.wider import TIMES, better_or_simpler, quotients, regressed_with, searched_with, with_extra
from odescope.pipeline.work import Work


def with_roots(
    work: Work, filtered: Filtered, regressed: Regressed, refinement: Refinement | None
) -> Refinement | None:
    """Return the model with roots of states among the candidates, where that is evidently better.

    The law of a tank whose section A goes with its level, A(h) h' = q - c sqrt(h), is a quotient that holds a root. One
    function in the place of the quotient cannot say it, and quotients or reciprocals alone imitate it; reciprocals so
    well that regression does not tell. Nothing is tried where the model holds neither of a positive state, or a library
    was written by hand.

    Args:
        work: whose study says of which states functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression in the default library found.
        refinement: the model so far, if there is one.
    """
    study = work.study
    if refinement is None or study.library.by_hand or not filtered.sample.complete:
        return refinement
    values = values_of_variables(refinement.space)
    positive = [n for n in study.suspects if n in filtered.signals.states and values[n].min() > 0.0]
    reciprocals = _reciprocals(refinement).intersection(positive)
    if not reciprocals and quotients(refinement).isdisjoint(positive):
        return refinement
    wide = with_extra(work, tuple(text for n in positive for text in (f"sqrt({n})", f"{n}*sqrt({n})")))
    found = regressed_with(wide, filtered)
    if found is None or not (reciprocals or found.implicit < regressed.implicit - EVIDENT):
        return refinement
    work.monitor.tell(Progress("suspicion", "search with roots beside quotients", 0, 1))
    _, other = searched_with(wide, filtered, found, refinement, TIMES)
    return other if other is not None and better_or_simpler(other, refinement) else refinement


def _reciprocals(refinement: Refinement) -> set[str]:
    """Return the names that terms of a model hold to a negative power."""
    parts = (p.product.term for k in refinement.fit.present for p in refinement.space.mechanisms[k].parts)
    below = (atom for term in parts for atom, power in term.factors if power < 0)
    return {atom.name for atom in below if isinstance(atom, Name)}
