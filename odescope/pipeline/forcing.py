"""What is periodic in time or along a position: one identification more with its sine, where a residual is periodic.

docs/method.md, Suspicion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeVar

import msgspec
import numpy as np

from odescope.errors import InputError, NoModelError
from odescope.events import Event, Monitor, Note, Progress
from odescope.library.expression import ONE, Term
from odescope.library.readable import readable
from odescope.likelihood.periodic import Forcing, periodic
from odescope.likelihood.refinement import Refinement
from odescope.model.choice_notes import unsettled
from odescope.model.scores import SuspicionScore
from odescope.pipeline.competition import NoLaw
from odescope.pipeline.contender import Contender
from odescope.pipeline.suspicion import replaces
from odescope.recordings.coordinate import TIME, free_name, state_names
from odescope.recordings.record import Records
from odescope.study.clock import keeps_time
from odescope.study.options import Study


class OfRecords(Protocol):
    """What was identified from recordings."""

    @property
    def records(self) -> Records:
        """The recordings, with the stamps that they were read with."""


Result = TypeVar("Result", bound=OfRecords)
Ended = TypeVar("Ended", bound=Event)


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
        result, contender = run(study, replace(monitor, tell=without(monitor, in_vain, ended)))
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
    if before.exact or before.late or not study.suspects or before.hardly_off:
        return None
    forcing = periodic(before.space, _positions(study))
    if forcing is None:
        return None
    rate = _rate_of(study, forcing)
    if rate is None:
        return None, _score(before, forcing, (), ())
    waves = tuple(_times(forcing.beside, wave) for wave in _waves(records, forcing.variable, rate))
    monitor.tell(Progress("suspicion", "search with a sine of the rate at which the residual goes", 0, 1))
    try:
        named = _named(study, forcing, rate, waves)
        other, forced = run(named, replace(monitor, tell=without(monitor, in_vain, [])))
    except NoModelError:
        return None, _score(before, forcing, waves, ())
    except InputError:
        if forcing.variable is not None:
            raise
        return None, _score(before, forcing, (), ())  # the study is sound without the time, whose column holds dates
    found = _forcing(forced.refinement, rate)
    if forced.refinement is not None and found and replaces(forced.refinement, before):
        return (other, forced), _score(before, forcing, waves, found)
    return None, _score(before, forcing, waves, ())


def _positions(study: Study) -> tuple[str, ...]:
    """Return the positions of which a sine may be a candidate: none where a study asks for other than relations.

    A sine of a rate is no force of a machine, and what the user calls cyclic does not itself appear.
    """
    if study.library.own_form not in (None, "relations"):
        return ()
    return tuple(c.name for c in study.measured() if c.order > 1 and not c.cyclic)


def _rate_of(study: Study, forcing: Forcing) -> str | None:
    """Return what the rate of a forcing is called, None where the time cannot be named."""
    name = f"rate_{forcing.variable or TIME}"
    if forcing.variable is None:
        return name if keeps_time(study) and name not in study.parameters else None
    taken = {*state_names(study.measured()), *study.inputs, *study.parameters, *study.library.functions}
    return free_name(name, taken)


def _waves(records: Records, variable: str | None, rate: str) -> tuple[str, ...]:
    """Return sine and cosine of a variable, or of what it is from its middle on where it keeps far from 0.

    Far from the origin a sine of another rate is one of another phase, and a fit cannot tell them apart.

    Args:
        records: where the variable was recorded.
        variable: a position; None: the time.
        rate: what its rate is called.
    """
    columns = [run.t if variable is None else run.column(variable) for run in records]
    begin, end = min(float(c.min()) for c in columns), max(float(c.max()) for c in columns)
    name, middle = variable or TIME, 0.5 * (begin + end)
    if abs(middle) < end - begin:
        return f"sin({rate}*{name})", f"cos({rate}*{name})"
    digits = 0 if variable is None else 1 - int(np.floor(np.log10(end - begin)))
    rounded = round(middle, digits)
    since = f"({name} {'-' if rounded > 0.0 else '+'} {abs(rounded):.{max(digits, 0)}f})"
    return f"sin({rate}*{since})", f"cos({rate}*{since})"


def _times(beside: Term, wave: str) -> str:
    return wave if beside == ONE else f"{readable(beside)}*{wave}"


def _named(study: Study, forcing: Forcing, rate: str, waves: tuple[str, ...]) -> Study:
    """Return the study with a forcing among the candidates of its relations.

    Args:
        study: the options.
        forcing: that is named.
        rate: what its rate is called.
        waves: its sine and cosine.
    """
    own, low = study.library, max(forcing.rate - forcing.width, 0.5 * forcing.rate)
    library = msgspec.structs.replace(
        own, extra=(*own.extra, *waves), parameters={**own.parameters, rate: (low, forcing.rate + forcing.width)}
    )
    return msgspec.structs.replace(study, library=library)


def without(monitor: Monitor, kind: type[Ended], ended: list[Ended]) -> Callable[[Event], None]:
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


def _forcing(refinement: Refinement | None, rate: str) -> tuple[str, ...]:
    """Return the terms of a model that hold the rate, as people read them."""
    present = () if refinement is None else (refinement.space.mechanisms[k] for k in refinement.fit.present)
    return tuple(dict.fromkeys(readable(p.product.term) for m in present if rate in m.names for p in m.parts))


def _score(before: Refinement, forcing: Forcing, tried: tuple[str, ...], found: tuple[str, ...]) -> SuspicionScore:
    """Return what was made of a periodic residual; the range is that of the rate that it goes at."""
    target = before.space.frame.targets[forcing.relation]
    low, high = forcing.rate - forcing.width, forcing.rate + forcing.width
    variable, reason = (forcing.variable, "recurring") if forcing.variable else (TIME, "periodic")
    if forcing.beside != ONE:
        variable, reason = readable(forcing.beside), "swinging"
    return SuspicionScore(target, variable, reason, 0, low, high, tried, found, None)
