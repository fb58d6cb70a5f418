"""States that may be angles: one identification more with their sines and cosines, where a model may imitate these.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from odescope.events import Progress
from odescope.library.families import RATE, may_be_angle
from odescope.library.readable import readable
from odescope.likelihood.refinement import Refinement
from odescope.model.scores import SuspicionScore
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import relations_form
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.stages import refine_form
from odescope.pipeline.units import units_of
from odescope.pipeline.wider import (
    LEAST,
    TIMES,
    basis_of,
    evidently_better,
    outranks,
    promises,
    regressed_with,
    with_basis,
    within,
)
from odescope.pipeline.work import Work
from odescope.recordings.checks import is_angular
from odescope.signals.estimate import Signals

DEGREE = 2  # of the products of states, inputs, sines and cosines


def with_angles(
    work: Work, filtered: Filtered, regressed: Regressed, refinement: Refinement | None, suspected: bool
) -> tuple[Refinement | None, tuple[SuspicionScore, ...]]:
    """Return the model with sines and cosines of states, where that is evidently better, and what was found.

    A polynomial in an angle, or a quotient, imitates products of these that no single function stands for. Nothing is
    tried where the model leaves no suspicion, a library was written by hand, or some coordinates are called angles: who
    says so of one would say so of another.

    Args:
        work: whose study says of which states functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression without them found.
        refinement: the model so far, if there is one.
        suspected: whether there was a suspicion against its terms, settled or not.
    """
    study, signals = work.study, filtered.signals
    units = units_of(filtered)
    moving = [n for n in study.suspects if n in signals.states and is_angular(units.get(n))]
    angles = [n for n in moving if may_be_angle(signals.joined()[signals.row(n)])]
    called = any(c.angle for c in signals.coordinates)
    if study.library.by_hand or called or not angles or not filtered.sample.complete:
        return refinement, ()
    settled = refinement is not None and refinement.lacks_nothing
    if settled and not suspected:
        return refinement, ()
    wide = with_basis(work, basis_of(study, angles), DEGREE)
    found = regressed_with(wide, filtered)
    # Regression decides cheaply, and cannot where the model before does not follow the record, or not quite.
    if found is None:
        return refinement, ()
    if refinement is not None and settled and not (promises(found, regressed) and outranks(wide, filtered, refinement)):
        return refinement, ()
    work.monitor.tell(Progress("suspicion", "search with sines and cosines of what may be angles", 0, 1))
    spent = LEAST if refinement is None else max(LEAST, TIMES * refinement.spent)
    wide = within(wide, spent)
    posed = relations_form(wide.study, (found,), lambda _: found)
    few = found.start(posed.mechanisms, found.short)  # what does without a sine is long, and hard to see through
    other = refine_form(wide, filtered, replace(posed, starts=(few, *posed.starts)))
    if other is None or not (evidently_better(other, refinement) or _shorter(other, refinement)):
        return refinement, ()
    return other, tuple(_scores(other, refinement, angles, signals))


def _shorter(other: Refinement, before: Refinement | None) -> bool:
    """Say whether a model says in products of sine and cosine what a sine of a rate of its own said, and for less."""
    if before is None or not other.exact or (gain := other.gained_over(before)) is None:
        return False
    constants = (before.space.mechanisms[k].place for k in before.fit.present if not before.space.mechanisms[k].parts)
    cheaper = before.space.price(before.fit) - other.space.price(other.fit)
    return any(name.startswith(f"{RATE}_") for name in constants) and cheaper > 0.0 and gain + cheaper > 0.0


def _scores(
    found: Refinement, before: Refinement | None, angles: Sequence[str], signals: Signals
) -> Sequence[SuspicionScore]:
    """Return what was found, by target and angle."""
    scores, gain = [], found.gained_over(before)
    for r, target in enumerate(signals.targets):
        parts = [p for k in found.fit.present for p in found.space.mechanisms[k].parts if p.relation == r]
        for name in angles:
            functions = (f"sin({name})", f"cos({name})")
            held = dict.fromkeys(readable(p.product.term) for p in parts if any(f in p.product.text for f in functions))
            seen = signals.joined()[signals.row(name)]
            if held:
                low, high = float(seen.min()), float(seen.max())
                scores.append(SuspicionScore(target, name, "angle", 0, low, high, functions, tuple(held), gain))
    return scores
