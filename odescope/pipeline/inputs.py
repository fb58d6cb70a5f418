"""What inputs do between samples: as a study says, as the log shows, and as the likelihood stage found it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import msgspec

from odescope.likelihood.refine import Refinement
from odescope.model.model import Model
from odescope.model.scores import DelayScore, HoldScore
from odescope.recordings.between_samples import looks_held
from odescope.recordings.coordinate import Input
from odescope.recordings.record import Records
from odescope.signals.delays import Delay
from odescope.signals.estimate import Signals
from odescope.study.options import Study


def first_holds(records: Records, study: Study) -> tuple[Input, ...]:
    """Return the inputs of a study; one whose hold is open begins as held where every record shows it, else linear."""
    found = []
    for i in study.driven():
        seen = study.inputs[i.name].hold == "auto" and all(looks_held(run.column(i.name)) for run in records)
        found.append(msgspec.structs.replace(i, hold="zero") if seen else i)
    return tuple(found)


def under_found_holds(signals: Signals, refinement: Refinement | None) -> Signals:
    """Return signals whose inputs have the holds that were found in one form, for the next form to begin with."""
    holds = {} if refinement is None else refinement.settings.holds
    inputs = (msgspec.structs.replace(i, hold=holds.get(i.name, i.hold)) for i in signals.inputs)
    return replace(signals, inputs=tuple(inputs))


def hold_scores(model: Model, refinement: Refinement | None) -> dict[str, HoldScore]:
    """Return the holds of the model's inputs that were found to be better than linear."""
    if refinement is None:
        return {}
    gains, found = refinement.hold_gains, refinement.settings.holds
    there = [i for i in model.inputs if i.name in gains and i.hold == found.get(i.name)]
    return {i.name: HoldScore(i.hold, float(gains[i.name])) for i in there}


def delay_scores(estimated: Mapping[str, Delay], model: Model, refinement: Refinement | None) -> dict[str, DelayScore]:
    """Return the delays that were looked for, as the likelihood has them where it found more.

    Args:
        estimated: those of the regression, by input.
        model: whose inputs have what was found.
        refinement: what the likelihood led to.
    """
    delays = {name: DelayScore(d.seconds, d.std_error) for name, d in estimated.items()}
    found = {} if refinement is None else refinement.settings.delays
    acts = {i.name: i.delay for i in model.inputs}
    return delays | {name: DelayScore(acts[name], d.std_error) for name, d in found.items() if acts[name]}
