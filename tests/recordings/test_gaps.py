from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.recordings.gaps import RawRun, check_cells, pieces

TIME = np.arange(40) * 0.01


def raw(t, values, labels=("x [m]", "phi")):
    values = np.asarray(values, dtype=float)
    rows = np.arange(1, len(t) + 1)
    return RawRun(np.asarray(t, dtype=float), values, ("x", "phi"), (None, "rad"), "run1.csv", rows, labels)


def cut_at_gaps(run, gaps="refuse"):
    return tuple(run.take(samples) for samples in pieces(run, gaps))


def test_a_complete_run_is_one_record_with_its_values():
    values = np.column_stack([TIME, -TIME])
    for gaps in ("refuse", "split", "bridge"):
        (run,) = cut_at_gaps(raw(TIME, values), gaps)
        assert np.array_equal(run.values, values)
        assert run.units == (None, "rad")


def test_gaps_are_told_by_column_and_row():
    t, values = np.arange(600.0), np.zeros((600, 2))
    values[119:131, 1] = values[399, 1] = values[511:, 1] = np.nan
    values[4, 0] = np.nan
    message = (
        r"column 'x \[m\]' has 1 gap \(data row 5\) and column 'phi' has 3 gaps \(data rows 120-131, 400, 512-600\) "
        r"in run1\.csv, where row 1 is the first row of data; repair them there or set gaps = 'bridge' or 'split' in "
        r"\[data\]"
    )
    with pytest.raises(InputError, match=message):
        cut_at_gaps(raw(t, values))


def test_gaps_of_time_are_told():
    t = np.r_[np.arange(20), np.arange(25, 60), np.nan]
    with pytest.raises(InputError, match=r"time has 1 gap \(data row 56\) and time has 1 gap \(after data row 20\)"):
        cut_at_gaps(raw(t, np.zeros((56, 2))))


def test_split_at_missing_cells_and_jumps_of_time():
    t = np.r_[np.arange(30.0), np.arange(40.0, 90.0)]
    values = np.column_stack([t, t])
    values[60, 0] = values[62, 1] = t[75] = np.nan
    found = cut_at_gaps(raw(t, values), "split")
    assert [(run.t[0], run.t[-1]) for run in found] == [(0, 29), (40, 69)]  # 73-84 and 86-89 are too short


@settings(deadline=None)
@given(missing=st.sets(st.integers(0, 199), max_size=12), jump=st.integers(1, 199))
def test_split_loses_only_missing_rows_and_short_pieces(missing, jump):
    t = np.arange(200.0)
    t[jump:] += 10
    values = np.column_stack([t, t])
    values[list(missing), 1] = np.nan
    edges = sorted({*(k for m in missing for k in (m, m + 1)), jump, 0, 200})
    expected = [range(a, b) for a, b in pairwise(edges) if a not in missing and b - a >= 16]
    found = cut_at_gaps(raw(t, values), "split")
    assert [list(run.t) for run in found] == [list(t[list(rows)]) for rows in expected]


def test_split_that_leaves_nothing_is_refused():
    values = np.zeros((60, 2))
    values[::12] = np.nan
    with pytest.raises(InputError, match=r"nothing is left in run1\.csv .* longest of 5 pieces has 11 samples"):
        cut_at_gaps(raw(np.arange(60), values), "split")


def test_infinite_values_are_no_gaps():
    values = np.zeros((40, 2))
    values[9, 0] = np.inf
    with pytest.raises(InputError, match=r"'x \[m\]' is not a finite number in data row 10"):
        check_cells(raw(TIME, values))


# bridged


def test_gaps_up_to_thirty_two_steps_stay_in_the_run_and_longer_ones_cut_it():
    t = np.r_[np.arange(30.0), np.arange(61.0, 90.0), np.arange(122.0, 150.0)]
    found = cut_at_gaps(raw(t, np.column_stack([t, t])), "bridge")
    assert [(run.t[0], run.t[-1]) for run in found] == [(0, 89), (122, 149)]


def test_a_gap_is_measured_in_steps_of_its_own_column():
    """A column sampled each 20th row has gaps of 20 rows that are none; missing cells stay missing."""
    t = np.arange(1000.0)
    values = np.column_stack([t, np.where(t % 20 == 0, t, np.nan)])
    (run,) = cut_at_gaps(raw(t, values), "bridge")
    assert np.array_equal(run.values, values, equal_nan=True)
    values[100:800, 1] = np.nan
    assert [(r.t[0], r.t[-1]) for r in cut_at_gaps(raw(t, values), "bridge")] == [(0, 80), (800, 999)]


@settings(deadline=None)
@given(missing=st.sets(st.tuples(st.integers(0, 199), st.integers(0, 1)), max_size=150))
def test_bridging_loses_no_cell(missing):
    t = np.arange(200.0)
    values = np.column_stack([t, t])
    for row, column in missing:
        values[row, column] = np.nan
    there = [np.flatnonzero(~np.isnan(column)) for column in values.T]
    if max(np.diff(k).max() for k in there) > 32:
        return
    (run,) = cut_at_gaps(raw(t, values), "bridge")
    assert np.array_equal(run.values, values, equal_nan=True)


def test_a_column_without_numbers_is_named():
    values = np.column_stack([TIME, np.full(40, np.nan)])
    with pytest.raises(InputError, match=r"0 of 40 cells of 'phi' hold numbers in run1\.csv: expected at least 2"):
        cut_at_gaps(raw(TIME, values), "bridge")
