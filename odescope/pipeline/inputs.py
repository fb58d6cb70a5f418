"""What inputs do between samples: as a study says, as the log shows, and as the likelihood stage found it."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from odescope.likelihood.refinement import Refinement
from odescope.recordings.between_samples import looks_held
from odescope.recordings.coordinate import Input
from odescope.recordings.record import Records
from odescope.signals.estimate import Signals
from odescope.study.options import Study


def first_holds(records: Records, study: Study) -> tuple[Input, ...]:
    """Return the inputs of a study; one whose hold is open begins as held where every record shows it, else linear.

    A record in which it does not change shows nothing. What changes by a clock of its own is held from tick to tick.
    """
    found = []
    for i in study.driven():
        moving = [run for run in records if np.ptp(run.column(i.name)) > 0.0]
        held = (i.name in run.repairs.clocked or looks_held(run.column(i.name)) for run in moving)
        seen = study.inputs[i.name].hold == "auto" and moving and all(held)
        found.append(msgspec.structs.replace(i, hold="zero") if seen else i)
    return tuple(found)


def under_found_holds(signals: Signals, refinement: Refinement | None) -> Signals:
    """Return signals whose inputs have the holds that were found in one form, for the next form to begin with."""
    holds = {} if refinement is None else refinement.settings.holds
    inputs = (msgspec.structs.replace(i, hold=holds.get(i.name, i.hold)) for i in signals.inputs)
    return replace(signals, inputs=tuple(inputs))
