"""Products with inputs and of more rates under angles, and springs, where those of the default library fall short.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Iterator

from odescope.events import Progress
from odescope.library.candidates import Library
from odescope.library.rules import Identity
from odescope.likelihood.beginnings import EVIDENT
from odescope.likelihood.refinement import Refinement
from odescope.likelihood.search import WIDTHS, full
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.suspicion import FAR_BETTER, NO_WORSE
from odescope.pipeline.wider import regressed_with, searched_with, with_extra
from odescope.pipeline.work import Work
from odescope.study.options import Study

WIDER = ((2, 0), (3, 0), (2, 2), (3, 2))  # degrees of the products, and of the sines and cosines with them


def with_modulated(
    work: Work, filtered: Filtered, posed: Posed, regressed: Regressed, refinement: Refinement | None
) -> tuple[Posed, Refinement | None]:
    """Return relations and their model: with inputs that multiply rates, themselves and each other, where it is better.

    Beside angles the default library holds inputs to the first power, which nothing but sines and cosines multiply, and
    two rates at most: neither a spring that turns with a shaft, nor a brake whose damping goes with its current, nor a
    pendulum on what turns at a speed that was recorded, nor the cubic drag of a ship. Nothing is tried where a model
    follows the record and leaves no more than noise, or a library was written by hand.

    Args:
        work: whose study says whether more than its library may be looked for.
        filtered: the records and their signals.
        posed: the relations of the default library.
        regressed: what regression in the default library found.
        refinement: the model so far, if there is one.
    """
    study = work.study
    angles = any(c.angle for c in filtered.signals.coordinates)
    if study.library.by_hand or not angles or not study.suspects or not filtered.sample.complete:
        return posed, refinement
    if refinement is not None and (refinement.exact or refinement.lacks_nothing):
        return posed, refinement
    wides = [with_extra(work, extra) for extra in products_of(study)]
    regressions = [(wide, found) for wide in wides if (found := regressed_with(wide, filtered)) is not None]
    if not regressions:
        return posed, refinement
    wide, found = min(regressions, key=lambda tried: _promise(tried[1]))
    if not _promise(found) < _promise(regressed) - EVIDENT:
        return posed, refinement
    work.monitor.tell(Progress("suspicion", "search with springs that turn, and inputs that multiply rates", 0, 1))
    in_wider, other = searched_with(wide, filtered, found, refinement)
    return (in_wider, other) if other is not None and _replaces(other, refinement) else (posed, refinement)


def _replaces(other: Refinement, before: Refinement | None) -> bool:
    """Say whether a model replaces the one before: it follows the record in one piece, and runs freely as well.

    With noise of the process, or in shorter pieces, it has to run far better: functions are then suspected of it.
    """
    if other.exact and other.outcome.width <= WIDTHS[-1]:
        return before is None or other.free_run_error <= NO_WORSE * before.free_run_error
    far_better = before is not None and other.free_run_error < FAR_BETTER * before.free_run_error
    return far_better and other.follows and not full(other.space, other.fit)


def _promise(found: Regressed) -> float:
    """Return what ranks the best that regression finds in a library, by whatever is left on the left-hand side."""
    return min(found.criterion, found.explicit)


def products_of(study: Study) -> Iterator[tuple[str, ...]]:
    """Yield the angles themselves, and with them products of rates, positions and inputs with sines and cosines.

    Beside such stand accelerations times the inputs: a pendulum whose length is recorded is divided by that.
    """
    coordinates, scope = study.measured(), study.scope()
    free = {c.name for c in coordinates if c.angle or c.cyclic}
    names = [n for c in coordinates for n in c.states if n not in free]
    moving = Library.of([*names, *(i for i in study.inputs if i not in study.clocks)], scope)
    angles = [c.name for c in coordinates if c.angle]
    springs = tuple(c.name for c in coordinates if c.angle and not c.cyclic)
    if springs:
        yield springs
    driven = [i for i in study.inputs if i not in study.clocks]
    divided = tuple(f"{c.target}*{i}" for c in coordinates if c.order > 1 for i in driven)  # by a length, a mass
    turning = Library.of([f"{f}({a})" for a in angles for f in ("sin", "cos")], scope)
    for degree, harmonics in WIDER:
        trigonometric = turning.powers(harmonics).thin([Identity(f"sin({a})") for a in angles], scope)
        yield (*springs, *divided, *(term.text for term in moving.powers(degree) * trigonometric))
