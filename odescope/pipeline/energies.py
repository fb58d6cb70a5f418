"""Lagrange's equations begun from the motion that relations say, which has next to no noise.

docs/method.md, Mechanisms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.events import Progress
from odescope.likelihood.settings import Start
from odescope.model.model import Model
from odescope.pipeline.contender import Contender, best_of, contender_of
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.forms import Posed, explaining
from odescope.pipeline.joint_models import adopt
from odescope.pipeline.stages import refine_form
from odescope.pipeline.wider import LEAST, TIMES, within
from odescope.pipeline.work import Work
from odescope.recordings.record import Record, Records
from odescope.regression.mechanisms import MechanismProblem
from odescope.signals.estimate import signals_like
from odescope.validation.free_runs import FreeRunOf, free_runs


def with_energies(
    work: Work, filtered: Filtered, posed: Posed | None, contenders: Sequence[Contender]
) -> Sequence[Contender]:
    """Return the forms with Lagrange's equations found anew where exact relations had won, if these are then better.

    Noise hides from regression which few energies a record asks for, and a search from many ends with many.

    Args:
        work: whose study says how.
        filtered: the records and their signals.
        posed: Lagrange's equations as they competed, if they did.
        contenders: the forms so far.
    """
    best, able = best_of(contenders), filtered.sample.complete and not work.late
    if posed is None or best.refinement is None or not (able and best.exact and best.form == "relations"):
        return contenders
    theta = _explaining(work, filtered, posed, best.model)
    if theta is None or np.count_nonzero(theta) > best.coefficients:
        return contenders
    work.monitor.tell(Progress("likelihood", "search from the motion that relations say", 0, 1))
    begun = replace(posed, starts=(Start(theta),), regression=lambda: None)
    found = refine_form(within(work, max(LEAST, TIMES * best.refinement.spent)), filtered, begun)
    model, refinement = adopt(lambda: None, found, filtered.signals)
    if model is None or refinement is None:
        return contenders
    energies = contender_of(begun, model, refinement, (), filtered.signals)
    anew = [energies, *(c for c in contenders if c.form != posed.form)]
    return anew if best_of(anew) is energies else contenders


def _explaining(work: Work, filtered: Filtered, posed: Posed, model: Model) -> FloatArray | None:
    """Return coefficients (mechanisms,) of the few that explain the free runs of a model, None where they do not.

    Nor is there one of runs that end before the recordings do, or under inputs that act later than they are recorded.

    Args:
        work: whose study says how.
        filtered: the records and their signals.
        posed: the mechanisms.
        model: that is run.
    """
    if any(i.delay for i in model.inputs):
        return None
    runs, options = free_runs(model, filtered.records, work.monitor.check), work.study.signals
    if any(of.run.ended for of in runs):
        return None
    records = Records(tuple(_as_run(model, of) for of in runs))
    signals = signals_like(filtered.signals, records.stretches, options.differentiator, options.margin)
    return explaining(work.study, MechanismProblem.of(signals, posed.at_nominal), records)


def _as_run(model: Model, of: FreeRunOf) -> Record:
    """Return a recording with a free run in the place of what was measured."""
    values = of.record.values.copy()
    for c in model.coordinates:
        values[:, of.record.names.index(c.name)] = of.run.column(c.name)
    return replace(of.record, values=values, counts=None)
