"""How a band-limited input is told to other languages: what the corners of its polygon weigh samples with."""

from __future__ import annotations

import numpy as np

from odescope.arrays import FloatArray
from odescope.recordings.between_samples import FINER, REACH, laid_out

BEFORE = REACH + 1  # samples before the one that a corner follows, to where its weights begin


def band_limited_weights() -> FloatArray:
    """Return the weights (corners a sample, samples) of the samples around, read off the polygon of an impulse."""
    length = 2 * REACH + 4
    impulse = np.zeros(2 * length + 1)
    impulse[length] = 1.0
    answers = laid_out(impulse).reshape(-1, FINER)[length - BEFORE : length + BEFORE + 1]
    # What comes so many samples after the impulse weighs the sample as many before.
    found: FloatArray = answers[::-1].T
    return found
