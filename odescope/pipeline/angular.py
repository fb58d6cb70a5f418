"""States that may be angles: one identification more with their sines and cosines, where a model may imitate these.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from odescope.events import Progress
from odescope.library.families import may_be_angle
from odescope.library.readable import readable
from odescope.likelihood.alternatives import EVIDENT
from odescope.likelihood.refine import Refinement
from odescope.likelihood.search import WIDTHS
from odescope.model.scores import SuspicionScore
from odescope.pipeline.constants import substitute
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import relations_form
from odescope.pipeline.regressed import Regressed
from odescope.pipeline.stages import refine_form, regress_at
from odescope.pipeline.suspicion import replaces
from odescope.pipeline.work import Work
from odescope.signals.estimate import Signals
from odescope.study.options import Study

DEGREE = 2  # of the products of states, inputs, sines and cosines
MANY = 120  # candidates of a target: more take longer than a suspicion is worth
LEAST = 1.0  # units of budget, where the search before cost next to nothing,
TIMES = 2.0  # and times what it cost


def with_angles(
    work: Work, filtered: Filtered, regressed: Regressed, refinement: Refinement | None, suspected: bool
) -> tuple[Refinement | None, tuple[SuspicionScore, ...]]:
    """Return the model with sines and cosines of states, where that is evidently better, and what was found.

    A polynomial in an angle, or a quotient, imitates products of these that no single function stands for. Nothing is
    tried where the model leaves no suspicion, or a library was written by hand.

    Args:
        work: whose study says of which states functions may be looked for.
        filtered: the records and their signals.
        regressed: what regression without them found.
        refinement: the model so far, if there is one.
        suspected: whether there was a suspicion against its terms, settled or not.
    """
    study, signals = work.study, filtered.signals
    angles = [n for n in study.suspects if n in signals.states and may_be_angle(signals.joined()[signals.row(n)])]
    by_hand = study.library.basis is not None or study.library.extra
    if by_hand or not angles or not filtered.sample.complete:
        return refinement, ()
    if refinement is not None and refinement.exact and not suspected:
        return refinement, ()
    wide = _with_basis(work, _basis(signals, angles))
    found = _regressed(wide, filtered)
    # Regression decides cheaply, and cannot where the model before does not follow the record.
    if found is None or (refinement is not None and refinement.exact and not _promises(found, regressed)):
        return refinement, ()
    work.monitor.tell(Progress("suspicion", "search with sines and cosines of what may be angles", 0, 1))
    spent = LEAST if refinement is None else max(LEAST, TIMES * refinement.spent)
    wide = _within(wide, spent)
    posed = relations_form(wide.study, (found,), lambda _: found)
    few = found.start(posed.mechanisms, found.short)  # what does without a sine is long, and hard to see through
    other = refine_form(wide, filtered, replace(posed, starts=(few, *posed.starts)))
    if other is None or not _better(other, refinement):
        return refinement, ()
    return other, tuple(_scores(other, refinement, angles, signals))


def _basis(signals: Signals, angles: Sequence[str]) -> tuple[str, ...]:
    names = (*signals.states, *(i.name for i in signals.inputs))
    return (*names, *(f"{function}({name})" for name in angles for function in ("sin", "cos")))


def _with_basis(work: Work, basis: Sequence[str]) -> Work:
    """Return the work for a study with another library."""
    library = msgspec.structs.replace(work.study.library, basis=tuple(basis), degree=DEGREE)
    return replace(work, study=msgspec.structs.replace(work.study, library=library))


def _within(work: Work, budget: float) -> Work:
    """Return the work for a study with no more than this budget."""
    options = work.study.likelihood
    likelihood = msgspec.structs.replace(options, budget=min(options.budget, budget))
    return replace(work, study=msgspec.structs.replace(work.study, likelihood=likelihood))


def _regressed(work: Work, filtered: Filtered) -> Regressed | None:
    """Return what regression finds in the library of a study, None where it is too large for the record."""
    study: Study = work.study
    libraries = tuple(study.candidates(c.target) for c in study.measured())
    if max(map(len, libraries)) > min(MANY, filtered.signals.samples):
        return None
    return regress_at(work, substitute(libraries, (), filtered.signals.targets)[0], filtered)


def _promises(found: Regressed, before: Regressed) -> bool:
    return bool(np.isfinite(found.criterion) and found.criterion < before.criterion - EVIDENT)


def _better(other: Refinement, before: Refinement | None) -> bool:
    """Say whether a model with sines and cosines replaces the one without: it follows the record in one piece."""
    if other.outcome.width > WIDTHS[-1]:
        return False
    if before is None:
        return other.exact
    apart = before.outcome.penalised - other.outcome.penalised
    return replaces(other, before) and (not before.exact or apart > EVIDENT)


def _scores(
    found: Refinement, before: Refinement | None, angles: Sequence[str], signals: Signals
) -> Sequence[SuspicionScore]:
    """Return what was found, by target and angle."""
    gain = before.outcome.penalised - found.outcome.penalised if before is not None and before.exact else None
    scores = []
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
