"""Inputs that were recorded more than once, as a command and as measured: which of the columns drove the record."""

from __future__ import annotations

from itertools import product

import msgspec

from odescope.model.scores import VersionScore
from odescope.pipeline.competition import Contender
from odescope.study.options import Study


def versions_of(study: Study) -> tuple[Study, ...]:
    """Return the study for each of the columns that its inputs are offered in, one column an input."""
    inputs = study.inputs
    offered = [i.column if isinstance(i.column, tuple) else (i.column,) for i in inputs.values()]
    return tuple(
        msgspec.structs.replace(
            study,
            inputs={
                name: msgspec.structs.replace(i, column=column)
                for (name, i), column in zip(inputs.items(), columns, strict=True)
            },
        )
        for columns in product(*offered)
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
