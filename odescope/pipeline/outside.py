"""Coordinates that no law is found for while the others have one: what moves them may come from outside."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

import msgspec

from odescope.errors import InputError, NoModelError
from odescope.events import Monitor, Progress, unheard
from odescope.export.languages.text import equation_lines
from odescope.pipeline.contender import Contender
from odescope.pipeline.joint_models import Search
from odescope.study.options import Driven, Study

DIGITS = 4  # of the numbers in a sentence
Result = TypeVar("Result")


def moved_from_outside(
    study: Study,
    searches: Sequence[Search],
    monitor: Monitor,
    run: Callable[[Study, Monitor], tuple[Result, Contender]],
) -> tuple[str, ...]:
    """Return a sentence on the coordinates that are perhaps inputs: with them as such the others have an exact law.

    These are the coordinates whose targets have no candidate or, where all have one, that whose best explains least.

    Args:
        study: which led to no model.
        searches: of the targets that have candidates, best first.
        monitor: told that it is tried.
        run: identifies by a study.
    """
    explained = {s.problem.target: s.ranked.candidates[0].explained for s in searches}
    coordinates = study.measured()
    lacking = [c for c in coordinates if c.target not in explained]
    lacking = lacking or [min(coordinates, key=lambda c: explained[c.target])]
    if len(lacking) == len(coordinates) or any(c.angle for c in lacking):
        return ()
    names = " and ".join(c.name for c in lacking)
    monitor.tell(Progress("inputs", f"search with {names} as input", 0, 1))
    with suppress(NoModelError, InputError):  # candidates that a study names may hold the rate of what is now an input
        _, found = run(_with_inputs(study, [c.name for c in lacking]), replace(monitor, tell=unheard))
        if found.exact:
            law = "; ".join(equation_lines(found.model, DIGITS))
            return (
                f"nothing in the record was found to move {names}, and with {names} as input the rest has a law"
                f" ({law}): where something outside moves {names}, name it under [inputs] instead of [coordinates];"
                " otherwise record what moves it too",
            )
    return ()


def _with_inputs(study: Study, names: Sequence[str]) -> Study:
    """Return a study in which these coordinates are inputs; no functions are looked for that it does not name."""
    moved = {n: Driven(column=study.coordinates[n].column, unit=study.coordinates[n].unit) for n in names}
    return msgspec.structs.replace(
        study,
        coordinates={name: c for name, c in study.coordinates.items() if name not in names},
        inputs={**study.inputs, **moved},
        library=msgspec.structs.replace(study.library, suspect=False),
    )
