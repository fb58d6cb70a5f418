"""What a result says of the samples that were gated: how many for which reason, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray
from odescope.model.scores import GatedRange, GatedScore
from odescope.recordings.record import Records
from odescope.signals.gated import REASONS, Reasons

TOLD = 3  # ranges of time, of one reason


def gated_scores(records: Records, reasons: Reasons) -> dict[str, tuple[GatedScore, ...]]:
    """Return how many samples of each coordinate were gated for each reason, and in which ranges of time.

    Args:
        records: whose samples they are.
        reasons: why each was gated.
    """
    scores = {}
    for name, found in reasons.items():
        told = []
        for k, reason in enumerate(REASONS, start=1):
            times = [run.t[f == k] - run.t[0] for run, f in zip(records, found, strict=True)]
            if total := sum(map(len, times)):
                told.append(GatedScore(reason, total, *_ranges(times)))
        if told:
            scores[name] = tuple(told)
    return scores


def _ranges(times: Sequence[FloatArray]) -> tuple[tuple[GatedRange, ...], int]:
    """Return the fullest ranges of times (n,) a record, in order, and how many others there are.

    The times of a record are parted at the longest steps of all, so that few ranges come of it.
    """
    steps = np.sort(np.concatenate([np.diff(t) for t in times]))[::-1]
    cuts = max(TOLD - sum(len(t) > 0 for t in times), 0)
    longest = steps[cuts] if len(steps) > cuts else 0.0
    parts = [
        GatedRange(k, float(part[0]), float(part[-1]), len(part))
        for k, t in enumerate(times, start=1)
        for part in np.split(t, np.flatnonzero(np.diff(t) > longest) + 1)
        if len(part)
    ]
    kept = sorted(parts, key=lambda part: -part.samples)[:TOLD]
    return tuple(sorted(kept, key=lambda part: (part.recording, part.begin))), len(parts) - len(kept)
