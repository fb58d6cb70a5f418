"""The time as a variable of a library, by its name."""

from __future__ import annotations

import re

import msgspec

from odescope.errors import InputError
from odescope.recordings.coordinate import TIME, state_names
from odescope.study.library_options import Candidates
from odescope.study.options import Driven, Study


def with_time(study: Study) -> Study:
    """Return a study with the time, `t`, among its inputs if its library names it and nothing else is called so.

    The time is that of the recordings' own stamps. As an input it goes into models, simulations and exports.

    Raises:
        InputError: the recordings have no column of time.
    """
    own = study.library
    taken = {*state_names(study.measured()), *study.inputs, *own.parameters, *own.functions}
    if TIME in taken or not names_time(own):
        return study
    if study.data.time is None:
        raise InputError(f"the library names the time, {TIME}: name the column that holds it, [data] time")
    if study.data.time_unit not in (None, "s"):
        raise InputError(
            f"the library names the time, {TIME}, which is recorded in {study.data.time_unit}: constants with it"
            " would be, too; record it in seconds"
        )
    clock = Driven(column=study.data.time, hold="linear", unit="s", delay=0.0)
    return msgspec.structs.replace(study, inputs={**study.inputs, TIME: clock})


def keeps_time(study: Study) -> bool:
    """Say whether the time may be an input called `t`: it is recorded in seconds, and nothing else has that name."""
    taken = {*state_names(study.measured()), *study.inputs, *study.library.parameters, *study.library.functions}
    return TIME not in taken and study.data.time is not None and study.data.time_unit in (None, "s")


def names_time(library: Candidates) -> bool:
    """Say whether a text of a library names the time."""
    forces = (text for texts in (library.forces or {}).values() for text in texts)
    listed = (library.basis, library.terms, library.extra, library.kinetic, library.potential, library.dissipation)
    texts = (*forces, *(text for texts in listed for text in texts or ()))
    return any(re.search(rf"\b{TIME}\b", text) for text in texts)
