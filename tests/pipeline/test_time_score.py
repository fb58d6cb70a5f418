"""What a result says of the time of recordings."""

import numpy as np
import pytest

from odescope.pipeline.evaluation import time_score
from odescope.recordings.coordinate import Coordinate, Input
from odescope.recordings.record import Record, Records

T = 0.01 * np.arange(2000)


@pytest.mark.parametrize(("hold", "told"), [("linear", True), ("zero", False)])
def test_a_gap_of_an_input_is_told_where_coordinates_lack_nothing_unless_it_was_held(hold, told):
    counts = np.ones((len(T), 2))
    counts[500:520, 1] = 0.0
    run = Record(T, np.column_stack([np.sin(T), np.sin(7.0 * T)]), ("x", "u"), counts=counts)
    found = time_score(Records((run,)), [Coordinate("x")], [Input("u", hold=hold)])
    assert (found is not None) is told
    if told:
        longest, off = found.bridged["u"]
        assert longest == 20
        assert off > 0.01
        assert found.missing == {}
