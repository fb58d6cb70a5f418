"""Sentences on samples of a log that do not count."""

from __future__ import annotations

from collections.abc import Sequence

from odescope.model.choice_notes import listed
from odescope.model.scores import GatedScore

FEW = 2  # samples, each of which is told
REASONS = {
    "saturated": ("is saturated", "are saturated"),
    "repeated": ("repeats the one before", "repeat the one before"),
    "late": ("was read late", "were read late"),
    "outlier": ("is an outlier", "are outliers"),
    "placeholder": ("stands for no reading", "stand for no reading"),
}


def gated_sentence(name: str, found: Sequence[GatedScore]) -> str:
    """Return how many samples of a coordinate do not count, and why."""
    count, why = sum(g.samples for g in found), listed([_gated(g) for g in found])
    return (
        f"1 sample of {name} does not count: {why}" if count == 1 else f"{count} samples of {name} do not count: {why}"
    )


def _gated(found: GatedScore) -> str:
    """Return in words how many samples were gated for one reason, and when they were taken."""
    one, several = REASONS.get(found.reason, (found.reason, found.reason))
    several_recordings = any(part.recording > 1 for part in found.ranges)
    told = []
    for part in found.ranges:
        begin, end = f"{part.begin:.15g} s", f"{part.end:.15g} s"
        several_in = f"{begin} and {end}" if part.samples == FEW else f"{part.begin:.15g} to {end}"
        at = begin if part.samples == 1 else several_in
        told.append(f"{at} of recording {part.recording}" if several_recordings else at)
    told += [f"{found.more} more range{'' if found.more == 1 else 's'}"] if found.more else []
    told += [f"counted from {'its' if several_recordings else 'the'} first row"] if found.dated else []
    return f"{found.samples} {one if found.samples == 1 else several} ({', '.join(told)})"
