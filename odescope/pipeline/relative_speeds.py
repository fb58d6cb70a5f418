"""Friction of a speed relative to an input: a belt that carries, wind that drives; and what a propeller does.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from itertools import product

from odescope.events import Progress
from odescope.library.expression import Call
from odescope.library.friction import speeds
from odescope.likelihood.beginnings import EVIDENT
from odescope.likelihood.refine import Refinement
from odescope.likelihood.suspicion import suspicions
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed, relations_form
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.stages import refine_form
from odescope.pipeline.temperatures import AT_FIRST
from odescope.pipeline.units import units_of
from odescope.pipeline.wider import (
    basis_of,
    evidently_better,
    regressed_with,
    settles_closely,
    with_basis,
    with_extra,
    within,
)
from odescope.pipeline.work import Work

DEGREE = 2  # of the products beside such friction: more imitates it
ALIKE = 0.1  # size of the smaller over that of the larger: of less the difference is the larger one


def relative_speeds(work: Work, filtered: Filtered, regressed: Regressed) -> tuple[Posed, Refinement] | None:
    """Return relations with friction relative to an input, and their model; None where this promises nothing.

    What lies on a belt rubs by its speed relative to the belt, a balloon drifts by that of the wind, and the difference
    of an input and a speed is in no function of one of the two. Behind a propeller that turns both ways go products of
    its speed and the ship's with the size of one of them: two functions of one input. The model is kept where it leaves
    nothing to look for, and imitates nothing: such friction may itself be part of an imitation. Nothing is tried where
    no input may be a speed, or a library was written by hand.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression in the default library found.
    """
    wide, found = _most_promising(work, filtered, _multiplied(work, regressed)) or (work, None)
    if found is None or not found.explicit < regressed.explicit - EVIDENT:
        return None
    posed, refinement = _refined(within(wide, AT_FIRST), filtered, found)
    if refinement is None or not (settles_closely(refinement, filtered.signals) and _is_relative(work, refinement)):
        return None
    if any(s.terms for s in suspicions(refinement, work.study.suspects, work.study.parameters)):
        return None
    return posed, replace(refinement, finished=True)


def with_relative_speeds(
    work: Work, filtered: Filtered, posed: Posed, refinement: Refinement | None
) -> tuple[Posed, Refinement | None]:
    """Return relations and their model: with friction relative to an input, where that is evidently better.

    Differences of smoothed states may be too blunt for friction that is steep: where a model is wanting the likelihood
    is asked.

    Args:
        work: whose study says of which variables functions may be looked for.
        filtered: the records and their signals.
        posed: the relations.
        refinement: the model so far, if there is one.
    """
    if refinement is not None and not refinement.wanting:
        return posed, refinement
    wide, found = _most_promising(work, filtered, work.study.inputs) or (work, None)
    if found is None:
        return posed, refinement
    wider, other = _refined(within(wide, AT_FIRST), filtered, found)
    better = other is not None and _is_relative(work, other) and evidently_better(other, refinement)
    return (wider, other) if better else (posed, refinement)


def _multiplied(work: Work, regressed: Regressed) -> list[str]:
    """Return the inputs that the best relations hold in products, which may imitate friction; all, if there is none."""
    products = (t.term for r in regressed.relations for t in r.terms if t.text not in work.study.inputs)
    held = frozenset[str]().union(*(term.names for term in products))
    return [name for name in work.study.inputs if name in held or not regressed.relations]


def _most_promising(work: Work, filtered: Filtered, sources: Collection[str]) -> tuple[Work, Regressed] | None:
    """Return the work with friction of one difference among the candidates, and what regression finds with it.

    The friction is too steep for products to be told from it by differences: a forward selection ranks it.

    Args:
        work: for the study.
        filtered: the records and their signals.
        sources: the inputs that differences may be from.
    """
    if work.study.library.by_hand or not work.study.suspects or not filtered.sample.complete:
        return None
    tried = [
        (wide, found)
        for wide in _wider(work, filtered, sources)
        if (found := regressed_with(wide, filtered)) is not None
    ]
    return min(tried, key=lambda one: one[1].explicit, default=None)


def _refined(work: Work, filtered: Filtered, found: Regressed) -> tuple[Posed, Refinement | None]:
    """Return the relations of a study, and the model that a search in them ends with."""
    work.monitor.tell(Progress("suspicion", "search with friction relative to an input", 0, 1))
    posed = relations_form(work.study, (found,), lambda _: found)
    return posed, refine_form(work, filtered, posed)


def _is_relative(work: Work, refinement: Refinement) -> bool:
    """Say whether a model holds a function of an input, by itself or with something else."""
    atoms = (a for r in refinement.relations for t in r.terms for a, _ in t.product.term.factors)
    return any(isinstance(a, Call) and not a.argument.names.isdisjoint(work.study.inputs) for a in atoms)


def _wider(work: Work, filtered: Filtered, sources: Collection[str]) -> Iterator[Work]:
    """Yield the work with friction of the difference of an input and a speed, of one pair after the other.

    Then with products of the two and the size of one, where the input has both signs: with one these are squares.

    Args:
        work: for the study.
        filtered: the records and their signals.
        sources: the inputs.
    """
    signals, units = filtered.signals, units_of(filtered)
    rated = [c.derivative(1) for c in signals.coordinates if c.order == 2]
    moving = [*rated, *speeds(signals.coordinates)]
    joined = signals.joined()
    values = {n: joined[signals.row(n)] for n in (*moving, *sources)}
    size = {n: float(abs(v).max()) for n, v in values.items()}
    plain = with_basis(work, basis_of(work.study), DEGREE)
    for source, speed in product(sources, moving):
        own = () if speed in rated else (f"{speed}*abs({speed})",)  # that of rates is in the library
        alike = len({units.get(n) for n in (source, speed)} - {None}) < 2
        if alike and min(size[source], size[speed]) > ALIKE * max(size[source], size[speed]):
            between = f"{source} - {speed}"
            difference = values[source] - values[speed]
            both_ways = float(difference.min()) < 0.0 < float(difference.max())
            bent = (f"abs({between})",) if both_ways else ()  # else the difference itself
            yield with_extra(plain, (f"sign({between})", f"({between})**1*abs({between})", *bent, *own))
        if min(-values[source].min(), values[source].max()) > ALIKE * size[source]:
            sized = f"{source}*abs({source})", f"{speed}*abs({source})", f"{source}*abs({speed})"
            yield with_extra(plain, (*sized, *own))
