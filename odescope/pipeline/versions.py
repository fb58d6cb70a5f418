"""Inputs that were recorded more than once, as a command and as measured: which of the columns drove the record."""

from __future__ import annotations

import msgspec

from odescope.errors import InputError
from odescope.model.scores import VersionScore
from odescope.pipeline.competition import Contender
from odescope.study.options import Study


def versions_of(study: Study) -> tuple[Study, ...]:
    """Return the study for each of the columns that its inputs are offered in; the k-th of every input go together.

    Raises:
        InputError: the inputs are not offered in equally many columns.
    """
    several = {name: i.column for name, i in study.inputs.items() if isinstance(i.column, tuple)}
    if not several:
        return (study,)
    if len(counts := {len(columns) for columns in several.values()}) > 1:
        told = ", ".join(f"{name} in {len(columns)}" for name, columns in several.items())
        raise InputError(
            f"inputs are offered in different numbers of columns: {told}; list equally many, in the same order: all"
            " commands first, then all that was measured"
        )
    return tuple(
        msgspec.structs.replace(
            study,
            inputs={
                name: msgspec.structs.replace(i, column=several[name][k]) if name in several else i
                for name, i in study.inputs.items()
            },
        )
        for k in range(*counts)
    )


def version_score(study: Study, version: Study, contender: Contender | None, chosen: bool) -> VersionScore:
    """Return how a version did; without a contender it gave no model.

    Args:
        study: that offers several columns.
        version: with one of them an input.
        contender: its model.
        chosen: whether that was the best.
    """
    several = [name for name, i in study.inputs.items() if isinstance(i.column, tuple)]
    columns = {name: str(version.inputs[name].column) for name in several}
    if contender is None:
        return VersionScore(columns, None, None, None, None, chosen)
    did = contender.score(chosen)
    return VersionScore(columns, did.coefficients, did.free_run, did.misfit, did.follows, chosen)
