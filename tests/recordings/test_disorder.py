import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.recordings.disorder import in_order
from odescope.recordings.gaps import RawRun

T = 0.5 * np.arange(100)
X = np.sin(T)


def raw(t, x):
    values = np.column_stack([x, -np.asarray(x)])
    return RawRun(np.asarray(t), values, ("x", "y"), (None, None), "run1.csv", np.arange(1, len(t) + 1), ("x", "y"))


def test_rows_in_order_stay_as_they_are():
    run = in_order(raw(T, X))
    assert (run.repairs.rows, run.repairs.disordered, run.repairs.doubled) == (100, 0, 0)
    assert np.array_equal(run.values[:, 0], X)
    assert run.counts is None


@settings(deadline=None)
@given(rows=st.lists(st.integers(0, 99), max_size=60), away=st.integers(0, 15), seed=st.integers(0, 99))
def test_rows_sent_twice_and_late_come_back_to_the_file_as_it_was(rows, away, seed):
    """Whatever rows come twice, and however they are mixed within a short reach, sorting undoes it."""
    taken = np.sort(np.r_[np.arange(100), np.array(rows, dtype=int)])
    order = np.argsort(np.arange(len(taken)) + away * np.random.default_rng(seed).random(len(taken)), kind="stable")
    run = in_order(raw(T[taken][order], X[taken][order]))
    assert np.array_equal(run.t, T)
    assert np.array_equal(run.values, np.column_stack([X, -X]))
    assert run.counts is None or np.all(run.counts == 1.0)
    assert run.repairs.doubled == len(rows)
    assert (run.repairs.disordered > 0) == bool(np.any(np.diff(T[taken][order]) < 0))
    assert np.all(np.diff(run.rows) > 0)


def test_different_values_of_one_time_are_averaged_and_counted():
    t, x = np.insert(T, 40, T[40]), np.insert(X, 40, X[40] + 0.2)
    run = raw(t, x)
    run.values[40, 1] = np.nan
    run = in_order(run)
    assert run.values[40] == pytest.approx([X[40] + 0.1, -X[40]])
    assert run.counts is not None
    assert run.counts[40].tolist() == [2.0, 1.0]
    assert run.counts.sum() == 201


def test_missing_cells_of_doubled_rows_stay_missing():
    x = np.insert(X, 40, X[40])
    x[[40, 41, 60]] = np.nan
    run = in_order(raw(np.insert(T, 40, T[40]), x))
    assert np.flatnonzero(np.isnan(run.values[:, 0])).tolist() == [40, 59]


def test_rows_without_a_time_are_left_out():
    t = T.copy()
    t[[3, 50]] = np.nan
    assert np.array_equal(in_order(raw(t, X)).values[:, 0], np.delete(X, [3, 50]))


@pytest.mark.parametrize(
    ("t", "message"),
    [
        (np.r_[T[:50], T[:50]], "time goes back at data row 51 .* several runs share the file"),
        (np.r_[T[70:], T[:70]], "time goes back at data row 31"),
        (T[30::-1], "time goes back at data row 2"),
        (np.full(100, 3.0), "time is 3 in every row in run1.csv; name the column that holds the time"),
        (np.r_[np.floor(T[:40]), np.floor(T[40:]) + 3.0], r"time repeats at data row 2 \(0, then 0\)"),  # rows are lost
    ],
)
def test_what_cannot_be_repaired_is_refused(t, message):
    with pytest.raises(InputError, match=message):
        in_order(raw(t, X[: len(t)]))


@pytest.mark.parametrize("late", [0.0, 0.3, 1.7e9])
def test_rows_of_a_clock_that_ticks_too_seldom_are_spread_evenly(late):
    """Whole seconds of rows that come every 0.37 s: they count as even, and what is lost is an offset within a tick."""
    t = late + 0.37 * np.arange(200)
    run = in_order(raw(np.floor(t), np.sin(t)))
    steps = np.diff(run.t)
    assert steps == pytest.approx(np.full(199, 0.37), rel=0.01)
    assert np.abs(run.t - t).max() < 1.0
    assert (run.repairs.coarse, run.repairs.doubled) == (1.0, 0)
    assert np.array_equal(run.values[:, 0], np.sin(t))


def test_rows_that_were_all_sent_twice_are_merged_and_not_spread():
    run = in_order(raw(np.repeat(T, 2), np.repeat(X, 2)))
    assert np.array_equal(run.t, T)
    assert (run.repairs.coarse, run.repairs.doubled) == (0.0, 100)
