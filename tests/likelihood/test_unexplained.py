"""What functions leave of a target, against least squares in all columns at once."""

import numpy as np
import pytest

from odescope.likelihood.unexplained import unexplained


def least_squares(target, rows):
    return target - np.linalg.lstsq(rows.T, target)[0] @ rows


@pytest.mark.parametrize("many", [1, 2])
def test_functions_leave_what_least_squares_in_all_columns_leave(many):
    rng = np.random.default_rng(many)
    target, base, functions = rng.normal(size=200), rng.normal(size=(3, 200)), 1e5 * rng.normal(size=(4, many, 200))
    there = np.linalg.qr(base.T)[0].T.copy()
    found = unexplained(least_squares(target, base), there, functions)
    for left, own in zip(found, functions, strict=True):
        np.testing.assert_allclose(left, least_squares(target, np.vstack([base, 1e-5 * own])), atol=1e-10)


def test_functions_of_which_one_is_said_by_others_leave_everything():
    rng = np.random.default_rng(0)
    base, other = rng.normal(size=(2, 100)), rng.normal(size=100)
    there = np.linalg.qr(base.T)[0].T.copy()
    rest = least_squares(rng.normal(size=100), base)
    said = np.array([[[2.0, -3.0] @ base, other], [other, 5.0 * base[0]], [np.zeros(100), other]])
    assert np.array_equal(unexplained(rest, there, said), np.tile(rest, (3, 1)))


def test_without_anything_beside_a_function_leaves_what_is_orthogonal_to_it():
    rng = np.random.default_rng(3)
    target, one = rng.normal(size=50), rng.normal(size=50)
    (left,) = unexplained(target, np.empty((0, 50)), one[None, None])
    np.testing.assert_allclose(left, target - (target @ one) / (one @ one) * one, atol=1e-12)
