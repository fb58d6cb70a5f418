from itertools import combinations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.regression.factor import Factor, factorise
from odescope.regression.proposers import (
    AnyProposer,
    BackwardElimination,
    CoefficientThreshold,
    EnergyThreshold,
    MatchingPursuit,
    NullSpace,
    exchanged,
)

seeds = st.integers(0, 2**32 - 1)
repeatable = settings(derandomize=True, deadline=None, max_examples=30)
PROPOSERS = [EnergyThreshold(), CoefficientThreshold(), MatchingPursuit(), BackwardElimination(), NullSpace()]
kinds = pytest.mark.parametrize("proposer", PROPOSERS, ids=lambda p: type(p).__name__)


def library(seed, rows=80, width=9, alike=1.0):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(rows, width)) + alike * rng.normal(size=(rows, 1)) * rng.normal(size=width)
    return theta * 10.0 ** rng.uniform(-2, 2, width)


def rest(theta, support, left):
    """The squared residual of the fit on the samples, columns scaled."""
    columns = theta[:, list(support)]
    columns = columns / np.linalg.norm(columns, axis=0)
    x, *_ = np.linalg.lstsq(columns, theta[:, left])
    return float(np.sum((theta[:, left] - columns @ x) ** 2))


def planted(seed, noise, rows=400, width=20):
    """A library of correlated columns and the sparse law that its column 0 follows."""
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(rows, width)) + 0.7 * rng.normal(size=(rows, 1))
    theta *= 10.0 ** rng.uniform(-1, 1, width)
    truth = tuple(sorted(rng.choice(np.arange(1, width), 4, replace=False).tolist()))
    parts = theta[:, truth] / np.linalg.norm(theta[:, truth], axis=0)
    weights = rng.choice([-1.0, 1.0], 4) * rng.uniform(0.5, 1.5, 4)
    theta[:, 0] = parts @ weights + noise * rng.normal(size=rows) / np.sqrt(rows)
    return theta, truth


# what all have in common


@kinds
@pytest.mark.parametrize("seed", range(4))
def test_a_planted_sparse_law_is_among_the_supports(proposer, seed):
    theta, truth = planted(seed, noise=0.02)
    assert truth in set(proposer.supports(factorise([theta]), 0, tuple(range(20))))


@kinds
def test_supports_are_sorted_distinct_and_of_the_columns_allowed(proposer):
    theta, truth = planted(7, noise=0.02)
    factor = factorise([theta])
    spare = [j for j in range(1, 20) if j not in truth]
    columns = tuple(j for j in range(20) if j not in spare[::3])
    found = list(proposer.supports(factor, 0, columns))
    assert found
    assert len(set(found)) == len(found)
    for support in found:
        assert support
        assert list(support) == sorted(set(support))
        assert set(support) <= set(columns) - {0}


@kinds
def test_supports_do_not_depend_on_the_units_of_the_columns(proposer):
    theta, _ = planted(8, noise=0.02)
    units = 2.0 ** np.random.default_rng(8).integers(-12, 12, 20)
    if isinstance(proposer, CoefficientThreshold):
        units[:] = 8.0  # a coefficient threshold means units: only one unit for all leaves it alone
    plain, other = factorise([theta]), factorise([theta * units])
    columns = tuple(range(20))
    assert list(proposer.supports(plain, 0, columns)) == list(proposer.supports(other, 0, columns))


# A null space is left out: to it a zero column is a law by itself.
@pytest.mark.parametrize("proposer", PROPOSERS[:-1], ids=lambda p: type(p).__name__)
def test_a_column_of_no_data_is_never_proposed(proposer):
    theta, _ = planted(9, noise=0.02)
    theta[:, 5] = 0.0
    assert not any(5 in s for s in proposer.supports(factorise([theta]), 0, tuple(range(20))))


@kinds
def test_a_proposer_survives_a_study_file(proposer):
    # TOML has no null: a study writes only what is set.
    plain = {key: value for key, value in msgspec.to_builtins(proposer).items() if value is not None}
    assert msgspec.toml.decode(msgspec.toml.encode(plain), type=AnyProposer) == proposer


# thresholds


def sequential(theta, left, keeps):
    support = [j for j in range(theta.shape[1]) if j != left]
    while support:
        sizes = np.linalg.norm(theta[:, support], axis=0)
        x = np.linalg.lstsq(theta[:, support] / sizes, theta[:, left])[0] / sizes
        kept = [j for j, k in zip(support, keeps(x, sizes), strict=True) if k]
        if kept == support:
            break
        support = kept
    return tuple(support)


