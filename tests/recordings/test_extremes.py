"""The least and the greatest of what was measured."""

from __future__ import annotations

import numpy as np

from odescope.recordings.extremes import extremes
from odescope.recordings.record import Record, Stretch


def test_only_samples_that_count_within_the_stretch_are_taken():
    x = np.array([[9.0], [1.0], [-7.0], [3.0], [8.0]])
    counts = np.array([[1.0], [1.0], [0.0], [2.0], [1.0]])
    run = Record(np.arange(5.0), x, ("x",), counts=counts)
    assert extremes([Stretch(run, 1, 4)], "x") == (1.0, 3.0)
    assert extremes([Stretch.whole(run)], "x") == (1.0, 9.0)


def test_where_nothing_was_measured_there_is_no_range():
    run = Record(np.arange(3.0), np.ones((3, 1)), ("x",), counts=np.zeros((3, 1)))
    assert extremes([Stretch.whole(run)], "x") == (np.inf, -np.inf)
