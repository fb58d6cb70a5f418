"""Coefficients by least squares in linear relations, and fits that begin with them where a search stands far off."""

from dataclasses import replace

import numpy as np
import pytest
from test_scale_of_relations import DRAIN, FILL, LAW, TANK, tank

from odescope.likelihood.add_and_drop import Moves
from odescope.likelihood.linear_relations import by_least_squares
from odescope.likelihood.search import WhiteResiduals

SEEDS = range(3)
WRONG = np.array([0.0, -0.02, 0.5, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0])  # of the law's terms, one with the other sign


def standing(it, theta, present, iterations=0):
    """Return a fit of the tank in open segments, after so many steps."""
    loose = it.segments.spread * np.inf
    return it.fit(theta, np.array(present), it.segments.initial, loose, iterations=iterations)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_law_follows_up_to_its_scale_from_whatever_coefficients(seed):
    it = tank(seed)
    found = by_least_squares(it, standing(it, WRONG, LAW))
    assert np.flatnonzero(found).tolist() == LAW
    assert found[[2, 3]] / found[1] == pytest.approx([-FILL, DRAIN], rel=0.05)


def test_it_is_least_squares_with_the_law_solved_for_what_is_known():
    it = tank(0)
    held = tuple(replace(m, known=2.0) if k == 1 else m for k, m in enumerate(it.mechanisms))
    it = replace(it, mechanisms=held)
    present = [1, 2, 3, 5]
    theta = np.where(np.isin(np.arange(9), present), 0.3, 0.0)
    theta[1] = 2.0
    found = by_least_squares(it, standing(it, theta, present))
    segments = it.segments
    x, u = segments.filtered[:, 0], segments.inputs[:, 0, 0]
    rate = np.concatenate([np.gradient(x[a:b], segments.step) for a, b in segments.runs])
    columns = np.column_stack([u, np.ones_like(x), x**2])
    expected = np.linalg.lstsq(columns, -2.0 * x * rate, rcond=None)[0]
    assert found[1] == 2.0
    assert found[[2, 3, 5]] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_search_that_stands_far_off_begins_anew_and_one_at_its_end_does_not(seed):
    it, trail = tank(seed), []
    best = standing(it, TANK.theta, LAW, iterations=50)
    moves = Moves(it, WhiteResiduals(it, it.segments.spread * np.inf), np.inf, 1.0, trail)
    far = standing(it, WRONG, LAW)
    assert far.cost > 100.0 * best.cost
    assert moves.begin_anew(far).cost == pytest.approx(best.cost, abs=0.1)
    assert moves.begin_anew(best) is None


def test_where_a_term_has_no_value_the_search_goes_on_from_where_it_stands():
    it, trail = tank(0), []
    far = standing(it, WRONG, LAW)
    it.segments.filtered[7] = np.inf
    assert by_least_squares(it, far) is None
    moves = Moves(it, WhiteResiduals(it, it.segments.spread * np.inf), np.inf, 1.0, trail)
    assert moves.begin_anew(far) is None
