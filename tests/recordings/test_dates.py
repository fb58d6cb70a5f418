"""Times as dates: written so that they are read back as they were."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.recordings.columns import from_arrays
from odescope.recordings.dates import from_text, to_text


@settings(deadline=None)
@given(
    begin=st.integers(0, 4_000_000_000),
    steps=st.lists(st.integers(0, 10**9), max_size=8),
    scale=st.sampled_from([1, 1000, 10**6]),
    zoned=st.booleans(),
)
def test_dates_are_read_back_to_the_microsecond(begin, steps, scale, zoned):
    ticks = 10**6 * begin + scale * np.array([0, *steps], dtype=np.int64)
    written = to_text(1e-6 * ticks, zoned)
    column = from_text(from_arrays({"t": np.array(written, dtype=str)}, "the test")["t"], "t", "the test")
    assert (np.array(column.cast("int64").to_pylist()) // 1000).tolist() == ticks.tolist()


@pytest.mark.parametrize(
    ("seconds", "zoned", "texts"),
    [
        ([1706745599.5, 1706745600.0], False, ["2024-01-31 23:59:59.5", "2024-02-01 00:00:00.0"]),
        ([1706745599.0], True, ["2024-01-31 23:59:59Z"]),
        ([43200.0, 43200.125], False, ["12:00:00.000", "12:00:00.125"]),
        ([86399.0, 86400.0], False, ["1970-01-01 23:59:59", "1970-01-02 00:00:00"]),
        ([], False, []),
    ],
)
def test_as_many_decimals_as_it_takes_and_clocks_without_a_day(seconds, zoned, texts):
    assert to_text(np.array(seconds), zoned) == texts
