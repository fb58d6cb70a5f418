"""Inputs so late that nothing at hand is a law of them: one identification more with their delays looked for first."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TypeVar

import msgspec

from odescope.errors import NoModelError
from odescope.events import DelaysEstimated, Event, Monitor, Progress
from odescope.likelihood.path import TELLING
from odescope.pipeline.contender import Contender
from odescope.pipeline.forcing import without
from odescope.study.options import Study

Result = TypeVar("Result")


def with_late_inputs(
    study: Study, monitor: Monitor, run: Callable[[Study, Monitor], tuple[Result, Contender]], in_vain: type[Event]
) -> tuple[Result, Contender]:
    """Return the result or, where there is none, that with open delays estimated before regression, if it is exact.

    The likelihood finds a delay from where regression puts a model. Beyond a third of the shortest period what acts
    has little to do with what was recorded at that time, and regression puts none; or one that a search leaves far from
    the record, most of it noise of the process.

    Args:
        study: the options; delays that it states stay.
        monitor: told what goes on.
        run: identifies by a study.
        in_vain: what a run tells last that finds no model: told where no delays lead to one.

    Raises:
        NoModelError: neither leads to a model.
    """
    late = [name for name, i in study.inputs.items() if i.delay == "auto"]
    if not late:
        return run(study, monitor)
    ended = list[Event]()
    told = replace(monitor, tell=without(monitor, in_vain, ended))
    first, failure = None, None
    try:
        first = run(study, told)
    except NoModelError as error:
        failure = error
    if first is not None and not _late_and_far(first[1]):
        return first
    monitor.tell(Progress("delays", "search with delays estimated before regression", 0, 1))
    looked_for = {name: msgspec.structs.replace(study.inputs[name], delay="estimate") for name in late}
    estimated = msgspec.structs.replace(study, inputs={**study.inputs, **looked_for})
    with suppress(NoModelError):
        tell = partial(_unless_none_is_late, without(monitor, in_vain, []))
        result, contender = run(estimated, replace(monitor, tell=tell))
        # An input that is shifted at will imitates a state that lacks: noise of the process would take the rest.
        if contender.exact:
            return result, contender
    for event in ended:
        monitor.tell(event)
    if first is None:
        assert failure is not None
        raise failure
    return first


def _unless_none_is_late(tell: Callable[[Event], None], event: Event) -> None:
    """Tell an event; that no input acts late ends what would only find again what was found before.

    Raises:
        NoModelError: that is what it tells.
    """
    if isinstance(event, DelaysEstimated) and not any(event.delays.values()):
        raise NoModelError("delays", "no input acts late")
    tell(event)


def _late_and_far(contender: Contender) -> bool:
    """Say whether inputs act later than a sample, and free runs of a model with noise of the process are far off."""
    refinement = contender.refinement
    if refinement is None or refinement.process is None:
        return False
    if refinement.late or refinement.free_run_error < TELLING:  # no time is left for it, or all is well
        return False
    segments = refinement.space.segments
    return any(found.delay > segments.step / segments.block for found in refinement.settings.delays.values())
