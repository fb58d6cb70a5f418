import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.errors import InputError
from odescope.regression.factor import BLOCK_ROWS, Factor, factorise, merge

seeds = st.integers(0, 2**32 - 1)
repeatable = settings(derandomize=True, deadline=None, max_examples=40)


def library(seed, rows, width):
    """Columns of very different sizes, some of them alike."""
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(rows, width)) + rng.normal(size=(rows, 1))
    return theta * 10.0 ** rng.integers(-6, 7, width)


def pieces(theta, rng):
    return np.split(theta, np.sort(rng.integers(0, len(theta) + 1, rng.integers(0, 6))))


def same(a: Factor, b: Factor):
    """Equal up to the signs of the rows of R."""
    assert a.rows == b.rows
    np.testing.assert_allclose(a.scale, b.scale, rtol=1e-12)
    np.testing.assert_allclose(np.abs(a.r), np.abs(b.r), atol=1e-12)


# blocks


@repeatable
@given(seeds, st.integers(1, 60), st.integers(1, 9))
def test_blocks_give_the_factor_of_the_whole(seed, rows, width):
    theta = library(seed, rows, width)
    norms = np.linalg.norm(theta, axis=0)
    factor = factorise(pieces(theta, np.random.default_rng(seed)))
    assert factor.rows == rows
    np.testing.assert_allclose(factor.scale, norms, rtol=1e-12)
    np.testing.assert_allclose(factor.r.T @ factor.r, (theta / norms).T @ (theta / norms), atol=1e-13)
    np.testing.assert_array_equal(factor.r, np.triu(factor.r))
    whole = np.linalg.qr(theta / norms, mode="r")
    np.testing.assert_allclose(np.abs(factor.r[: len(whole)]), np.abs(whole), atol=1e-12)


def test_a_block_longer_than_a_pass_is_cut():
    theta = library(1, 2 * BLOCK_ROWS + 123, 5)
    norms = np.linalg.norm(theta, axis=0)
    factor = factorise([theta])
    assert factor.rows == len(theta)
    np.testing.assert_allclose(np.abs(factor.r), np.abs(np.linalg.qr(theta / norms, mode="r")), atol=1e-12)


@repeatable
@given(seeds)
def test_factors_of_parts_merge_into_the_factor_of_the_whole_in_any_grouping(seed):
    theta = library(seed, 50, 6)
    a, b, c = (factorise([part]) for part in np.split(theta, [4, 21]))
    whole = factorise([theta])
    same(merge([a, b, c]), whole)
    same(merge([merge([a, b]), c]), whole)
    same(merge([c, merge([b, a])]), whole)
    same(merge([whole]), whole)


def test_a_column_that_is_zero_in_one_part_only_merges():
    theta = library(2, 30, 4)
    theta[:10, 2] = 0.0
    same(merge([factorise([theta[:10]]), factorise([theta[10:]])]), factorise([theta]))


@pytest.mark.parametrize("blocks", [[], [np.empty((0, 3))]])
def test_no_rows_are_an_error(blocks):
    with pytest.raises(InputError, match="no row"):
        factorise(blocks)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_an_error(bad):
    theta = library(3, 20, 3)
    theta[7, 1] = bad
    with pytest.raises(InputError, match="not finite"):
        factorise([theta[:5], theta[5:]])


# fits


@repeatable
@given(seeds)
def test_a_fit_on_the_factor_is_the_fit_on_the_samples(seed):
    rng = np.random.default_rng(seed)
    theta = library(seed, 40, 7)
    left, *others = rng.permutation(7)[: rng.integers(2, 8)].tolist()
    xi = factorise(pieces(theta, rng)).solve([left, *others], left)
    expected, *_ = np.linalg.lstsq(
        theta[:, others] / (sizes := np.linalg.norm(theta[:, others], axis=0)), theta[:, left]
    )
    np.testing.assert_allclose(xi[others], -expected / sizes, rtol=1e-8)
    assert xi[left] == 1.0
    assert not np.any(np.delete(xi, [left, *others]))


def test_the_left_hand_side_has_the_coefficient_one_exactly():
    for size in range(1, 200):
        # (1 / 49) * 49 is not 1.
        factor = factorise([np.array([[float(size), 1.0], [0.0, 2.0]])])
        assert factor.solve([0, 1], 0)[0] == 1.0
        assert factor.solve([0], 0)[0] == 1.0


