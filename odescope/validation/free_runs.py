"""Free runs of a model over recordings, each from a state that is fitted to the first stretch of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from odescope.model.driven_record import DrivenRecord
from odescope.model.initial_state import first_state_of
from odescope.model.model import Model
from odescope.model.scores import CoordinateRun, FreeRun
from odescope.model.simulation import Trajectory, follow
from odescope.parallel.workers import Threads, nothing
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Record, Records
from odescope.validation.agreement import Pair, agreement, turned, valid_time

MOST_RECORDINGS = 48  # that are run freely where nobody asked for them all
MOST_SAMPLES = 500_000  # of these together: of longer recordings the first part is run
OFF = 1e-3  # of the standard deviations of its states: so far off begins the run that shows whether errors grow


@dataclass(frozen=True, eq=False)
class FreeRunOf:
    """The free run of one model over one recording, by its number from 1, beside what was measured.

    Samples with `counts` of 0 are not compared: nobody measured them, or what acted then was not recorded.
    """

    model: str
    number: int
    record: Record
    run: Trajectory


def run_freely(model: Model, piece: DrivenRecord) -> Trajectory:
    """Return the free run over a record, or a piece of one, from a state fitted to its first stretch."""
    return follow(model, piece.record.t, piece.driven, first_state_of(model, piece))


def free_runs(model: Model, records: Records, check: Callable[[], None] = nothing) -> tuple[FreeRunOf, ...]:
    """Return the free runs from the start of every recording; of very many, of some that are spread over them.

    Args:
        model: its coordinates and inputs are columns of the records.
        records: as they were recorded, whatever the offsets of coordinates and the delays of inputs.
        check: called several times a second; what it raises ends them.
    """
    count = min(len(records), MOST_RECORDINGS)
    numbers = np.rint(np.linspace(0, len(records) - 1, count)).astype(np.int64).tolist()
    return tuple(Threads().map(_free_run, numbers, model, records, MOST_SAMPLES // max(count, 1), check=check))


def _free_run(number: int, model: Model, records: Records, longest: int) -> FreeRunOf:
    """Return the free run over a recording.

    Args:
        number: of the recording, from 0.
        model: that runs.
        records: all recordings.
        longest: number of samples that are run at most.
    """
    record = records.runs[number]
    whole = DrivenRecord.of(model, record)
    piece = whole if len(record) <= longest else whole.part(0, longest)
    return FreeRunOf("model", number + 1, piece.compared(model), run_freely(model, piece))


def beside(c: Coordinate, of: FreeRunOf, noise: float) -> tuple[Pair, float]:
    """Return what was measured of a coordinate beside a free run, as far as that goes, and the valid time in seconds.

    Args:
        c: the coordinate.
        of: the run.
        noise: standard deviation of a sample of the coordinate, 0 where it is not known.
    """
    record, there = of.record, of.record.counted(c.name) > 0.0
    measured, predicted = record.column(c.name), of.run.column(c.name) + c.offset
    seen = there[: len(predicted)]
    if not seen.any():
        return (measured[:0], predicted[:0]), 0.0
    measured, predicted, t = measured[there], predicted[seen], record.t[there]
    predicted = turned(predicted, measured) if c.angle else predicted
    valid = valid_time(t, measured, predicted, noise)
    # Samples that do not count, at either end, were stayed with where those between them were.
    whole = valid >= float(t[len(predicted) - 1] - t[0])
    end = float(of.run.t[-1]) if whole else valid + float(t[0])
    return (measured[: len(predicted)], predicted), end - float(record.t[0])


def free_run_score(model: Model, of: FreeRunOf, noise: Mapping[str, float], recorded: float) -> FreeRun:
    """Return how a free run went.

    Args:
        model: that was run.
        of: the run.
        noise: standard deviation of a sample, by coordinate; one that it lacks counts as 0.
        recorded: length in seconds of the recording, of which the run may have followed a first part.
    """
    found = dict(_coordinates(model, of, noise))
    duration = of.record.duration
    valid = min((c.valid_time for c in found.values()), default=duration)
    return FreeRun(
        duration=duration,
        valid_time=valid,
        ended=of.run.ended,
        recording=of.number,
        recorded=recorded if recorded > duration else None,
        coordinates=found,
        growth=None if valid >= duration else growth(model, of, valid),
    )


def growth(model: Model, of: FreeRunOf, until: float) -> float | None:
    """Return how many times further off than at its start a run gets that begins beside a free run.

    All states begin off by a thousandth of their standard deviations until then, in which they count. None where the
    model rests.

    Args:
        model: that was run.
        of: the run.
        until: seconds, up to when they are compared; no later than it ended.
    """
    t = of.record.t
    count = max(int(np.searchsorted(t - t[0], until, side="right")), 2)
    states = of.run.states[:count]
    sizes = states.std(axis=0)
    moves = sizes > 0.0
    if not moves.any():
        return None
    begin = DrivenRecord.of(model, of.record).part(0, count)
    other = follow(model, begin.record.t, begin.driven, states[0] + OFF * sizes)
    apart = (other.states - states[: len(other.t)])[:, moves] / (OFF * sizes[moves])
    return float(np.sqrt(np.mean(apart**2, axis=1)).max())


def _coordinates(model: Model, of: FreeRunOf, noise: Mapping[str, float]) -> Iterator[tuple[str, CoordinateRun]]:
    for c in model.coordinates:
        if not of.record.counted(c.name).any():
            continue
        pair, valid = beside(c, of, noise.get(c.name, 0.0))
        agreed = None if of.run.ended else agreement([pair])
        yield (
            c.name,
            CoordinateRun(
                valid_time=valid,
                fit=None if agreed is None else agreed.fit,
                rmse=None if agreed is None else agreed.rmse,
            ),
        )
