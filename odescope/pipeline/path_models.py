"""The models on the path from many terms to few, as models that can be taken instead of the chosen one."""

from __future__ import annotations

from collections.abc import Sequence

from odescope.likelihood.path import ModelPath
from odescope.likelihood.refinement import Refinement
from odescope.model.model import Model
from odescope.model.scores import PathScore
from odescope.recordings.coordinate import Input
from odescope.signals.estimate import Signals


def path_scores(refinement: Refinement | None) -> tuple[PathScore, ...]:
    """Return how every model on the path did; nothing where there is no path."""
    path = _path(refinement)
    if path is None:
        return ()
    return tuple(
        PathScore(
            terms=step.terms,
            error=step.error,
            spread=step.spread,
            dropped=None if step.dropped is None else str(step.dropped),
            statistic=None if step.dropped is None else step.statistic,
            chosen=number == path.chosen,
        )
        for number, step in enumerate(path.steps)
    )


def path_models(refinement: Refinement | None, signals: Signals, inputs: Sequence[Input]) -> Sequence[Model]:
    """Return the models on the path, the longest first, fitted without what was held out.

    Args:
        refinement: that the path belongs to, if there is any.
        signals: name the coordinates.
        inputs: as they were given to the likelihood stage.
    """
    path = _path(refinement)
    if path is None:
        return ()
    models = list[Model]()
    for step in path.steps:
        scale = max(step.fit.data_cost / path.space.segments.samples, 1.0)
        covariance = step.fit.covariance * scale
        found = path.space.settings_of(step.fit, covariance)
        models.append(
            Model(
                found.coordinates(signals.coordinates),
                found.inputs(inputs),
                path.space.relations_of(step.fit, covariance),
                mechanisms=path.space.mechanisms_of(step.fit, covariance),
                parameters=found.parameters,
            )
        )
    return models


def _path(refinement: Refinement | None) -> ModelPath | None:
    return None if refinement is None or not refinement.follows else refinement.path
