from itertools import repeat, takewhile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.regression.factor import factorise
from odescope.regression.solve import full_fits, least_squares, normal_fit, threshold_supports

seeds = st.integers(0, 2**32 - 1)
repeatable = settings(derandomize=True, deadline=None, max_examples=40)


def factor_r(seed, width, alike=1.0, rows=60):
    """R of a random library whose columns share a part of the size `alike`, so that fits depend on their support."""
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(rows, width)) + alike * rng.normal(size=(rows, 1)) * rng.normal(size=width)
    return np.ascontiguousarray(factorise([theta]).r)


# least squares


@repeatable
@given(seeds, st.integers(2, 10))
def test_the_kernel_is_numpys_least_squares(seed, width):
    rng = np.random.default_rng(seed)
    r = factor_r(seed, width)
    left, *support = rng.permutation(width)[: rng.integers(2, width + 1)]
    x, rest = least_squares(r, np.array(support), left)
    expected, *_ = np.linalg.lstsq(r[:, support], r[:, left])
    np.testing.assert_allclose(x, expected, rtol=1e-9, atol=1e-12)
    assert rest == pytest.approx(np.sum((r[:, left] - r[:, support] @ expected) ** 2), rel=1e-9, abs=1e-15)


def test_an_empty_support_leaves_the_whole_column():
    r = factor_r(1, 4)
    x, rest = least_squares(r, np.array([], dtype=np.int64), 2)
    assert x.shape == (0,)
    assert rest == pytest.approx(1.0, rel=1e-14)


@repeatable
@given(seeds)
def test_a_dependent_column_gets_nothing_and_spoils_nothing(seed):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(30, 5))
    theta = np.column_stack([theta, theta[:, 0], theta[:, 1] - 2.0 * theta[:, 2]])
    r = np.ascontiguousarray(factorise([theta]).r)
    x, rest = least_squares(r, np.array([0, 5, 1, 2, 6, 3]), 4)
    alone, least = least_squares(r, np.array([0, 1, 2, 3]), 4)
    np.testing.assert_array_equal(x[[1, 4]], 0.0)
    np.testing.assert_allclose(x[[0, 2, 3, 5]], alone, rtol=1e-10)
    assert rest == pytest.approx(least, rel=1e-10)


def test_more_columns_than_rows_fit_exactly():
    theta = np.random.default_rng(2).normal(size=(3, 6))
    r = np.ascontiguousarray(factorise([theta]).r)
    x, rest = least_squares(r, np.array([0, 1, 2, 3, 4]), 5)
    np.testing.assert_allclose(r[:, :5] @ x, r[:, 5], atol=1e-12)
    assert rest < 1e-24
    np.testing.assert_array_equal(x[3:], 0.0)


@repeatable
@given(seeds, st.sampled_from([1.0, 1e-2, 1e-4, 1e-5]))
def test_the_quick_fit_is_as_good_as_the_careful_one(seed, apart):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(50, 8))
    theta[:, 5] = theta[:, 1] + apart * theta[:, 5]  # alike to `apart`: the Gram matrix squares that
    theta[:, 3] = theta[:, :3] @ rng.normal(size=3) + theta[:, 5:] @ rng.normal(size=3)
    r = np.ascontiguousarray(factorise([theta]).r)
    support = np.array([0, 1, 2, 5, 6, 7])
    expected, *_ = np.linalg.lstsq(r[:, support], r[:, 3])
    np.testing.assert_allclose(normal_fit(r, r.T @ r, support, 3), expected, rtol=1e-11 / apart)


@repeatable
@given(seeds, st.integers(2, 10))
def test_all_full_fits_at_once_are_those_one_by_one(seed, width):
    r = factor_r(seed, width)
    fits = full_fits(r)
    assert fits is not None
    for left in range(width):
        others = [j for j in range(width) if j != left]
        np.testing.assert_allclose(
            fits[others, left], np.linalg.lstsq(r[:, others], r[:, left])[0], rtol=1e-8, atol=1e-10
        )


def test_full_fits_of_dependent_columns_are_refused():
    theta = np.random.default_rng(3).normal(size=(30, 4))
    assert full_fits(factorise([np.column_stack([theta, theta[:, 0] - theta[:, 1]])]).r) is None
    assert full_fits(factorise([np.column_stack([theta, np.zeros(30)])]).r) is None


# every threshold at once


def sizes(r, support, left, weight, relative):
    x, *_ = np.linalg.lstsq(r[:, support], r[:, left])
    found = np.abs(x) * weight[support]
    return (found / found.max()) ** 2 if relative else found


