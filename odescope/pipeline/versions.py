"""Inputs that were recorded more than once, as a command and as measured: which of the columns drove the record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import msgspec

from odescope.errors import InputError, NoModelError
from odescope.events import Event, Monitor
from odescope.model.scores import VersionScore
from odescope.pipeline.contender import Contender, best_of
from odescope.study.options import Study

Result = TypeVar("Result")


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


def best_version(
    study: Study, monitor: Monitor, run: Callable[[Study, Monitor], tuple[Result, Contender]], in_vain: type[Event]
) -> tuple[Result, tuple[VersionScore, ...]]:
    """Return the result with those columns of the inputs that describe the record best, and how each did if several.

    Args:
        study: the options.
        monitor: told what goes on.
        run: identifies one version.
        in_vain: what a run tells last that finds no model: told where no version leads to one.

    Raises:
        InputError: the inputs are not offered in equally many columns.
        NoModelError: no columns lead to a model.
    """
    versions = versions_of(study)
    if len(versions) == 1:
        return run(study, monitor)[0], ()
    ends, failures, last = list[tuple[Result, Contender] | None](), [], list[Event]()

    def tell(event: Event) -> None:
        if isinstance(event, in_vain):
            last.append(event)
        else:
            monitor.tell(event)

    for version in versions:
        try:
            ends.append(run(version, replace(monitor, tell=tell)))
        except NoModelError as failure:
            failures.append(failure)
            ends.append(None)
    models = [end for end in ends if end is not None]
    if not models:
        for event in last[:1]:
            monitor.tell(event)
        raise failures[0]
    best = best_of([contender for _, contender in models])
    result = next(result for result, contender in models if contender is best)
    did = [None if end is None else end[1].score(end[1] is best) for end in ends]
    return result, tuple(VersionScore(_columns(study, v), d) for v, d in zip(versions, did, strict=True))


def _columns(study: Study, version: Study) -> dict[str, str]:
    """Return the columns that the inputs of a version are read from, of those that a study offers several."""
    several = [name for name, i in study.inputs.items() if isinstance(i.column, tuple)]
    return {name: str(version.inputs[name].column) for name in several}
