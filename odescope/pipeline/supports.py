"""Inputs that push along or across an angle, as the acceleration of a support does, where plain forces fall short.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from odescope.events import Progress
from odescope.library.harmonics import harmonics
from odescope.library.lagrangian_defaults import default_forces
from odescope.likelihood.refinement import Refinement
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed, mechanisms_form
from odescope.pipeline.ruled_out import mechanisms_that_stay, not_ruled_out
from odescope.pipeline.stages import refine_form
from odescope.pipeline.suspicion import replaces
from odescope.pipeline.wider import LEAST, TIMES, searched_beside, within
from odescope.pipeline.work import Work
from odescope.recordings.coordinate import Coordinate
from odescope.study.options import Study

DEGREE = 2  # of the angles whose sum an input may push along: gravity on the second of two arms goes with such


def with_moving_supports(
    work: Work, filtered: Filtered, posed: Posed, refinement: Refinement | None
) -> tuple[Posed, Refinement | None]:
    """Return Lagrange's equations and their model: with inputs that push along angles, where that is the better one.

    What hangs from a crane, stands on a shaking table or rides in a vehicle is driven by the acceleration of its
    support, which acts as gravity does: along and across every angle, and on an angle times the length that hangs from
    it. By default inputs push the same way wherever a coordinate is, and what many terms imitate of that may leave
    white noise of the process. Nothing is tried where a model follows the record with no term in doubt, or no angle or
    no input is there, or the forces were named.

    Args:
        work: whose study leaves the forces open.
        filtered: the records and their signals.
        posed: Lagrange's equations with plain forces.
        refinement: the model that the search in them ended with, if there is one.
    """
    study, records = work.study, filtered.sample.records
    forces, clear = _forces(study), refinement is not None and refinement.clear
    if study.library.forces is not None or clear or not any(forces.values()) or not filtered.sample.complete:
        return posed, refinement
    own = default_forces(study.measured(), study.driven())
    named = {name: (*own[name], *more) for name, more in forces.items()}
    library = msgspec.structs.replace(study.library, forces=named, extra=())  # those are candidates of relations
    wide = msgspec.structs.replace(study, library=library)
    stays = not_ruled_out(study, records)
    found = mechanisms_that_stay({posed.form: wide.mechanisms(posed.form)}, stays)[posed.form]
    work.monitor.tell(Progress("likelihood", "search with supports that move", 0, 1))
    if refinement is not None and refinement.says_all:  # it is near: the search goes on from it
        more = [m for m in found[0] if m not in posed.mechanisms]
        wider, other = searched_beside(work, filtered, posed, refinement, more)
    else:
        wider = mechanisms_form(wide, posed.form, found, posed.constants, filtered.records, filtered.signals)
        limited = work if refinement is None else within(work, max(LEAST, TIMES * refinement.spent))
        other = refine_form(limited, filtered, wider)
    if other is None or not (other.exact if refinement is None else replaces(other, refinement)):
        return posed, refinement
    return wider, other


def _forces(study: Study) -> dict[str, tuple[str, ...]]:
    """Return the forces of the inputs along and across angles, by the coordinate that they act on."""
    inputs = [name for name in study.inputs if name not in study.clocks]
    coordinates = study.measured()
    return {c.name: tuple(f"{i}*{h}" for i in inputs for h in _directions(c, coordinates)) for c in coordinates}


def _directions(coordinate: Coordinate, coordinates: Sequence[Coordinate]) -> list[str]:
    """Return the functions of angles that what moves a support pushes a coordinate along.

    Args:
        coordinate: the one.
        coordinates: all of them.
    """
    angles = [c.name for c in coordinates if c.angle and not c.cyclic]
    lengths = [c.name for c in coordinates if not (c.angle or c.cyclic)]
    if not coordinate.angle:
        return [h for (h,) in harmonics(angles, 1)]
    if coordinate.cyclic:
        return []
    others = [a for a in angles if a != coordinate.name]
    own = [h for (h,) in harmonics([coordinate.name], 1)]
    sums = [h for a in others for (h,) in harmonics(sorted((coordinate.name, a)), DEGREE) if "2*" not in h]
    return [*own, *(f"{x}*{h}" for x in lengths for h in own), *sums]
