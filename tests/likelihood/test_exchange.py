"""One mechanism for two: what it does to cost and coefficients, against least squares, and in a search."""

from types import SimpleNamespace

import numpy as np
import pytest
from small_systems import SPRING, SPRING_PRESENT, SPRING_STEP, drive, shots, spring_run

from odescope.library.mechanism import candidate
from odescope.likelihood.add_and_drop import Moves
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.evidence import project
from odescope.likelihood.exchange import refitted, rise
from odescope.likelihood.search import WhiteResiduals, search
from odescope.likelihood.search_space import SearchSpace

ROWS, PRESENT = 200, np.array([True, True, False, True, False, True])


def regression(seed, near=0.3):
    """Return rows of unlike scales, the third near to the sum of the first two, and what is to be explained."""
    rng = np.random.default_rng(seed)
    design = rng.standard_normal((ROWS, 6))
    design[:, 2] = design[:, 0] + design[:, 1] + near * design[:, 2]
    y = design @ np.array([1.0, 1.2, 0.1, -0.7, 0.0, 0.4]) + rng.standard_normal(ROWS)
    return design * 10.0 ** np.arange(-3, 3), y


def least(design, y, columns):
    """Return coefficients (6,) of some columns, and the sum of squares that they leave."""
    theta = np.zeros(design.shape[1])
    theta[columns] = np.linalg.lstsq(design[:, columns], y, rcond=None)[0]
    return theta, float(np.sum((y - design @ theta) ** 2))


@pytest.mark.parametrize("near", [0.3, 1e-3], ids=["told apart", "hardly told apart"])
def test_the_change_of_the_cost_is_that_of_fits_anew(near):
    design, y = regression(0, near)
    now, new = np.flatnonzero(PRESENT), np.flatnonzero(~PRESENT)
    theta, cost = least(design, y, now)
    gradient = -design.T @ (y - design @ theta)
    rest = project(design.T @ design, gradient[None], PRESENT)
    found = rise(rest, theta[now] * rest.scale[now])
    assert found.shape == (2, 4, 4)
    for a, k in enumerate(new):
        for i in range(4):
            for j in range(4):
                kept = [k, *np.delete(now, [i, j] if i != j else [i])]
                assert found[a, i, j] == pytest.approx(least(design, y, kept)[1] - cost, rel=1e-5, abs=1e-5)


def test_the_coefficients_are_those_of_a_fit_anew_from_wherever_it_begins():
    design, y = regression(1)
    theta = least(design, y, np.flatnonzero(PRESENT))[0] * np.linspace(0.5, 1.5, 6)
    expansion = SimpleNamespace(information=design.T @ design, gradient=-design.T @ (y - design @ theta))
    kept = np.array([2, 3, 5])
    np.testing.assert_allclose(refitted(expansion, theta, kept), least(design, y, kept)[0], rtol=1e-8)


PAIRS = {"exactly": ("u*cos(x)**2", "u*sin(x)**2", 1.0), "nearly": ("u*cos(x)", "u*x**2", 0.5)}


@pytest.mark.parametrize("name", PAIRS)
def test_two_terms_that_add_up_to_one_of_the_law_give_way_to_it(name):
    """Each of the two is sure beside the other, and neither a drop nor an addition leads away from them."""
    *texts, share = PAIRS[name]
    data = shots(spring_run(), drive(), SPRING_STEP, 0.005, np.random.default_rng(0), np.array([0.01, 0.05]))
    pair = [candidate(0, SPRING.product(-1, t), "x_ddot") for t in texts]
    it = SearchSpace(Evaluator(data, 2), (*SPRING.mechanisms, *pair), SPRING.frame)
    theta = np.append(SPRING.theta, [-1.0, -share])
    theta[4] = 0.0
    width = 0.1
    here = it.begin(theta, it.segments.spread * width)
    judge = WhiteResiduals(it, it.segments.spread * width)
    moves = Moves(it, judge, width, 1.0, [])
    assert np.all(here.wald > 1000.0)
    assert moves.drop(here) is None
    assert moves.look_back(here) is None
    there = moves.exchange(here, judge.expansion(here))
    assert there is not None
    assert sorted(there.present) == SPRING_PRESENT.tolist()
    assert moves.penalised(there) < moves.penalised(here)
    assert [(m.action, m.mechanism) for m in moves.trail] == [
        *(("drop", m) for m in pair),
        ("add", SPRING.mechanisms[4]),
    ]
    assert moves.exchange(there, judge.expansion(there)) is None
    found = search(it, theta)
    assert sorted(found.fit.present) == SPRING_PRESENT.tolist()
