"""The best small sets of mechanisms, against least squares over all sets anew, and in a search."""

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from odescope.likelihood.subsets import LARGEST, subsets

ROWS, PRICE, SCALE = 300, 9.0, 1.3
OWN = np.array([True, True, True, False, True, True, True, False])


def regression(seed):
    """Return rows of unlike scales, of which the first four of one relation add up to two others, and what they say."""
    rng = np.random.default_rng(seed)
    design = rng.standard_normal((ROWS, 8))
    design[:, 5] = design[:, [0, 1]].sum(axis=1) + 1e-3 * design[:, 5]
    design[:, 6] = design[:, [2, 4]].sum(axis=1) + 1e-3 * design[:, 6]
    y = 20.0 * design[:, 5] - 30.0 * design[:, 6] + 5.0 * design[:, 3] + rng.standard_normal(ROWS)
    return design * 10.0 ** np.arange(-4, 4), y


def least(design, y, columns):
    """Return coefficients (8,) of some columns, and the sum of squares that they leave."""
    theta = np.zeros(design.shape[1])
    theta[columns] = np.linalg.lstsq(design[:, columns], y, rcond=None)[0]
    return theta, float(np.sum((y - design @ theta) ** 2))


def about(design, y, theta):
    """Return the expansion of a sum of squares."""
    return SimpleNamespace(information=design.T @ design, gradient=-design.T @ (y - design @ theta))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("fitted", [True, False], ids=["at the least cost", "elsewhere"])
def test_of_every_size_it_is_the_best_that_fits_anew_find(seed, fitted):
    design, y = regression(seed)
    present = np.array([True, True, True, True, True, False, False, False])
    theta, cost = least(design, y, np.flatnonzero(present))
    theta = theta if fitted else np.where(present, 1.2 * theta, 0.0)
    found = subsets(about(design, y, theta), theta, present, OWN, np.full(8, PRICE), SCALE)
    assert len(found) == LARGEST
    assert [earned for earned, _ in found] == sorted((earned for earned, _ in found), reverse=True)
    assert found[0][1].tolist() == [5, 6]
    for earned, members in found:
        sizes = combinations(np.flatnonzero(OWN), len(members))
        best = min(sizes, key=lambda chosen: least(design, y, [*chosen, 3])[1])
        assert members.tolist() == list(best)
        lost = (least(design, y, [*best, 3])[1] - cost) / SCALE
        assert earned == pytest.approx((4 - len(members)) * PRICE - lost, rel=1e-3, abs=1e-2)


def test_no_set_is_larger_than_what_it_stands_for():
    design, y = regression(0)
    present = np.array([True, False, False, True, True, False, False, False])
    theta, _ = least(design, y, np.flatnonzero(present))
    found = subsets(about(design, y, theta), theta, present, OWN, np.full(8, PRICE), SCALE)
    assert max(len(members) for _, members in found) == 2


def test_a_relation_of_nothing_else_has_none():
    design, y = regression(0)
    present = ~OWN
    theta, _ = least(design, y, np.flatnonzero(present))
    assert subsets(about(design, y, theta), theta, present, OWN, np.full(8, PRICE), SCALE) == []


def test_what_cannot_be_told_apart_is_no_set_and_costs_nothing_to_be_one_of():
    """A column that is twice another: with it a set says what it says with the other, and with both nothing more."""
    design, y = regression(0)
    design[:, 4] = 2.0 * design[:, 0]
    y = y + 40.0 * design[:, 0]
    present = np.array([True, True, True, True, False, False, False, False])
    theta, _ = least(design, y, np.flatnonzero(present))
    found = subsets(about(design, y, theta), theta, present, OWN, np.full(8, PRICE), SCALE)
    assert not any({0, 4} <= set(members.tolist()) for _, members in found)


def test_what_grows_beyond_all_bounds_has_no_sets():
    design, y = regression(0)
    present = np.array([True, True, True, True, True, False, False, False])
    theta, _ = least(design, y, np.flatnonzero(present))
    away = SimpleNamespace(information=design.T @ design, gradient=np.full(8, 1e308))
    assert subsets(away, theta, present, OWN, np.full(8, PRICE), SCALE) == []
