"""The model at work: its targets from instant to instant, and the same by fits that have not seen them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.model.model import Model
from odescope.model.prediction import predicted
from odescope.model.relation import Relation
from odescope.model.scores import hardly_varies
from odescope.pipeline.adopted import columns_of
from odescope.pipeline.identification import Identification
from odescope.pipeline.joint_models import samples_of
from odescope.report.data import AtWork, Chart, TargetFit
from odescope.report.free_runs import runs_over, runs_shown, thumbnails
from odescope.report.recorded import Clock, Trace, Truth, chart, labels, near, panel
from odescope.selection.ranking import left_column


def at_work(result: Identification, truth: Truth | None = None) -> AtWork:
    """Return predicted against estimated targets (Fig. 6), and free runs against the recordings (Fig. 7)."""
    targets, fits = targets_chart(result, truth)
    runs = runs_over(result)
    return AtWork(
        free_runs=thumbnails(result, runs),
        runs=runs_shown(result, runs),
        targets=targets,
        fits=fits,
        held_out=any(fit.refitted is not None for fit in fits),
    )


def targets_chart(result: Identification, truth: Truth | None = None) -> tuple[Chart, tuple[TargetFit, ...]]:
    """Return the targets over all the data, as estimated and as predicted, and how much of them is predicted."""
    clock, label, model, signals = Clock.of(result.records), labels(result), result.model, result.signals
    times, close = clock.kept(result), clock.close(result)
    variables = samples_of(signals, model)
    own = [predicted(model, rows) for rows in variables]
    refitted = held_out(result)
    panels, fits = [], []
    for k, target in enumerate(model.targets):
        estimated = [columns[signals.row(target)] for columns in signals.columns]
        traces: list[Trace] = [("estimated", "estimated", times, estimated)]
        if truth is not None and target in truth:
            traces.append(("truth", "truth", clock.raw()[:1], [truth[target]]))
        found = [values[k] for values in own]
        traces.append(("model", "model", *near(times, found, estimated)))
        unseen = None if refitted is None else [values[k] for values in refitted]
        if unseen is not None:
            traces.append(("its terms, fitted without this part", "refitted", *near(times, unseen, estimated)))
        panels.append(panel(label[target], traces, close))
        fits.append(
            TargetFit(
                target=target,
                model=_r2(estimated, found),
                refitted=None if unseen is None else _r2(estimated, unseen),
                varies=_varies(estimated, found),
            )
        )
    return chart(clock.label, panels), tuple(fits)


def held_out(result: Identification) -> list[FloatArray] | None:
    """Return the targets (T, N) of each record, every block of it as predicted by fits without the block's fold.

    The terms are those of the model, their coefficients those of a regression. None where the data are too short for
    blocks, or the library of the regression lacks a term, or the fit without a fold determines no model.
    """
    if not result.searches:
        return None
    problem = result.searches[0].problem
    models = without_folds(result)
    if models is None:
        return None
    rows = samples_of(result.signals, result.model)
    found = [np.full((len(result.model.targets), r.shape[1]), np.nan) for r in rows]
    for block in problem.blocks:
        inside = slice(block.start, block.stop)
        found[block.record][:, inside] = predicted(models[block.fold], rows[block.record][:, inside])
    return found


def without_folds(result: Identification) -> Mapping[int, Model] | None:
    """Return, by fold, the model's terms with coefficients regressed on all other folds; None as above."""
    found: dict[int, list[Relation]] = {}
    model = result.model
    for search, relation, shown in zip(result.searches, model.relations, model.shown_relations, strict=True):
        problem, columns = search.problem, columns_of(search, shown)
        if len(problem.folds) < 2 or columns is None:
            return None
        left = left_column(problem, columns)
        for fold, factor in problem.training.items():
            xi = factor.solve(tuple(sorted(columns)), left)
            terms = (
                replace(t, coefficient=float(xi[j]), std_error=None)
                for t, j in zip(relation.terms, columns, strict=True)
            )
            found.setdefault(fold, []).append(Relation(tuple(terms)))
    return {fold: replace(result.model, relations=tuple(own)) for fold, own in found.items()}


def _varies(estimated: list[FloatArray], values: list[FloatArray]) -> bool:
    """Say whether a target varies by so much that its R² says something."""
    r2, every = _r2(estimated, values), np.concatenate(estimated)
    if r2 is None:
        return False
    return not hardly_varies(r2, 1.0 - (1.0 - r2) * float(np.var(every) / np.mean(every**2)))


def _r2(estimated: list[FloatArray], values: list[FloatArray]) -> float | None:
    """Return the share of a target that is predicted, over all records; of one at rest, what varies is noise."""
    every, found = np.concatenate(estimated), np.concatenate(values)
    power = float(np.sum((every - every.mean()) ** 2))
    missed = float(np.sum((every - found) ** 2))
    return 1.0 - missed / power if power > 0.0 and np.isfinite(missed) else None
