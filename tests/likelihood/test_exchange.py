"""One mechanism for two: what it does to cost and coefficients, against least squares, and in a search."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_systems import SPRING, SPRING_PRESENT, SPRING_STEP, drive, shots, spring_run

from odescope.library.constants import Constant
from odescope.library.mechanism import Mechanism, candidate
from odescope.library.parse import Scope, parse_term
from odescope.library.product import Product
from odescope.likelihood.add_and_drop import Moves
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.evidence import project
from odescope.likelihood.exchange import FAR, foreseen, refitted, rise
from odescope.likelihood.program import Frame
from odescope.likelihood.search import WhiteResiduals, search
from odescope.likelihood.search_space import SearchSpace
from odescope.recordings.coordinate import Coordinate

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


def test_there_are_no_coefficients_where_one_says_nothing_but_rounding():
    design, y = regression(1)
    theta, information = least(design, y, np.flatnonzero(PRESENT))[0], design.T @ design
    gradient = -design.T @ (y - design @ theta)
    information[4], information[:, 4], gradient[4] = 0.0, 0.0, 1e-12
    expansion = SimpleNamespace(information=information, gradient=gradient)
    assert refitted(expansion, theta, np.array([0, 3, 4])) is None
    assert refitted(expansion, theta, np.array([0, 3, 5])) is not None


def one_at_a_time(design, y, present, able, price):
    """Return which columns stay when the best addition or drop, by least squares anew, is made until none is better."""
    kept = present.copy()
    for _ in range(FAR):
        costs = {k: least(design, y, kept ^ (np.arange(6) == k))[1] - (price if kept[k] else -price) for k in able}
        best = min(costs, key=lambda k: costs[k])
        if costs[best] >= least(design, y, kept)[1]:
            break
        kept[best] = not kept[best]
    return kept


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("able", [range(6), (0, 2, 3, 4)], ids=["all", "some"])
def test_what_is_foreseen_is_what_fits_anew_choose_one_at_a_time(seed, able):
    design, y = regression(seed)
    begun = np.array([False, False, True, False, True, False]) | ~np.isin(np.arange(6), able)
    theta, _ = least(design, y, begun)
    expansion = SimpleNamespace(information=design.T @ design, gradient=-design.T @ (y - design @ theta))
    kept = foreseen(expansion, theta, begun, np.isin(np.arange(6), able), np.full(6, 9.0), 1.0)
    assert kept.tolist() == one_at_a_time(design, y, begun, able, 9.0).tolist()
    assert kept.tolist() != begun.tolist()


def test_nothing_is_foreseen_of_runs_that_grow_beyond_all_bounds():
    design, y = regression(0)
    begun = np.array([False, False, True, False, True, False])
    theta, _ = least(design, y, begun)
    gradient = -design.T @ (y - design @ theta)
    expansion = SimpleNamespace(information=design.T @ design, gradient=1e200 * gradient)
    kept = foreseen(expansion, theta, begun, np.ones(6, dtype=bool), np.full(6, 9.0), 1.0)
    assert kept.tolist() == begun.tolist()


def test_a_leap_drops_what_is_worth_nothing_and_adds_what_is_lacking_in_one_fit():
    data = shots(spring_run(), drive(), SPRING_STEP, 0.005, np.random.default_rng(0), np.array([0.01, 0.05]))
    it = SearchSpace(Evaluator(data, 2), SPRING.mechanisms, SPRING.frame)
    theta = SPRING.theta.copy()
    theta[[2, 3]], theta[[5, 6]] = 0.0, 0.1
    here = it.begin(theta, it.segments.spread)
    judge, trail = WhiteResiduals(it, it.segments.spread), []
    moves = Moves(it, judge, 1.0, 1.0, trail)
    there = moves.leap(here, judge.expansion(here))
    assert there is not None
    # What a move by itself is for may be left: a term too many.
    assert set(SPRING_PRESENT) <= set(there.present)
    assert len(there.present) <= len(SPRING_PRESENT) + 1
    assert moves.penalised(there) < moves.penalised(here)
    assert {("drop", it.mechanisms[k]) for k in (5, 6)} | {("add", it.mechanisms[k]) for k in (2, 3)} <= {
        (m.action, m.mechanism) for m in trail
    }
    assert moves.leap(there, judge.expansion(there)) is None


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


def test_a_power_gives_way_to_the_variable_that_it_is_within_its_error():
    """Its exponent goes with it: that is what the exchange of one coefficient for one earns."""
    coordinate, exponent = Coordinate("x"), Constant("e", 0.2, 4.0, 0.9)
    terms = [Product("x_dot"), *(Product(None, parse_term(t, Scope.of(["x"], constants=["e"]))) for t in ("1", "x"))]
    terms.append(Product(None, parse_term("x**e", Scope.of(["x"], constants=["e"]))))
    mechanisms = (*(candidate(0, t, "x_dot") for t in terms), Mechanism("constant", "constant e", "e", (), 0.0))
    frame = replace(Frame.of((coordinate,), ()), constants={"e": exponent})
    t = 0.01 * np.arange(300)
    states = (1.5 - 1.3 * np.exp(-2.0 * t))[:, None]
    data = shots(states, np.zeros((300, 3, 0)), 0.01, 0.002, np.random.default_rng(0), np.array([0.01]))
    it = SearchSpace(Evaluator(data, 2), mechanisms, frame)
    here = it.begin(np.array([1.0, -3.0, 0.0, 2.0, exponent.coefficient(1.02)]), it.segments.spread)
    judge = WhiteResiduals(it, it.segments.spread)
    assert 4 in here.present
    there = Moves(it, judge, 1.0, 1.0, []).exchange(here, judge.expansion(here))
    assert there is not None
    assert there.present.tolist() == [0, 1, 2]
