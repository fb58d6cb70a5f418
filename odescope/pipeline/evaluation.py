"""What model.json says beside the equations: how they fit, where they hold, what they were made from."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

import msgspec
import numpy as np

from odescope.arrays import BoolArray
from odescope.errors import NoModelError
from odescope.likelihood.findings import doubts, likelihood_scores, unexplained_shares
from odescope.likelihood.refinement import Refinement
from odescope.model.denominators import denominator_ranges
from odescope.model.model import Json, Model
from odescope.model.quantity_units import quantity_units, shown
from odescope.model.scores import Denominator, Doubts, FreeRun, Likelihood, ModelScores, TargetScore
from odescope.model.time_score import TimeScore
from odescope.model.worth import FLOWS
from odescope.pipeline.adopted import Adopted
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.joint_models import Search, samples_of
from odescope.pipeline.reduce import Whole
from odescope.recordings.bridges import bridged
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.extremes import extremes
from odescope.recordings.record import Record, Records
from odescope.signals.estimate import Signals
from odescope.study.options import Study
from odescope.validation.free_runs import FreeRunOf, free_run_score


def domain(filtered: Filtered, model: Model, whole: Whole | None) -> dict[str, tuple[float, float]]:
    """Return the range of every state and input over all the data.

    Coordinates, less the offsets of their sensors, and inputs were where the samples that count say; where their rates
    were, and coordinates in what was not kept in memory, is known only of what is filtered.

    Args:
        filtered: what is in memory.
        model: whose states and inputs are meant.
        whole: what was read of a log that does not fit in memory.
    """
    signals = filtered.signals
    offsets = {c.name: c.offset for c in model.coordinates}
    recorded = {*offsets, *(i.name for i in model.inputs)}
    found = {}
    for name in model.variables:
        values = [columns[signals.row(name)] for columns in signals.columns]
        low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
        if name in recorded:
            ends = extremes(filtered.undelayed.stretches, name)
            low, high = (end - offsets.get(name, 0.0) for end in ends) if np.isfinite(ends).all() else (low, high)
        if whole is not None:
            row, offset = signals.row(name), offsets.get(name, 0.0)
            low, high = min(low, float(whole.low[row]) - offset), max(high, float(whole.high[row]) - offset)
        found[name] = (low, high)
    return found


def scores(
    model: Model,
    signals: Signals,
    searches: Sequence[Search],
    chosen: Adopted,
    refinement: Refinement | None,
    seed: int,
) -> ModelScores:
    """Return how well each target is predicted, and what the likelihood found.

    What held-out data say of a candidate of the regression is not said of mechanisms: their relations share
    coefficients, and free runs judge them instead.

    Args:
        model: what was found.
        signals: what it was found in.
        searches: the search of every target, in their order.
        chosen: the candidate of every target with the model's terms; of one without, held-out data say nothing.
        refinement: the end of the likelihood stage, where it ran.
        seed: of the points that sample the box of the data.
    """
    every = np.concatenate(samples_of(signals, model), axis=1)
    ranges = denominator_ranges(model, every, np.random.default_rng(seed))
    sound = {target: _denominator(**ranges[target]) for target in model.targets}
    return ModelScores(
        targets={target: TargetScore(denominator=d) for target, d in sound.items()}
        | {
            c.target: TargetScore(
                r2_held_out=float(c.target_r2),
                rmse_held_out=float(c.target_rmse),
                explained_held_out=float(c.explained),
                condition=float(s.problem.factor.condition(c.support)),
                denominator=sound[c.target],
            )
            for c, s in zip(chosen, searches, strict=True)
            if c is not None and not model.mechanisms
        },
        likelihood=None if refinement is None else _judged(refinement, signals),
    )


def _denominator(data: Sequence[float], box: Sequence[float]) -> Denominator:
    return Denominator((data[0], data[1]), (box[0], box[1]))


def _judged(refinement: Refinement, signals: Signals) -> Likelihood:
    """Return how the likelihood judged a model, with the share of each target that this leaves unexplained."""
    shares = unexplained_shares(refinement, signals)
    return msgspec.structs.replace(likelihood_scores(refinement, signals.targets), unexplained=shares or None)


def doubts_of(model: Model, refinement: Refinement | None) -> Doubts | None:
    """Return what the likelihood stage knows against its model, with the units of targets; None where it did not run.

    Args:
        model: that came of it.
        refinement: the end of the stage.
    """
    if refinement is None:
        return None
    units = quantity_units(model)
    return msgspec.structs.replace(
        doubts(refinement, model.targets), units={target: shown(units[target]) for target in model.targets}
    )


def free_run_scores(model: Model, runs: Sequence[FreeRunOf], records: Records, signals: Signals) -> tuple[FreeRun, ...]:
    """Return how free runs from the starts of the recordings went.

    Args:
        model: that was run.
        runs: over some or all of the recordings.
        records: all of these.
        signals: say how noisy each coordinate is.
    """
    noise = {c.name: c.noise for c in signals.channels}
    return tuple(free_run_score(model, of, noise, records.runs[of.number - 1].duration) for of in runs)


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


def require_model(model: Model, follows: bool, exact: bool) -> None:
    """Refuse what is no model: one that predicts nothing, and one that says of every target that it is zero.

    Args:
        model: that was found.
        follows: whether it follows the record, with process noise if need be.
        exact: whether it does without, which would explain anything.

    Raises:
        NoModelError: a target is predicted worse than by its mean, or no term is left in any equation.
    """
    require_prediction(model.scores, follows)
    if not exact and all(t.factor is not None for r in model.relations for t in r.terms):
        lacking = f"; {FLOWS}" if all(c.order == 1 for c in model.coordinates) else ""
        raise NoModelError(
            "likelihood",
            "no candidate earns its place, and without any the record is followed as noise alone: the library lacks"
            f" what moves it{lacking}",
        )


def time_score(
    records: Records, coordinates: Sequence[Coordinate], inputs: Sequence[Input], split: bool = False
) -> TimeScore | None:
    """Return what was wrong with the time of recordings; None where nothing was.

    Args:
        records: as they were read.
        coordinates: what was measured.
        inputs: what drove it.
        split: whether recordings were to be cut at all gaps.
    """
    repairs = [run.repairs for run in records]
    due = [_due(run) for run in records]
    lacking = {
        c.name: [run.counted(c.name)[d] == 0.0 for run, d in zip(records, due, strict=True)] for c in coordinates
    }
    missing = {
        name: (sum(int(m.sum()) for m in cells), sum(int(np.sum(np.diff(m, prepend=False) & m)) for m in cells))
        for name, cells in lacking.items()
    }
    found = TimeScore(
        rows=sum(r.rows for r in repairs),
        disordered=sum(r.disordered for r in repairs),
        doubled=sum(r.doubled for r in repairs),
        jitter=max(r.jitter for r in repairs),
        samples=sum(int(d.sum()) for d in due),
        missing={name: told for name, told in missing.items() if told[0]},
        bridged={i.name: gap for i in inputs if i.hold != "zero" and (gap := bridged(records, i.name))[0]},
        scatter=max(r.scatter for r in repairs),
        cut=sum(r.cut for r in repairs),
        unseen=sum(r.unseen for r in repairs),
        split=split,
        short=sum(r.short for r in repairs),
        clocked=tuple(i.name for i in inputs if any(i.name in r.clocked for r in repairs)),
        coarse=max(r.coarse for r in repairs),
    )
    rows = found.disordered or found.doubled or found.short
    repaired = rows or found.jitter or found.scatter or found.cut or found.coarse
    return found if repaired or found.missing or found.bridged else None


def _due(run: Record) -> BoolArray:
    """Return at which points (N,) of a recording samples were due: at every k-th on the grid of a faster one."""
    there = np.zeros(len(run), dtype=np.bool_)
    for name in run.names:
        there |= run.counted(name) > 0.0
    at = np.flatnonzero(there)
    steps = np.diff(at)
    every = int(np.gcd.reduce(steps)) if len(steps) else 1
    due = np.zeros(len(run), dtype=np.bool_)
    due[at[0] % every :: every] = True
    return due


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
        **({"sample_period": study.data.sample_period} if study.data.sample_period else {}),
        **({"date": study.data.date} if study.data.date else {}),
        **({"time_unit": study.data.time_unit} if study.data.time_unit else {}),
        **({"recording": study.data.recording} if study.data.recording else {}),
        "columns": columns,
        **({"degrees": degrees} if degrees else {}),
        **({"outliers": study.signals.outliers} if study.signals.outliers != "gate" else {}),
        "channels": channels,
        "recordings": len(signals.columns) if whole is None else whole.recordings,
        "seed": study.random.seed,
    }
