"""What model.json says beside the equations: how they fit, where they hold, what they were made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import NoModelError
from odescope.likelihood.findings import likelihood_scores
from odescope.likelihood.refine import Refinement
from odescope.model.denominators import denominator_ranges
from odescope.model.model import Json, Model, without_delays
from odescope.model.scores import Denominator, FreeRun, ModelScores, TargetScore, TimeScore
from odescope.model.simulation import Trajectory, simulate
from odescope.pipeline.joint_models import Search, samples_of
from odescope.pipeline.reduce import Whole
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.record import Records
from odescope.selection.ranking import Candidate
from odescope.signals.estimate import Signals
from odescope.study.options import Study

VALID_ERROR = 0.3  # the normalised state error that ends the valid time
FIFTH = 5  # of the longest record: its last part


def domain(signals: Signals, model: Model, whole: Whole | None) -> dict[str, tuple[float, float]]:
    """Return the range of every state and input over all the data.

    Args:
        signals: what is in memory.
        model: whose states and inputs are meant.
        whole: what was read of a log that does not fit in memory.
    """
    joined = np.concatenate(samples_of(signals, model), axis=1)
    low, high = joined.min(axis=1), joined.max(axis=1)
    if whole is not None:
        index = [signals.row(name) for name in model.variables]
        low, high = np.minimum(low, whole.low[index]), np.maximum(high, whole.high[index])
    return dict(zip(model.variables, zip(low.tolist(), high.tolist(), strict=True), strict=True))


def scores(
    model: Model,
    signals: Signals,
    searches: Sequence[Search],
    chosen: Sequence[Candidate],
    refinement: Refinement | None,
    seed: int,
) -> ModelScores:
    """Return how well each target is predicted, how far a free run holds, and what the likelihood found.

    What held-out data say of a candidate of the regression is not said of mechanisms: their relations share
    coefficients, and free runs judge them instead.

    Args:
        model: what was found.
        signals: what it was found in.
        searches: the search of every target, in their order.
        chosen: the candidate of every target with the model's terms.
        refinement: the end of the likelihood stage, where it ran.
        seed: of the points that sample the box of the data.
    """
    every = np.concatenate(samples_of(signals, model), axis=1)
    ranges = denominator_ranges(model, every, np.random.default_rng(seed))
    sound = {target: _denominator(**ranges[target]) for target in model.targets}
    return ModelScores(
        targets={target: TargetScore(denominator=d) for target, d in sound.items()}
        if model.mechanisms
        else {
            c.target: TargetScore(
                r2_held_out=float(c.target_r2),
                rmse_held_out=float(c.target_rmse),
                explained_held_out=float(c.explained),
                condition=float(s.problem.factor.condition(c.support)),
                denominator=sound[c.target],
            )
            for c, s in zip(chosen, searches, strict=True)
        },
        free_run=free_run(model, signals),
        likelihood=None if refinement is None else likelihood_scores(refinement, signals.targets),
    )


def _denominator(data: Sequence[float], box: Sequence[float]) -> Denominator:
    return Denominator((data[0], data[1]), (box[0], box[1]))


@dataclass(frozen=True, eq=False)
class LastPart:
    """The last part of the longest record, on which a model is seen at work.

    `record` is the record's number, `first` its first sample that belongs to the part; `t` (N,) seconds from there,
    states (N, n) and inputs (N, m) in the order of the model's.
    """

    record: int
    first: int
    t: FloatArray
    states: FloatArray
    inputs: FloatArray

    @staticmethod
    def of(signals: Signals, model: Model) -> LastPart:
        """Return the last part of some signals."""
        rows = samples_of(signals, model)
        record = int(np.argmax([r.shape[1] for r in rows]))
        first = rows[record].shape[1] - max(rows[record].shape[1] // FIFTH, 2)
        states, inputs = np.split(rows[record][:, first:].T, [len(model.states)], axis=1)
        t = np.arange(len(states), dtype=np.float64) * np.float64(signals.period)
        return LastPart(record, first, t, np.ascontiguousarray(states), np.ascontiguousarray(inputs))

    def run(self, model: Model) -> Trajectory:
        """Simulate a model freely from the first state of the part."""
        # The inputs of signals are shifted to when they act: no delay is left for the simulation.
        return simulate(without_delays(model), self.t, self.inputs, self.states[0])


def free_run(model: Model, signals: Signals) -> FreeRun:
    """Return how a free run over the last part went: valid until its error passes 0.3 of the spread of the states."""
    part = LastPart.of(signals, model)
    run = part.run(model)
    spread = np.maximum(np.concatenate(list(signals.columns), axis=1).std(axis=1), 1e-300)
    scale = np.array([spread[signals.row(s)] for s in model.states])
    reached = len(run.t)
    error = np.sqrt(np.mean(((run.states - part.states[:reached]) / scale) ** 2, axis=1))
    late = np.flatnonzero(error > VALID_ERROR)
    valid = float(part.t[late[0]]) if late.size else float(part.t[reached - 1])
    return FreeRun(duration=float(part.t[-1]), valid_time=valid, ended=run.ended)


def require_prediction(found: ModelScores | None, follows: bool) -> None:
    """Refuse a model that predicts a target worse than its mean would, and that no likelihood says follows the record.

    Args:
        found: the scores of the model.
        follows: whether the likelihood stage says so; what held-out data say is then of another fit.

    Raises:
        NoModelError: a target is predicted worse than by its mean.
    """
    for target, held_out in () if found is None or follows else found.targets.items():
        r2 = held_out.r2_held_out
        if r2 is not None and r2 < 0.0:
            raise NoModelError(
                "model",
                f"on held-out data the best relation for {target} is further off than the mean of {target} is"
                f" (R² = {r2:.3g}), and no model follows the record: the library lacks the right terms, or there is too"
                " much noise",
            )


def time_score(records: Records, coordinates: Sequence[Coordinate]) -> TimeScore | None:
    """Return what was wrong with the time of recordings; None where nothing was.

    Args:
        records: as they were read.
        coordinates: what was measured.
    """
    repairs = [run.repairs for run in records]
    lacking = {c.name: [run.counted(c.name) == 0.0 for run in records] for c in coordinates}
    missing = {
        name: (sum(int(m.sum()) for m in cells), sum(int(np.sum(np.diff(m, prepend=False) & m)) for m in cells))
        for name, cells in lacking.items()
    }
    found = TimeScore(
        rows=sum(r.rows for r in repairs),
        disordered=sum(r.disordered for r in repairs),
        doubled=sum(r.doubled for r in repairs),
        jitter=max(r.jitter for r in repairs),
        samples=records.samples,
        missing={name: told for name, told in missing.items() if told[0]},
    )
    return found if found.disordered or found.doubled or found.jitter or found.missing else None


def provenance(study: Study, signals: Signals, whole: Whole | None) -> dict[str, Json]:
    """Return what a model was made from.

    Args:
        study: the options.
        signals: with what was found in every channel.
        whole: what was read of a log that does not fit in memory.
    """
    columns: dict[str, Json] = dict(study.layout().columns)
    channels: dict[str, Json] = {c.name: {"noise": c.noise, "cutoff_hz": c.cutoff} for c in signals.channels}
    degrees: Json = [name for name in columns if name in study.degrees]
    return {
        "odescope": version("odescope"),
        "time": study.data.time,
        **({"time_unit": study.data.time_unit} if study.data.time_unit else {}),
        "columns": columns,
        **({"degrees": degrees} if degrees else {}),
        "channels": channels,
        "recordings": len(signals.columns) if whole is None else whole.recordings,
        "seed": study.random.seed,
    }
