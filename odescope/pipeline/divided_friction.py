"""Dry friction in a relation that a function of the position divides, which by default nothing multiplies.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterator

from odescope.events import Progress
from odescope.library.expression import ONE
from odescope.library.friction import rubs
from odescope.library.mechanism import Mechanism, candidate
from odescope.library.product import Product
from odescope.likelihood.refinement import Refinement
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.suspicion import replaces
from odescope.pipeline.wider import searched_beside
from odescope.pipeline.work import Work


def with_divided_friction(
    work: Work, filtered: Filtered, posed: Posed, refinement: Refinement | None
) -> tuple[Posed, Refinement | None]:
    """Return relations and their model: with dry friction times what divides them, where that is the better one.

    A rope whose stiffness goes with 1/(l - x) pulls at a drum that rubs: multiplied by l - x its law holds x sign(v).
    Such terms are tried, beside all that the model was chosen from, where a relation has its target times something,
    friction by itself is a candidate there, and the model does not follow the record with no term in doubt.

    Args:
        work: whose study leaves the library open.
        filtered: the records and their signals.
        posed: the relations.
        refinement: the model that the search in them ended with, if there is one.
    """
    if work.study.library.by_hand or refinement is None or refinement.clear:
        return posed, refinement
    new = [m for m in dict.fromkeys(_rubbing(posed, refinement)) if m not in posed.mechanisms]
    if not new:
        return posed, refinement
    work.monitor.tell(Progress("likelihood", "search with friction in what is divided", 0, 1))
    wider, other = searched_beside(work, filtered, posed, refinement, new)
    better = other is not None and replaces(other, refinement)
    return (wider, other) if better else (posed, refinement)


def _rubbing(posed: Posed, refinement: Refinement) -> Iterator[Mechanism]:
    """Yield dry friction times what multiplies its target, of every relation of a model."""
    space = refinement.space
    for r, target in enumerate(space.frame.targets):
        own = [m.parts[0].product for m in posed.mechanisms if m.parts and m.parts[0].relation == r]
        friction = [p.term for p in own if p.factor is None and p.term.text.startswith("sign(") and rubs(p.term)]
        present = [p for k in refinement.fit.present for p in space.mechanisms[k].parts if p.relation == r]
        below = [p.product.term for p in present if p.product.factor == target and p.product.term != ONE]
        yield from (candidate(r, Product(None, f * t), target) for f in friction for t in below)
