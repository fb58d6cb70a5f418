"""The free runs of the model that was found."""

from __future__ import annotations

from dataclasses import replace

import msgspec

from odescope.model.model import Model
from odescope.model.scores import ModelScores
from odescope.pipeline.evaluation import free_run_scores
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.work import Work
from odescope.validation.free_runs import FreeRunOf, free_runs


def run_freely(work: Work, seen: Filtered, model: Model) -> tuple[Model, tuple[FreeRunOf, ...]]:
    """Return the model with the scores of its free runs from the starts of the recordings, and these.

    Args:
        work: whose monitor may stop them.
        seen: the records and signals as the model sees them.
        model: to run.
    """
    runs = free_runs(model, seen.undelayed, work.monitor.check)
    told = free_run_scores(model, runs, seen.undelayed, seen.signals)
    judged = ModelScores() if model.scores is None else model.scores
    return replace(model, scores=msgspec.structs.replace(judged, free_runs=told)), runs
