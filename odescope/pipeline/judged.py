"""The model that won, with what model.json says beside its equations."""

from __future__ import annotations

from dataclasses import replace

import msgspec

from odescope.model.gate import gated_scores
from odescope.model.model import Model
from odescope.model.scores import Streamed
from odescope.pipeline.adopted import adopted
from odescope.pipeline.competition import Winner
from odescope.pipeline.evaluation import domain, provenance, scores, time_score
from odescope.pipeline.filtering import Filtered
from odescope.pipeline.found_settings import (
    delay_scores,
    hold_scores,
    offset_scores,
    present_mechanisms,
    suspicion_scores,
)
from odescope.pipeline.path_models import path_scores
from odescope.pipeline.physics import constants_of, energy_of
from odescope.pipeline.regressed import Regressed
from odescope.study.options import Study


def judged(study: Study, filtered: Filtered, regressed: Regressed, winner: Winner) -> Model:
    """Return the model with its scores, its domain and what it was made from.

    Args:
        study: the options.
        filtered: the data, with what the model says of its inputs.
        regressed: what regression led to.
        winner: what it is of.
    """
    model, refinement = winner.model, winner.refinement
    signals, sample, whole = filtered.signals, filtered.sample, regressed.whole
    told = scores(model, signals, *adopted(regressed.searches, model), refinement, study.random.seed)
    acting = [i for i in model.inputs if i.name in model.held]
    present = present_mechanisms(model, refinement)
    told = msgspec.structs.replace(
        told,
        left_out=filtered.left_out,
        outliers=filtered.outliers,
        gated=gated_scores(filtered.undelayed, filtered.gated),
        time=time_score(sample.records, study.measured(), acting, study.data.gaps == "split"),
        delays=delay_scores(filtered.delays, model, refinement),
        offsets=offset_scores(model, refinement),
        holds=hold_scores(model, refinement),
        streamed=None if whole is None else Streamed(whole.rows, whole.chunks, sampled=len(sample.chunks)),
        forms=winner.forms,
        suspicions=suspicion_scores(winner.suspicions, model, refinement),
        path=path_scores(refinement),
        energy=energy_of(model, signals),
        conserved=() if whole is not None else constants_of(filtered.records, signals, present),
    )
    made_from = provenance(study, signals, whole)
    return replace(model, scores=told, domain=domain(filtered, model, whole), provenance=made_from)
