from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.recordings.gaps import RawRun, check_cells, known, pieces
from odescope.recordings.record import Repairs
from odescope.recordings.uniform import uniform

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


def driven(u, lost):
    """Return a run of a coordinate and an input, samples of both lost."""
    kept = np.setdiff1d(np.arange(len(u)), lost)
    values = np.column_stack([np.sin(0.02 * kept), u[kept]])
    rows = np.arange(1, len(kept) + 1)
    return RawRun(kept.astype(float), values, ("x", "u"), (None, None), "run1.csv", rows, ("x", "u"))


def lengths(run, inputs=("u",)):
    return [len(samples) for samples in known(run, run.t.astype(int), inputs)]


STEPPING = np.repeat(np.arange(20.0) * 7.0 % 5.0, 50)


def test_a_run_is_cut_where_an_input_stepped_unseen():
    assert lengths(driven(STEPPING, [249, 250, 330])) == [249, 748]  # from 249 to 250, but nowhere about 330
    assert lengths(driven(STEPPING, [249, 250, 330]), inputs=()) == [997]


def test_a_run_is_not_cut_to_pieces_at_single_samples():
    every = np.arange(50, 1000, 50)
    assert lengths(driven(STEPPING, every)) == [981]
    long = np.r_[every, np.arange(301, 306)]  # six in a row are another matter
    assert lengths(driven(STEPPING, long)) == [295, 681]


REGULAR = np.repeat(np.random.default_rng(7).uniform(-1.0, 1.0, 100), 10)


@pytest.mark.parametrize("seed", range(4))
def test_a_command_that_changes_at_every_so_many_samples_did_so_in_a_gap_too(seed):
    """Whatever is lost, a gap of more than one step excepted: that is left to the cut."""
    lost = np.random.default_rng(seed).choice(np.arange(1, 999), 100, replace=False)
    run = driven(REGULAR, np.r_[lost, 405:408])
    record, points = uniform(run, inputs=frozenset("u"))
    np.testing.assert_array_equal(record.column("u"), REGULAR)
    assert len(known(run, points, ("u",))) == 1
    run = driven(REGULAR, np.arange(405, 425))  # two of its steps: nobody knows the value between
    assert lengths(run) == [405, 575]


def test_a_command_that_changes_anywhere_is_not_known_in_a_gap():
    steps = np.cumsum(np.random.default_rng(8).integers(7, 14, 100))
    u = np.repeat(np.random.default_rng(9).uniform(-1.0, 1.0, 100), np.diff(np.r_[0, steps]))
    run = driven(u, [int(steps[40]) - 1, int(steps[40])])
    assert len(lengths(run)) == 2


@pytest.mark.parametrize(("period", "gap", "cuts"), [(40.0, 20, 1), (40.0, 3, 0), (400.0, 20, 0)])
def test_a_run_is_cut_where_no_line_tells_what_an_input_did(period, gap, cuts):
    u = np.sin(2.0 * np.pi * np.arange(1000.0) / period)
    run = driven(u, np.arange(500, 500 + gap))
    assert len(lengths(run)) == 1 + cuts
    assert lengths(run, inputs=()) == [1000 - gap]  # the law bridges coordinates


def test_the_longest_of_several_pieces_bears_what_was_done_to_the_rows():
    run = replace(driven(STEPPING, [249, 250]), repairs=Repairs(rows=998, doubled=3))
    first, second = run.cut(known(run, run.t.astype(int), ("u",)))
    assert (first.repairs.rows, first.repairs.doubled, first.repairs.cut) == (0, 0, 0)
    assert (second.repairs.rows, second.repairs.doubled, second.repairs.cut) == (998, 3, 1)