@repeatable
@given(seeds, st.sampled_from([1e-6, 1e-3, 0.02, 0.1, 0.5]))
def test_a_fixed_energy_ratio_is_the_papers_algorithm(seed, ratio):
    theta = library(seed)

    def keeps(x, sizes):
        energy = x**2 * sizes**2
        return energy >= ratio * energy.max()

    factor = factorise([theta])
    found = list(EnergyThreshold(ratio, ratio).supports(factor, 2, tuple(range(9))))
    assert found == [sequential(theta, 2, keeps)]
    assert found[0] in set(EnergyThreshold(1e-8, 0.9).supports(factor, 2, tuple(range(9))))


@repeatable
@given(seeds, st.sampled_from([1e-3, 0.03, 0.3, 2.0]))
def test_a_fixed_coefficient_threshold_is_stls_in_the_units_of_the_data(seed, threshold):
    theta = library(seed)
    expected = sequential(theta, 4, lambda x, sizes: np.abs(x) >= threshold)
    found = list(CoefficientThreshold(threshold, threshold).supports(factorise([theta]), 4, tuple(range(9))))
    assert found == ([expected] if expected else [])


def test_a_guess_alone_has_no_threshold_support():
    factor = factorise([library(1)])
    assert list(EnergyThreshold().supports(factor, 3, (3,))) == []


# matching pursuit


@repeatable
@given(seeds)
def test_matching_pursuit_adds_what_a_refit_with_each_column_finds_best(seed):
    theta = library(seed, alike=2.0)
    found = list(MatchingPursuit(terms=8).supports(factorise([theta]), 1, tuple(range(9))))
    chosen = ()
    for step in range(8):
        left_over = [j for j in range(9) if j != 1 and j not in chosen]
        best = min(left_over, key=lambda j: rest(theta, (*chosen, j), 1))
        chosen = (*chosen, best)
        assert found[step] == tuple(sorted(chosen))
    assert len(found) == 8


@repeatable
@given(seeds)
def test_matching_pursuit_on_columns_at_right_angles_is_the_text_books(seed):
    # At right angles all pursuits agree: correlate, take the largest, subtract.
    rng = np.random.default_rng(seed)
    frame = np.linalg.qr(rng.normal(size=(60, 10)))[0]
    theta = np.column_stack([frame @ rng.normal(size=10), frame])
    residual, chosen, expected = theta[:, 0].copy(), [], []
    for _ in range(6):
        scores = np.abs(theta[:, 1:].T @ residual)
        chosen.append(1 + int(np.argmax(scores)))
        x, *_ = np.linalg.lstsq(theta[:, chosen], theta[:, 0])
        residual = theta[:, 0] - theta[:, chosen] @ x
        expected.append(tuple(sorted(chosen)))
    assert list(MatchingPursuit(terms=6).supports(factorise([theta]), 0, tuple(range(11)))) == expected


def test_matching_pursuit_ends_when_all_is_explained():
    theta, truth = planted(3, noise=0.0)
    path = list(MatchingPursuit(terms=12).supports(factorise([theta]), 0, tuple(range(20))))
    assert path[-1] == truth
    assert len(path) == 4


def test_matching_pursuit_passes_over_columns_it_has_already():
    theta, truth = planted(4, noise=0.02)
    doubled = np.column_stack([theta, 3.0 * theta[:, truth]])
    for support in MatchingPursuit(terms=12).supports(factorise([doubled]), 0, tuple(range(24))):
        assert np.linalg.matrix_rank(doubled[:, support] / np.linalg.norm(doubled[:, support], axis=0)) == len(support)


# backward elimination


@repeatable
@given(seeds)
def test_backward_elimination_drops_what_a_refit_without_it_misses_least(seed):
    theta = library(seed, alike=2.0)
    found = list(BackwardElimination(terms=20).supports(factorise([theta]), 6, tuple(range(9))))
    support = tuple(j for j in range(9) if j != 6)
    expected = [support]
    while len(support) > 1:
        dropped = min(support, key=lambda j: rest(theta, [k for k in support if k != j], 6))
        support = tuple(k for k in support if k != dropped)
        expected.append(support)
    assert found == expected


def test_backward_elimination_yields_no_more_terms_than_asked_for():
    theta, _ = planted(5, noise=0.1)
    path = list(BackwardElimination(terms=6).supports(factorise([theta]), 0, tuple(range(20))))
    assert [len(s) for s in path] == [6, 5, 4, 3, 2, 1]


@pytest.mark.parametrize("seed", range(4))
def test_backward_elimination_holds_on_to_a_law_whose_columns_come_twice(seed):
    # A coefficient split between two equal columns would look as if either could go.
    theta, truth = planted(seed, noise=0.02)
    doubled = np.column_stack([theta, 3.0 * theta[:, truth], theta[:, truth[0]] - 2.0 * theta[:, truth[1]]])
    assert truth in set(BackwardElimination().supports(factorise([doubled]), 0, tuple(range(25))))


