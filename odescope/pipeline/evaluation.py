"""What model.json says beside the equations: how they fit, where they hold, what they were made from."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from odescope.arrays import FloatArray
from odescope.likelihood.account import likelihood_scores
from odescope.likelihood.refine import Refinement
from odescope.model.explicit import denominator_ranges
from odescope.model.model import Json, Model
from odescope.model.simulation import simulate
from odescope.pipeline.joint_models import Search, samples_of
from odescope.pipeline.reduce import Whole
from odescope.selection.ranking import Candidate
from odescope.signals.estimate import Signals
from odescope.study.options import Study

VALID_ERROR = 0.3  # the normalised state error that ends the valid time (METHOD section 10)


def domain(signals: Signals, model: Model, whole: Whole | None) -> dict[str, tuple[float, float]]:
    """Return the range of every state and input over all the data."""
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
) -> dict[str, Json]:
    """Return how well each target is predicted, how far a free run holds, and what the likelihood found."""
    rows = samples_of(signals, model)
    ranges = denominator_ranges(model, np.concatenate(rows, axis=1), np.random.default_rng(seed))
    targets: dict[str, Json] = {}
    for c, s in zip(chosen, searches, strict=True):
        denominator: dict[str, Json] = {where: list[Json](ends) for where, ends in ranges[c.target].items()}
        targets[c.target] = {
            "r2_held_out": c.target_r2,
            "rmse_held_out": c.target_rmse,
            "explained_held_out": c.explained,
            "condition": s.problem.factor.condition(c.support),
            "denominator": denominator,
        }
    longest = max(rows, key=lambda r: r.shape[1])
    scores: dict[str, Json] = {"targets": targets, "free_run": _free_run(model, signals, longest)}
    if refinement is not None:
        scores["likelihood"] = likelihood_scores(refinement, signals.targets)
    return scores


def _free_run(model: Model, signals: Signals, variables: FloatArray) -> dict[str, Json]:
    """Simulate the last fifth of the longest record from its first state; valid until the error passes 0.3."""
    tail = variables[:, -max(variables.shape[1] // 5, 2) :]
    states, inputs = tail[: len(model.states)].T, tail[len(model.states) :].T
    t = np.arange(len(states), dtype=np.float64) * np.float64(signals.period)
    run = simulate(model, t, np.ascontiguousarray(inputs), np.ascontiguousarray(states[0]))
    spread = np.maximum(np.concatenate(list(signals.columns), axis=1).std(axis=1), 1e-300)
    scale = np.array([spread[signals.row(s)] for s in model.states])
    reached = len(run.t)
    error = np.sqrt(np.mean(((run.states - states[:reached]) / scale) ** 2, axis=1))
    late = np.flatnonzero(error > VALID_ERROR)
    valid = float(t[late[0]]) if late.size else float(t[reached - 1])
    return {"duration": float(t[-1]), "valid_time": valid, "ended": run.ended}


def provenance(study: Study, signals: Signals, whole: Whole | None) -> dict[str, Json]:
    """Return what a model was made from."""
    columns: dict[str, Json] = dict(study.layout().columns)
    channels: dict[str, Json] = {c.name: {"noise": c.noise, "cutoff_hz": c.cutoff} for c in signals.channels}
    return {
        "odescope": version("odescope"),
        "time": study.data.time,
        "columns": columns,
        "channels": channels,
        "recordings": len(signals.columns) if whole is None else whole.recordings,
        "seed": study.random.seed,
    }
