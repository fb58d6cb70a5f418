"""Springs that turn with an angle, and dampers that push back more than they pull, where products imitate these.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.library.expression import Term
from odescope.library.friction import friction_rates
from odescope.likelihood.beginnings import EVIDENT
from odescope.model.relation import Relation
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.wider import regressed_with, with_extra
from odescope.pipeline.work import Work
from odescope.recordings.coordinate import Coordinate
from odescope.signals.estimate import Signals

TURN = 2.0 * np.pi  # within which an angle says how far a spring is wound
FRICTION = 3  # terms of a rate alone, its size and sign among them, that may imitate its cube
SEVERAL = 2  # terms with functions of one angle that may imitate a spring, and masses that a damper is between
MANY = 400  # candidates of a target: beyond, another regression takes long


def with_springs_and_dampers(work: Work, filtered: Filtered, regressed: Regressed) -> Regressed:
    """Return what regression finds with springs and dampers among the candidates, where these promise more.

    Functions of angles are those of a turn: a default library has sines and cosines of them alone. An angle that a
    spring holds, or that hardly turns, as that of a ship that rolls, goes back by itself and by its cube. A damper that
    is harder in one direction adds the size of its speed, even in that, which no friction is.

    Args:
        work: whose study says of which states functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression in the default library found.
    """
    study, signals = work.study, filtered.signals
    if study.library.by_hand or not study.suspects or not filtered.sample.complete:
        return regressed
    coordinates, relations = signals.coordinates, regressed.relations
    extra = (*_springs(signals, relations), *_drags(coordinates, relations), *_dampers(coordinates, relations))
    found = regressed_with(with_extra(work, extra), filtered, MANY) if extra else None
    if found is None:
        return regressed
    with_these, without = (min(map(found.worth, filter(None, (r.relations, r.forward)))) for r in (found, regressed))
    return found if np.isfinite(without) and with_these < without - EVIDENT else regressed


def _springs(signals: Signals, relations: Sequence[Relation]) -> tuple[str, ...]:
    """Return every angle of order 2 that stays within a turn and may be held by a spring, and its cube.

    Args:
        signals: of the angles.
        relations: what regression proposes; where it does so, one has to hold several functions of the angle.
    """
    values = signals.joined()
    turning = (c.name for c in signals.coordinates if c.angle and not c.cyclic and c.order > 1)
    held = (n for n in turning if float(np.ptp(values[signals.row(n)])) < TURN)
    suspected = (n for n in held if not relations or any(_several(r, n) for r in relations))
    return tuple(text for n in suspected for text in (n, f"{n}**3"))


def _drags(coordinates: Sequence[Coordinate], relations: Sequence[Relation]) -> tuple[str, ...]:
    """Return the cube of the rate of every angle, where dry friction and drag together may imitate it.

    What turns has rates to the second power in its library, as mechanisms do, but the drag of a hull is cubic.

    Args:
        coordinates: the angles among them.
        relations: what regression proposes; where it does so, one has to hold drag and friction of the rate.
    """
    rates = (c.states[1] for c in coordinates if c.angle and c.order > 1)
    return tuple(f"{v}**3" for v in rates if not relations or any(_of_it_alone(r, v) >= FRICTION for r in relations))


def _of_it_alone(relation: Relation, rate: str) -> int:
    """Return how many terms of a relation are functions of a rate and of nothing else."""
    return sum(t.product.factor is None and t.product.term.names == {rate} for t in relation.terms)


def _several(relation: Relation, angle: str) -> bool:
    """Say whether several terms of a relation hold functions of an angle: nothing else of it is in the library."""
    return sum(angle in t.product.term.names for t in relation.terms) >= SEVERAL


def _dampers(coordinates: Sequence[Coordinate], relations: Sequence[Relation]) -> tuple[str, ...]:
    """Return the sizes of all rates and of their differences with like ones, where products may imitate some.

    Of a single coordinate they are among the functions of its rate. What turns has products of its own.

    Args:
        coordinates: whose rates they are.
        relations: what regression proposes.
    """
    moving = [c for c in coordinates if c.order > 1]
    if len(moving) < SEVERAL or any(c.angle for c in coordinates):
        return ()
    products = (t.product for r in relations for t in r.terms)
    curved = any(len(p.term.factors) + (p.factor is not None) > 1 or _power(p.term) > 1 for p in products)
    return tuple(f"abs({v})" for v in friction_rates(coordinates, coordinates)) if curved or not relations else ()


def _power(term: Term) -> float:
    """Return the largest power in a term."""
    return max((power for _, power in term.factors), default=0.0)