def test_backward_elimination_sees_through_columns_that_are_nearly_alike():
    theta, truth = planted(6, noise=1e-6)
    rng = np.random.default_rng(6)
    near = theta[:, truth] * (1.0 + 1e-4 * rng.normal(size=(400, 4)))
    path = set(BackwardElimination().supports(factorise([np.column_stack([theta, near])]), 0, tuple(range(24))))
    assert truth in path


# null space


@pytest.mark.parametrize("left", range(4))
def test_a_planted_null_vector_is_found_from_each_of_its_columns(left):
    rng = np.random.default_rng(11)
    theta = rng.normal(size=(300, 15))
    law = (2, 5, 9, 12)
    theta[:, 12] = 0.8 * theta[:, 2] - 1.3 * theta[:, 5] + 0.6 * theta[:, 9] + 1e-3 * rng.normal(size=300)
    found = set(NullSpace().supports(factorise([theta]), law[left], tuple(range(15))))
    assert found == {tuple(j for j in law if j != law[left])}


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_of_two_sparse_laws_each_is_found_from_a_column_of_its_own(noise):
    # Without noise the least singular values are rounding: both relations must count as null all the same.
    rng = np.random.default_rng(12)
    theta = rng.normal(size=(300, 16))
    first, second = (1, 4, 7), (2, 8, 10, 14)
    theta[:, 7] = theta[:, 1] - 0.7 * theta[:, 4] + noise * rng.normal(size=300)
    theta[:, 14] = theta[:, 2] + 0.9 * theta[:, 8] - 1.1 * theta[:, 10] + noise * rng.normal(size=300)
    factor, columns = factorise([theta]), tuple(range(16))
    for law in (first, second):
        for left in law:
            found = set(NullSpace().supports(factor, left, columns))
            assert tuple(j for j in law if j != left) in found


def test_a_column_outside_the_null_space_is_in_no_null_vector():
    rng = np.random.default_rng(13)
    theta = rng.normal(size=(300, 10))
    theta[:, 9] = theta[:, 1] - theta[:, 2]
    assert list(NullSpace().supports(factorise([theta]), 5, tuple(range(10)))) == []


def test_an_exact_law_does_not_hide_another():
    # Two pairs of equal columns, to rounding: that one is equal to 1e-18 does not make 1e-15 a difference.
    r = np.eye(6)
    r[:2, 1], r[2:4, 3] = (1.0, 2e-15), (1.0, 2e-18)
    factor = Factor(r, np.ones(6), 100)
    for left, other in ((0, 1), (1, 0), (2, 3), (3, 2)):
        assert set(NullSpace().supports(factor, left, tuple(range(6)))) == {(other,)}
    assert list(NullSpace().supports(factor, 4, tuple(range(6)))) == []


def test_a_null_vector_that_hardly_holds_the_guess_is_not_its_own():
    theta = np.random.default_rng(15).normal(size=(300, 12))
    theta[:, 9] = theta[:, 1] - 0.8 * theta[:, 6] + 0.004 * theta[:, 2]
    factor = factorise([theta])
    assert set(NullSpace().supports(factor, 1, tuple(range(12)))) == {(6, 9)}
    assert list(NullSpace().supports(factor, 2, tuple(range(12)))) == []


def test_exchanges_end_where_a_fit_is_exact_but_for_rounding():
    """What is left may then be below nothing: with one row more than columns every support leaves next to nothing."""
    rng = np.random.default_rng(0)
    for rows in (3, 4, 5):
        factor = factorise([rng.standard_normal((rows, 8)) @ np.diag(10.0 ** rng.uniform(-3.0, 3.0, 8))])
        support = exchanged(factor, 0, tuple(range(1, 8)), (1, 2, 3, 4))
        assert len(support) == 4


def test_an_exchange_is_the_best_of_all_exchanges():
    """Of columns that are alike to a ten-thousandth, beside a fit of every support by itself."""
    columns = tuple(range(1, 12))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        base = rng.standard_normal((200, 4))
        alike = [base[:, rng.integers(4)] + 10.0 ** rng.uniform(-4, 0) * rng.standard_normal(200) for _ in range(12)]
        factor = factorise([np.column_stack(alike)])
        here = tuple(sorted(rng.choice(columns, 3, replace=False).tolist()))
        end = exchanged(factor, 0, columns, here)
        left = {s: factor.residual(factor.solve((0, *s), 0)) for s in combinations(columns, 3) if len({*s, *end}) <= 4}
        assert left[end] <= min(left.values()) * (1.0 + 1e-6)
        assert left[end] <= factor.residual(factor.solve((0, *here), 0))
