"""The samples of a log that do not count: what a result says of them, and none for a model that is run on new logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from odescope.arrays import FloatArray
from odescope.errors import NoModelError
from odescope.model.gated_notes import gated_sentence
from odescope.model.model import Model
from odescope.model.scores import GatedRange, GatedScore
from odescope.recordings.coordinate import Coordinate
from odescope.recordings.periods import sampled_alike
from odescope.recordings.record import Record, Records
from odescope.signals.differentiators import Spectral
from odescope.signals.gated import REASONS, Reasons, gated_records
from odescope.signals.outliers import MANY

TOLD = 3  # ranges of time, of one reason
FINE = 0.01  # of a sample period: to about so much times are told
EVEN = 1e-3  # of a period: what steps may differ by that a clock which counts from 1970 rounds


def counting_for(model: Model, records: Records) -> tuple[Records, tuple[str, ...]]:
    """Return new recordings of a model without the samples that say nothing of it, and sentences on these.

    They are told by the filtered signal, as when a model is identified, so that the model has no say in it. A model
    that was identified with all samples is run on all; of irregular recordings, of angles that wrap, and of logs of few
    samples, in which a knee looks like an outlier, all count.

    Args:
        model: whose coordinates are looked at.
        records: with these coordinates, as they were recorded.
    """
    smooth = all(_even(run) and not _wraps(run, model.coordinates) for run in records)
    if model.provenance.get("outliers", "gate") != "gate" or not smooth or records.samples < MANY:
        return records, ()
    whole = Records(tuple(_bridged(run, model.coordinates) for run in records))
    together = [whole] if sampled_alike(whole) else [Records((run,)) for run in whole]
    try:
        found = [gated_records(part, model.coordinates, Spectral()) for part in together]
    except NoModelError as error:
        return records, (f"all samples count: {error.message}",)
    reasons = {c.name: tuple(of for _, why in found for of in why[c.name]) for c in model.coordinates}
    scores = gated_scores(records, reasons)
    if not scores:
        return records, ()
    kept = Records(tuple(run for part, _ in found for run in part))
    return kept, tuple(gated_sentence(name, of) for name, of in scores.items())


def _even(run: Record) -> bool:
    steps = np.diff(run.t)
    return bool(np.ptp(steps) <= EVEN * steps.mean())


def _wraps(run: Record, coordinates: Sequence[Coordinate]) -> bool:
    return any(bool(np.any(np.abs(np.diff(run.column(c.name))) > np.pi)) for c in coordinates if c.angle)


def _bridged(run: Record, coordinates: Sequence[Coordinate]) -> Record:
    """Return a record with straight lines where nothing was measured: what stands there is nobody's word."""
    values = run.values.copy()
    for c in coordinates:
        there = run.counted(c.name) > 0.0
        if there.any() and not there.all():
            values[:, run.names.index(c.name)] = np.interp(run.t, run.t[there], run.column(c.name)[there])
    return replace(run, values=values)


def gated_scores(records: Records, reasons: Reasons) -> dict[str, tuple[GatedScore, ...]]:
    """Return how many samples of each coordinate were gated for each reason, and in which ranges of time.

    Times are those of the log, but for dates, which count from the first row of each recording.

    Args:
        records: whose samples they are.
        reasons: why each was gated.
    """
    scores, dated = {}, any(run.dated for run in records)
    times = [run.t - (run.t[0] if dated else 0.0) for run in records]
    digits = round(-math.log10(FINE * min(run.sample_period for run in records)))
    for name, found in reasons.items():
        told = []
        for k, reason in enumerate(REASONS, start=1):
            gone = [t[f == k] for t, f in zip(times, found, strict=True)]
            if total := sum(map(len, gone)):
                told.append(GatedScore(reason, total, *_ranges(gone, digits), dated))
        if told:
            scores[name] = tuple(told)
    return scores


def _ranges(times: Sequence[FloatArray], digits: int) -> tuple[tuple[GatedRange, ...], int]:
    """Return the fullest ranges of times (n,) a record, in order, to some decimals, and how many others there are.

    The times of a record are parted at the longest steps of all, so that few ranges come of it.
    """
    steps = np.sort(np.concatenate([np.diff(t) for t in times]))[::-1]
    cuts = max(TOLD - sum(len(t) > 0 for t in times), 0)
    longest = steps[cuts] if len(steps) > cuts else 0.0
    parts = [
        GatedRange(k, round(float(part[0]), digits), round(float(part[-1]), digits), len(part))
        for k, t in enumerate(times, start=1)
        for part in np.split(t, np.flatnonzero(np.diff(t) > longest) + 1)
        if len(part)
    ]
    kept = sorted(parts, key=lambda part: -part.samples)[:TOLD]
    return tuple(sorted(kept, key=lambda part: (part.recording, part.begin))), len(parts) - len(kept)
