"""Inputs with a cell now and then: whether they run on between their cells or hold them is decided by two runs.

docs/method.md, Inputs between samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeVar

import msgspec
import numpy as np

from odescope.errors import NoModelError
from odescope.events import Event, Monitor
from odescope.likelihood.holds import DEAREST
from odescope.model.scores import HoldScore
from odescope.pipeline.contender import SPREAD, Contender, best_of
from odescope.pipeline.forcing import OfRecords
from odescope.pipeline.inputs import first_holds
from odescope.recordings.gaps import GAP_PERIODS
from odescope.recordings.record import Records
from odescope.study.options import Study


class InVain(Protocol):
    """What a run tells last that finds no model."""

    @property
    def result(self) -> OfRecords:
        """What was done."""


Result = TypeVar("Result", bound=OfRecords)


def with_held_cells(
    study: Study, monitor: Monitor, run: Callable[[Study, Monitor], tuple[Result, Contender]], in_vain: type[InVain]
) -> tuple[Result, Contender, dict[str, HoldScore]]:
    """Return the result, that with coarsely sampled inputs held from cell to cell where it is better, and their holds.

    Records lay an input out before any likelihood sees it, in lines from one cell to the next: of a command that is
    written at every tenth row, or when it changes, no hold of what lies on the grid makes steps again.

    Args:
        study: the options; inputs whose hold it says stay as they are.
        monitor: told what goes on.
        run: identifies by a study.
        in_vain: what a run tells last that finds no model.
    """
    ended, lost = list[Event](), list[InVain]()

    def tell(event: Event) -> None:
        if isinstance(event, in_vain):
            ended.append(event)
            lost.append(event)
        else:
            monitor.tell(event)

    listening = replace(monitor, tell=tell)
    try:
        lines = run(study, listening)
    except NoModelError:
        told, names = ended.copy(), coarse_inputs(lost[0].result.records, study) if lost else ()
        held = _held(study, names, listening, run)
        if held is None:
            for event in told:
                monitor.tell(event)
            raise
        return (*held, {name: HoldScore("zero", None) for name in names})
    names = coarse_inputs(lines[0].records, study)
    held = _held(study, names, listening, run)
    if held is None or not _better(held[1], lines[1]):
        return (*lines, {})
    return (*held, {name: HoldScore("zero", _gain(held[1], lines[1])) for name in names})


def _held(
    study: Study,
    names: tuple[str, ...],
    monitor: Monitor,
    run: Callable[[Study, Monitor], tuple[Result, Contender]],
) -> tuple[Result, Contender] | None:
    """Return what comes of a study with some inputs held, None without any and where that leads to no model.

    Args:
        study: the options.
        names: of the inputs.
        monitor: told what goes on.
        run: identifies by a study.
    """
    if not names:
        return None
    inputs = {n: msgspec.structs.replace(i, hold="zero") if n in names else i for n, i in study.inputs.items()}
    try:
        return run(msgspec.structs.replace(study, inputs=inputs), monitor)
    except NoModelError:
        return None


def coarse_inputs(records: Records, study: Study) -> tuple[str, ...]:
    """Return the inputs of open hold, begun in lines, that have far fewer samples than what moves.

    Args:
        records: as they were laid out.
        study: the options.
    """
    samples = {
        name: sum(int(np.count_nonzero(run.counted(name))) for run in records)
        for name in (*study.coordinates, *study.inputs)
        if name not in study.clocks
    }
    most = max(samples[name] for name in study.coordinates)
    lines = [i.name for i in first_holds(records, study) if i.hold == "linear" and study.inputs[i.name].hold == "auto"]
    return tuple(name for name in lines if GAP_PERIODS * samples.get(name, most) < most)


def _better(held: Contender, lines: Contender) -> bool:
    """Say whether holding cells is credibly better: like any hold it has to be beyond doubt."""
    if best_of([lines, held]) is lines:
        return False
    if (gain := _gain(held, lines)) is not None:
        return 2.0 * gain > DEAREST
    return held.exact or held.coefficients < lines.coefficients or lines.free_run > SPREAD * held.free_run


def _gain(held: Contender, lines: Contender) -> float | None:
    """Return what holding gains in log-likelihood, None where that does not compare, as under noise of the process."""
    if held.refinement is None or lines.refinement is None or lines.refinement.process is not None:
        return None
    gain = held.refinement.gained_over(lines.refinement)
    return None if gain is None else 0.5 * gain
