"""What a channel looks like of which most samples cannot be used, in words that say where to look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from odescope.arrays import FloatArray

FEW = 8  # values: a channel with no more is a switch or a state
AT_AN_END = 0.25  # of the samples at the largest or smallest value are no chance


def appearance(columns: Sequence[FloatArray]) -> str:
    """Return what the samples (N,) of the records look like, and what to do about it."""
    return telling(columns) or (
        "it looks like noise with outliers: look whether the column is the right one and the sensor is connected;"
        ' [signals] outliers = "clip" keeps all samples'
    )


def telling(columns: Sequence[FloatArray]) -> str | None:
    """Return what is wrong with the samples (N,) of the records and what to do about it, if their values show that."""
    joined = np.concatenate(columns)
    levels, low, high = np.unique(joined), float(joined.min()), float(joined.max())
    if len(levels) <= FEW:
        listed = ", ".join(f"{v:.6g}" for v in levels)
        return f"it holds {len(levels)} levels only ({listed}), as a switch does: give it as an input, or leave it out"
    if (part := float(np.mean((joined == low) | (joined == high)))) > AT_AN_END:
        return (
            f"{100.0 * part:.0f} % stand at {low:.6g} or {high:.6g}, where its range ends: record with a wider range,"
            " or move less"
        )
    return None
