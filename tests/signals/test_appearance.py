"""What a channel that cannot be used looks like."""

import re

import numpy as np
import pytest

from odescope.signals.appearance import appearance, telling

RNG = np.random.default_rng(0)
NOISE = RNG.standard_normal(500)


@pytest.mark.parametrize(
    ("column", "words"),
    [
        (np.where(NOISE > 0.0, 1.0, 0.0), r"2 levels only \(0, 1\), as a switch does"),
        (np.where(RNG.random(500) < 0.55, 9.5, np.minimum(NOISE, 9.0)), "% stand at .* or 9.5, where its range ends"),
        (NOISE, "noise with outliers"),
    ],
)
def test_a_channel_is_told_by_its_values(column, words):
    assert re.search(words, appearance([column[:200], column[200:]]))
    assert (telling([column]) is None) == (words == "noise with outliers")
