"""Springs that turn with an angle: the angle itself, and its cube, where functions of it imitate these.

docs/method.md, Suspicion.
"""

from __future__ import annotations

import numpy as np

from odescope.likelihood.beginnings import EVIDENT
from odescope.model.relation import Relation
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.wider import regressed_with, with_extra
from odescope.pipeline.work import Work
from odescope.signals.estimate import Signals

TURN = 2.0 * np.pi  # within which an angle says how far a spring is wound
SEVERAL = 2  # terms with functions of one angle that may imitate a spring
MANY = 400  # candidates of a target: beyond, another regression takes long


def with_springs(work: Work, filtered: Filtered, regressed: Regressed) -> Regressed:
    """Return what regression finds with springs of angles among the candidates, where that promises more.

    Functions of angles are those of a turn: a default library has sines and cosines of them alone. An angle that a
    spring holds, or that hardly turns, as that of a ship that rolls, goes back by itself and by its cube. Nothing is
    tried where no relation holds several functions of one angle, or a library was written by hand.

    Args:
        work: whose study says of which states functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression in the default library found.
    """
    study = work.study
    angles = _within_a_turn(filtered.signals)
    if study.library.by_hand or not study.suspects or not angles or not filtered.sample.complete:
        return regressed
    if regressed.relations and not any(_several(r, angle) for r in regressed.relations for angle in angles):
        return regressed
    wide = with_extra(work, tuple(text for angle in angles for text in (angle, f"{angle}**3")))
    found = regressed_with(wide, filtered, MANY)
    if found is None:
        return regressed
    with_these, without = (min(map(found.worth, filter(None, (r.relations, r.forward)))) for r in (found, regressed))
    return found if with_these < without - EVIDENT else regressed


def _within_a_turn(signals: Signals) -> list[str]:
    """Return the names of the angles of order 2 that stay within a turn."""
    values = signals.joined()
    angles = (c.name for c in signals.coordinates if c.angle and not c.cyclic and c.order > 1)
    return [n for n in angles if float(np.ptp(values[signals.row(n)])) < TURN]


def _several(relation: Relation, angle: str) -> bool:
    """Say whether several terms of a relation hold functions of an angle: nothing else of it is in the library."""
    return sum(angle in t.product.term.names for t in relation.terms) >= SEVERAL