@repeatable
@given(seeds)
def test_the_residual_of_the_factor_is_that_of_the_samples(seed):
    rng = np.random.default_rng(seed)
    theta = library(seed, 40, 5)
    xi = rng.normal(size=5) / np.linalg.norm(theta, axis=0)
    assert factorise([theta]).residual(xi) == pytest.approx(np.sqrt(np.mean((theta @ xi) ** 2)), rel=1e-10)


def test_the_factor_keeps_the_small_terms_that_the_gram_matrix_loses():
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(2, 400))
    # Columns that are alike to 1e-9: the Gram matrix cannot tell them apart, R can.
    theta = np.column_stack([a, a + 1e-9 * b, 2.0 * a - 3.0 * (a + 1e-9 * b)])
    xi = factorise([theta]).solve([0, 1, 2], 2)
    np.testing.assert_allclose(xi, [-2.0, 3.0, 1.0], rtol=1e-5)


@repeatable
@given(seeds)
def test_condition_and_correlations_are_those_of_the_scaled_columns(seed):
    rng = np.random.default_rng(seed)
    theta = library(seed, 30, 6)
    unit = theta / np.linalg.norm(theta, axis=0)
    factor = factorise([theta])
    chosen = rng.permutation(6)[:3].tolist()
    assert factor.condition(chosen) == pytest.approx(np.linalg.cond(unit[:, chosen]), rel=1e-8)
    np.testing.assert_allclose(factor.gram, unit.T @ unit, atol=1e-13)


def test_the_condition_of_a_repeated_column_is_beyond_all_bounds():
    theta = library(6, 30, 3)
    assert factorise([np.column_stack([theta, 5.0 * theta[:, 0]])]).condition([0, 3]) > 1e14
    assert factorise([np.column_stack([theta, np.zeros(30)])]).condition([0, 3]) == np.inf


# dependent columns


def test_an_identity_left_in_is_named():
    rng = np.random.default_rng(7)
    phi, v = rng.uniform(-3, 3, 300), rng.normal(size=300)
    s, c = np.sin(phi), np.cos(phi)
    theta = np.column_stack([np.ones(300), v, s, s**2, s * c, c**2, v * s**2, v * c**2])
    # 5: cos^2 = 1 - sin^2; 7: v cos^2 = v - v sin^2.
    assert factorise([theta]).dependent() == ((5, (0, 3)), (7, (1, 6)))


def test_a_conserved_quantity_is_named():
    t = np.linspace(0.0, 20.0, 2000)
    q, v = 0.7 * np.cos(3.0 * t), -2.1 * np.sin(3.0 * t)
    theta = np.column_stack([q, v, q**2, np.ones_like(t), q * v, v**2])
    assert factorise([theta]).dependent() == ((5, (2, 3)),)
    friction = np.exp(-0.01 * t)
    damped = np.column_stack([q * friction, v * friction, (q * friction) ** 2, np.ones_like(t), (v * friction) ** 2])
    assert factorise([damped]).dependent() == ()


def test_an_input_that_is_constant_or_zero_is_named():
    rng = np.random.default_rng(8)
    x = rng.normal(size=100)
    theta = np.column_stack([np.zeros(100), np.ones(100), x, np.full(100, 12.5), x**2, 12.5 * x])
    assert factorise([theta]).dependent() == ((0, ()), (3, (1,)), (5, (2,)))


def test_columns_that_are_nearly_dependent_are_named_by_the_tolerance():
    rng = np.random.default_rng(9)
    x, noise = rng.normal(size=(2, 500))
    factor = factorise([np.column_stack([x, x + 1e-5 * noise])])
    assert factor.dependent() == ()
    assert factor.dependent(1e-4) == ((1, (0,)),)


@repeatable
@given(seeds, st.integers(1, 3))
def test_as_many_columns_are_dependent_as_the_rank_lacks(seed, extra):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(40, 5))
    mixed = np.column_stack([theta, theta @ rng.normal(size=(5, extra))])[:, rng.permutation(5 + extra)]
    found = factorise([mixed]).dependent()
    assert len(found) == extra
    for j, others in found:
        assert all(k < j for k in others)
        assert np.linalg.lstsq(mixed[:, others], mixed[:, j])[1] < 1e-4
