"""A forcing that was not recorded: one identification more with a sine of the time, where a residual is periodic.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeVar

import msgspec

from odescope.errors import InputError, NoModelError
from odescope.events import Event, Monitor, Note, Progress
from odescope.library.readable import readable
from odescope.likelihood.periodic import Forcing, periodic
from odescope.likelihood.refine import Refinement
from odescope.model.choice_notes import unsettled
from odescope.model.scores import SuspicionScore
from odescope.pipeline.competition import Contender, NoLaw
from odescope.pipeline.suspicion import replaces
from odescope.recordings.record import Records
from odescope.study.clock import TIME, keeps_time
from odescope.study.options import Study

RATE = f"rate_{TIME}"


class OfRecords(Protocol):
    """What was identified from recordings."""

    @property
    def records(self) -> Records:
        """The recordings, with the stamps that they were read with."""


Result = TypeVar("Result", bound=OfRecords)


def with_forcing(
    study: Study,
    monitor: Monitor,
    run: Callable[[Study, Monitor], tuple[Result, Contender]],
    in_vain: type[Event],
) -> tuple[Result, Contender, tuple[SuspicionScore, ...]]:
    """Return the result, that with a forcing of the rate at which its residual goes where it is better, and the score.

    Args:
        study: the options; candidates that it fixes stay alone.
        monitor: told what goes on.
        run: identifies by a study.
        in_vain: what a run tells last that finds no model.
    """
    ended = list[Event]()
    try:
        result, contender = run(study, replace(monitor, tell=_without(monitor, in_vain, ended)))
    except NoModelError as failure:
        sought = None
        if isinstance(failure, NoLaw) and failure.refinement is not None and failure.records is not None:
            sought = _sought(study, monitor, run, in_vain, failure.refinement, failure.records)
        if sought is None or sought[0] is None:
            notes = [] if sought is None else [Note(text, warns=True) for text in unsettled([sought[1]])]
            for event in (*notes, *ended):
                monitor.tell(event)
            raise
        return (*sought[0], (sought[1],))
    before = contender.refinement
    sought = None if before is None else _sought(study, monitor, run, in_vain, before, result.records)
    if sought is None:
        return result, contender, ()
    return (*(sought[0] or (result, contender)), (sought[1],))


def _sought(
    study: Study,
    monitor: Monitor,
    run: Callable[[Study, Monitor], tuple[Result, Contender]],
    in_vain: type[Event],
    before: Refinement,
    records: Records,
) -> tuple[tuple[Result, Contender] | None, SuspicionScore] | None:
    """Return the run with a forcing where that is better, and the score; None where nothing is suspected.

    Args:
        study: the options.
        monitor: told what goes on.
        run: identifies by a study.
        in_vain: what a run tells last that finds no model.
        before: what follows the record without a forcing.
        records: the recordings.
    """
    if before.exact or before.late or not study.suspects:
        return None
    forcing = periodic(before.space)
    if forcing is None:
        return None
    if not keeps_time(study) or RATE in study.parameters:
        return None, _score(before, forcing, (), ())
    waves = _waves(records)
    monitor.tell(Progress("suspicion", "search with a forcing of the rate at which the residual goes", 0, 1))
    try:
        other, forced = run(_named(study, forcing, waves), replace(monitor, tell=_without(monitor, in_vain, [])))
    except NoModelError:
        return None, _score(before, forcing, waves, ())
    except InputError:  # the study is sound without the time, whose column holds dates
        return None, _score(before, forcing, (), ())
    found = _forcing(forced.refinement)
    if forced.refinement is not None and found and replaces(forced.refinement, before):
        return (other, forced), _score(before, forcing, waves, found)
    return None, _score(before, forcing, waves, ())


def _waves(records: Records) -> tuple[str, ...]:
    """Return sine and cosine of the time, or of the time since the middle of recordings whose stamps begin far from 0.

    Far from the origin a sine of another rate is one of another phase, and a fit cannot tell them apart.
    """
    begin, end = min(float(run.t[0]) for run in records), max(float(run.t[-1]) for run in records)
    middle = round(0.5 * (begin + end))
    since = TIME if abs(middle) < end - begin else f"({TIME} - {middle})"
    return f"sin({RATE}*{since})", f"cos({RATE}*{since})"


def _named(study: Study, forcing: Forcing, waves: tuple[str, ...]) -> Study:
    """Return the study with a forcing among the candidates of its relations."""
    own, low = study.library, max(forcing.rate - forcing.width, 0.5 * forcing.rate)
    library = msgspec.structs.replace(
        own, extra=(*own.extra, *waves), parameters={**own.parameters, RATE: (low, forcing.rate + forcing.width)}
    )
    return msgspec.structs.replace(study, library=library)


def _without(monitor: Monitor, kind: type[Event], ended: list[Event]) -> Callable[[Event], None]:
    """Return what tells a monitor all but one kind of events, which it collects.

    Args:
        monitor: to be told.
        kind: of events that it is not told.
        ended: collects those.
    """

    def tell(event: Event) -> None:
        if isinstance(event, kind):
            ended.append(event)
        else:
            monitor.tell(event)

    return tell


def _forcing(refinement: Refinement | None) -> tuple[str, ...]:
    """Return the terms of a model that hold the rate, as people read them."""
    present = () if refinement is None else (refinement.space.mechanisms[k] for k in refinement.fit.present)
    return tuple(dict.fromkeys(readable(p.product.term) for m in present if RATE in m.names for p in m.parts))


def _score(before: Refinement, forcing: Forcing, tried: tuple[str, ...], found: tuple[str, ...]) -> SuspicionScore:
    """Return what was made of a periodic residual; the range is that of the rate that it goes at."""
    target = before.space.frame.targets[forcing.relation]
    low, high = forcing.rate - forcing.width, forcing.rate + forcing.width
    return SuspicionScore(target, TIME, "periodic", 0, low, high, tried, found, None)
