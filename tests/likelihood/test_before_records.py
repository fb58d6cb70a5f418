"""What is left out of a record because the inputs that acted then were never recorded."""

import numpy as np
import pytest

from odescope.likelihood.before_records import measured_where_known
from odescope.recordings.record import Record, Records

PERIOD = 0.1


def recorded(samples, counts=None):
    t = PERIOD * np.arange(samples)
    return Records.of(Record(t, np.column_stack([np.sin(t), np.cos(t)]), ("x", "u"), counts=counts))


@pytest.mark.parametrize(("delays", "lead", "tail"), [((0.72,), 8, 0), ((-0.31,), 0, 4), ((0.2, 0.55, -0.4), 6, 4)])
def test_samples_do_not_count_while_an_input_is_not_known(delays, lead, tail):
    (run,) = measured_where_known(recorded(100), ["x"], delays)
    known = np.ones(100)
    known[:lead] = 0.0
    known[100 - tail :] = 0.0
    assert np.array_equal(run.counted("x"), known)
    assert np.all(run.counted("u") == 1.0)
    assert np.array_equal(run.values, recorded(100).runs[0].values)


def test_what_was_gated_before_does_not_count_either():
    counts = np.ones((100, 2))
    counts[40, 0] = 0.0
    (run,) = measured_where_known(recorded(100, counts), ["x"], [0.5])
    assert run.counted("x")[40] == 0.0
    assert run.counted("x").sum() == 100 - 5 - 1


@pytest.mark.parametrize("delays", [(), (0.0,), (0.09,), (-0.05,), (3.0,)])
def test_everything_counts_where_no_input_is_late_by_more_than_a_sample_or_one_is_too_late_to_believe(delays):
    assert measured_where_known(recorded(100), ["x"], delays) is None
