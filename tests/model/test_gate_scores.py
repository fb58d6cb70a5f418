"""Where the samples are that were gated: a few ranges of time, and how many more."""

import numpy as np
import pytest

from odescope.model.gate import TOLD, gated_scores
from odescope.model.gated_notes import gated_sentence
from odescope.recordings.record import Record, Records

PERIOD, COUNT = 0.01, 1000


def scores(*gated, begin=3.0, dated=False):
    """Gate samples of so many recordings as outliers; time begins at 3 s."""
    t = begin + PERIOD * np.arange(COUNT)
    records = Records.of(Record(t, np.sin(t)[:, None], ("x",), dated=dated) for _ in gated)
    return gated_scores(records, {"x": tuple(4 * np.isin(np.arange(COUNT), g) for g in gated)})


def test_ranges_hold_all_samples_and_part_where_they_are_far_from_each_other():
    (score,) = scores([40, 42, 45, 200, 203, 206, 209, 900])["x"]
    assert (score.reason, score.samples, score.more) == ("outlier", 8, 0)
    assert [part.samples for part in score.ranges] == [3, 4, 1]
    ends = [(part.begin, part.end) for part in score.ranges]
    assert ends == [pytest.approx(e) for e in ((3.40, 3.45), (5.0, 5.09), (12.0, 12.0))]


@pytest.mark.parametrize(
    ("begin", "dated", "told"),
    [
        (500.0, False, "500.7 s"),
        (1.7e9 + 1.0 / 3.0, False, "1700000001.0333 s"),  # to a hundredth of a sample period
        (1.7e9, True, "0.7 s, counted from the first row"),
    ],
)
def test_times_are_those_of_the_log_but_for_dates(begin, dated, told):
    found = scores([70], begin=begin, dated=dated)["x"]
    assert gated_sentence("x", found) == f"1 sample of x does not count: 1 is an outlier ({told})"
    assert (
        "of recording 2, counted from its first row" in gated_sentence("x", scores([], [7], dated=dated)["x"])
    ) == dated


def test_of_many_recordings_those_with_most_are_told_and_the_others_counted():
    (score,) = scores(*([10 * j for j in range(k)] for k in (2, 5, 0, 3, 4, 1)))["x"]
    assert [(part.recording, part.samples) for part in score.ranges] == [(2, 5), (4, 3), (5, 4)]
    assert (len(score.ranges), score.more, score.samples) == (TOLD, 2, 15)


def test_what_is_regularly_apart_is_one_range():
    (score,) = scores(range(0, COUNT, 10))["x"]
    assert [part.samples for part in score.ranges] == [100]


def test_nothing_is_said_of_a_coordinate_that_counts_throughout():
    assert scores([], []) == {}


def test_what_a_fitted_clock_adds_to_the_last_digits_is_not_told():
    t = 0.05 * (1.0 - 2e-6) * np.arange(COUNT)
    records = Records.of(Record(t, np.sin(t)[:, None], ("x",)))
    (score,) = gated_scores(records, {"x": (4 * (np.arange(COUNT) == 838),)})["x"]
    assert score.ranges[0].begin == 41.9