def sequential(r, columns, left, weight, relative, threshold):
    """The definition, at one threshold: fit, drop, fit again until nothing is dropped."""
    support = [j for j in columns if j != left]
    while support:
        size = sizes(r, support, left, weight, relative)
        kept = [j for j, s in zip(support, size, strict=True) if s >= threshold]
        if kept == support:
            break
        support = kept
    return tuple(sorted(support))


def enumerated(r, columns, left, weight, relative, low, high, **options):
    found = threshold_supports(r, r.T @ r, np.array(columns), left, weight, relative, low, high, **options)
    return {tuple(np.flatnonzero(row).tolist()) for row in found}


def subsets(items):
    for code in range(1, 2 ** len(items)):
        yield [j for k, j in enumerate(items) if code >> k & 1]


@repeatable
@given(seeds, st.integers(2, 7), st.booleans(), st.sampled_from([0.3, 1.0, 3.0]))
def test_the_supports_are_those_of_all_thresholds_and_no_others(seed, width, relative, alike):
    rng = np.random.default_rng(seed)
    r = factor_r(seed, width, alike)
    left = int(rng.integers(width))
    columns = np.sort(rng.permutation(width)[: max(2, width - 1)])
    columns = sorted({left, *columns.tolist()})
    weight = 10.0 ** rng.uniform(-1, 1, width)
    low, high = (1e-7, 0.8) if relative else (1e-3, 5.0)
    # The outcome can change only where the threshold passes a size that some support has. Between two neighbours of
    # all these sizes one threshold stands for all.
    others = [j for j in columns if j != left]
    edges = np.concatenate([sizes(r, s, left, weight, relative) for s in subsets(others)])
    edges = np.unique(np.concatenate([edges[(edges > low) & (edges < high)], [low, high]]))
    middles = 0.5 * (edges[:-1] + edges[1:])[np.diff(edges) > 1e-9 * edges[1:]]
    outcomes = [sequential(r, columns, left, weight, relative, t) for t in middles[::-1]]
    assert enumerated(r, columns, left, weight, relative, low, high) == set(outcomes) - {()}
    for terms in range(1, width):
        # Down from the highest threshold, and no further than the first outcome of too many terms.
        small = {s for s, _ in takewhile(lambda pair: len(pair[0]) <= pair[1], zip(outcomes, repeat(terms)))} - {()}
        assert enumerated(r, columns, left, weight, relative, low, high, terms=terms) == small


@pytest.mark.parametrize("relative", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_fine_grid_of_thresholds_finds_nothing_else(relative, seed):
    r = factor_r(seed, 14, 2.0)
    columns, weight = list(range(14)), np.linspace(0.5, 2.0, 14)
    low, high = 1e-9, 0.9
    found = enumerated(r, columns, 3, weight, relative, low, high)
    grid = np.geomspace(low * 1.01, high, 1500)
    brute = {sequential(r, columns, 3, weight, relative, t) for t in grid} - {()}
    assert brute <= found
    assert len(brute) > 8


def test_hundreds_of_supports_outgrow_the_first_arrays():
    r = factor_r(4, 60, 6.0, rows=80)
    found = threshold_supports(r, r.T @ r, np.arange(60), 0, np.ones(60), True, 1e-12, 1.0)
    distinct = {tuple(np.flatnonzero(row).tolist()) for row in found}
    assert len(found) > 64
    grid = np.geomspace(1e-11, 1.0, 800)
    assert {sequential(r, range(60), 0, np.ones(60), True, t) for t in grid} - {()} <= distinct
    for support in distinct:
        size = sizes(r, list(support), 0, np.ones(60), True)
        assert size.min() > 1e-12 * (1 - 1e-6)


@pytest.mark.parametrize("relative", [True, False])
def test_an_interval_splits_anywhere(relative):
    r, columns, weight = factor_r(5, 9, 2.0), list(range(9)), np.ones(9)
    whole = enumerated(r, columns, 2, weight, relative, 1e-6, 0.9)
    for cut in (1e-5, 0.003, 0.1, 0.4):
        below = enumerated(r, columns, 2, weight, relative, 1e-6, cut)
        above = enumerated(r, columns, 2, weight, relative, cut, 0.9)
        assert below | above == whole


def test_a_left_hand_side_that_nothing_explains_has_no_support():
    r = np.eye(4)
    assert enumerated(r, [0, 1, 2, 3], 3, np.ones(4), True, 1e-9, 0.3) == set()
    assert enumerated(r, [0, 1, 2, 3], 3, np.ones(4), False, 1e-9, 0.3) == set()


def test_a_threshold_above_every_coefficient_leaves_nothing():
    r = factor_r(6, 5)
    assert enumerated(r, range(5), 0, np.ones(5), False, 1e3, 1e4) == set()
