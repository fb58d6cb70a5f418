"""Drag that goes with the speed of a mass or grows with an angle, where friction of rates by itself falls short.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from odescope.events import Progress
from odescope.library.lagrangian import lagrangian
from odescope.library.mechanism import Mechanism
from odescope.likelihood.add_and_drop import HOPELESS
from odescope.likelihood.refinement import Refinement
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.suspicion import replaces
from odescope.pipeline.wider import searched_beside
from odescope.pipeline.work import Work
from odescope.study.options import Study


def with_drag(
    work: Work, filtered: Filtered, posed: Posed, refinement: Refinement | None
) -> tuple[Posed, Refinement | None]:
    """Return Lagrange's equations and their model: with drag on what moves, where that is the better one.

    A liquid or the air slows a mass down by its own speed, not by the rates of the coordinates: a bob that swings on a
    spring along its path, the lower of two arms by what both do. The dissipation function then has a term as the
    kinetic energy has. Or damping grows as an angle does, as that of an escapement (Van der Pol). Such terms are
    tried, beside all that the model was chosen from, where it lacks little in short pieces of the record and does not
    follow the whole, or follows it with terms in doubt or noise of the process, which may stand for drag.

    Args:
        work: whose study leaves the dissipation function open.
        filtered: the records and their signals.
        posed: Lagrange's equations with the friction of every coordinate by itself.
        refinement: the model that the search in them ended with, if there is one.
    """
    if work.study.library.dissipation is not None or refinement is None or refinement.clear:
        return posed, refinement
    if refinement.process is None and refinement.outcome.scale > HOPELESS:
        return posed, refinement
    drags = _drags(work.study, posed, refinement)
    if not drags:
        return posed, refinement
    work.monitor.tell(Progress("likelihood", "search with drag on what moves", 0, 1))
    wider, other = searched_beside(work, filtered, posed, refinement, drags)
    better = other is not None and other.exact and replaces(other, refinement)
    return (wider, other) if better else (posed, refinement)


def _drags(study: Study, posed: Posed, refinement: Refinement) -> tuple[Mechanism, ...]:
    """Return the new terms of the dissipation function: those of a model's kinetic energy, and what grows."""
    known = {m.term for m in posed.mechanisms if m.kind == "dissipation"}
    present = (refinement.space.mechanisms[k] for k in refinement.fit.present)
    moved = [m for m in present if m.kind == "kinetic" and any(p.product.factor is not None for p in m.parts)]
    coordinates = study.measured()
    grown = (f"{c.name}**2*{c.derivative(1)}**2" for c in coordinates if c.angle and not c.cyclic)
    texts = [text for text in (*(m.term for m in moved), *grown) if text not in known]
    if not texts:
        return ()
    bare = [f"{c.derivative(1)}**2" for c in coordinates]
    found = lagrangian(coordinates, (), study.scope(), kinetic=bare, potential=(), dissipation=texts, forces={})
    return tuple(m for m in found if m.kind == "dissipation")
