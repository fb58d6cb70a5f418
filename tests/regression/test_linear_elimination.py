"""Elimination in the linear relations: the law where noise explains it, nothing where it does not."""

from dataclasses import replace

import numpy as np
import pytest
from test_mechanisms import TRUTH, cart, coefficients, named

from odescope.regression.linear_elimination import explained
from odescope.regression.mechanisms import MechanismProblem

SEEDS = range(4)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("level", [2, 3])
def test_the_law_of_the_cart_is_among_few_that_are_left(level, seed):
    problem, noisy = cart(level, seed)
    found = named(problem, explained(problem, noisy))
    law = {k: v for k, v in TRUTH.items() if k != "phi_dot**2 in dissipation"}  # friction that noise hides
    assert law.keys() <= found.keys()
    assert len(found) <= len(TRUTH) + 2
    scale = found["u in force on x"]
    for name, value in law.items():
        assert found[name] / scale == pytest.approx(value, rel=0.2)


def test_what_is_known_stays_and_gives_the_scale():
    problem, noisy = cart(3)
    free = explained(problem, noisy)
    k = next(k for k, m in enumerate(problem.mechanisms) if str(m) == "u in force on x")
    held = tuple(replace(m, known=2.0) if j == k else m for j, m in enumerate(problem.mechanisms))
    found = explained(replace(problem, mechanisms=held), noisy)
    assert found[k] == 2.0
    np.testing.assert_allclose(found, free * 2.0 / free[k], rtol=1e-9)


def test_without_the_force_that_drives_it_there_is_no_law():
    problem, noisy = cart(3)
    left = tuple(m for m in problem.mechanisms if m.kind != "force")
    without = MechanismProblem.of(problem.signals, left)
    found = explained(without, noisy)
    assert found is None or np.any(coefficients(without, TRUTH)[found == 0.0])
