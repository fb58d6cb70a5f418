import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_systems import (
    SPRING,
    SPRING_PRESENT,
    SPRING_STEP,
    drive,
    in_bare_gauge,
    shots,
    spring_run,
)

from odescope.errors import Stopped
from odescope.events import Monitor
from odescope.library.mechanism import candidate
from odescope.likelihood.add_and_drop import Moves
from odescope.likelihood.budget import Budget
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.search import WhiteResiduals, _to_earn, search
from odescope.likelihood.search_space import SearchSpace

NOISE = 0.02
SPREAD = np.array([0.01, 0.05])


@pytest.fixture(scope="module")
def states():
    return spring_run()


def space(states, seed, noise=NOISE, budget=None):
    data = shots(states, drive(), SPRING_STEP, noise, np.random.default_rng(seed), SPREAD)
    return SearchSpace(
        Evaluator(data, 2, budget),
        SPRING.mechanisms,
        SPRING.frame,
    )


def begin(present):
    theta = SPRING.theta.copy()
    theta[[k for k in range(1, len(theta)) if k not in present]] = 0.0
    for k in set(present) - set(SPRING_PRESENT.tolist()):
        theta[k] = 0.05
    return theta


def worst_error(it, found):
    """Return the largest deviation from the truth, in standard errors."""
    bare, terms = in_bare_gauge(it, found.fit), found.fit.present[1:]
    return np.abs((bare.theta - SPRING.theta)[terms] / bare.errors[terms]).max()


STARTS = {
    "the truth": [1, 2, 3, 4],
    "one dropped": [1, 2, 4],
    "one invented": [1, 2, 3, 4, 6],
    "dropped and invented": [1, 3, 4, 5, 9],
    "x**2 for x**3, and a denominator": [1, 2, 4, 5, 8],
    "almost nothing": [1],
}


@pytest.mark.parametrize("name", STARTS)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_truth_is_found_from_starts_that_lack_terms_or_have_more(states, name, seed):
    it = space(states, seed)
    found = search(it, begin(STARTS[name]))
    assert found is not None
    assert sorted(found.fit.present) == SPRING_PRESENT.tolist()
    assert found.finished
    assert worst_error(it, found) < 4.0
    assert found.scale == pytest.approx(1.0, abs=0.2)


def test_all_starts_end_in_the_same_fit(states):
    it = space(states, 3)
    ends = [search(it, begin(present)).fit for present in STARTS.values()]
    first = in_bare_gauge(it, ends[0]).theta
    for end in ends[1:]:
        bare = in_bare_gauge(it, end)
        np.testing.assert_allclose(bare.theta, first, atol=0.03 * bare.errors.max())
        assert end.cost == pytest.approx(ends[0].cost, abs=0.1)


def test_the_trail_says_what_moved(states):
    found = search(space(states, 0), begin(STARTS["dropped and invented"]))
    now = {0, *STARTS["dropped and invented"]}
    names = {mechanism: k for k, mechanism in enumerate(SPRING.mechanisms)}
    for move in found.trail:
        k = names[move.mechanism]
        assert (k in now) == (move.action == "drop")
        now ^= {k}
    assert now == set(found.fit.present.tolist())


@pytest.mark.parametrize("seed", [3, 5])
def test_a_look_alike_that_came_first_gives_way(states, seed):
    # So noisy that x**3 does not earn its penalty beside x**5, nor x**5 fail to earn its own alone.
    it = space(states, seed, noise=0.2)
    fifth = candidate(0, SPRING.product(-1, "x**5"), "x_ddot")
    it = replace(it, mechanisms=tuple(fifth if k == 5 else m for k, m in enumerate(it.mechanisms)))
    good, poor = (search(it, begin(present)) for present in ([1, 2, 3, 4], [1, 2, 4, 5]))
    assert sorted(poor.fit.present) == sorted(good.fit.present) == SPRING_PRESENT.tolist()
    assert poor.fit.cost == pytest.approx(good.fit.cost, abs=0.1)


@pytest.mark.parametrize("held", [0, 1, 4, 5], ids=["x_ddot", "x", "u", "x**5"])
def test_a_look_alike_gives_way_whichever_coefficient_is_held(states, held):
    it = space(states, 3, noise=0.2)
    fifth = candidate(0, SPRING.product(-1, "x**5"), "x_ddot")
    it = replace(it, mechanisms=tuple(fifth if k == 5 else m for k, m in enumerate(it.mechanisms)))
    width, present = 0.1, np.array([0, 1, 2, 4, 5])
    found = it.begin(begin([1, 2, 4, 5]), SPREAD * width)
    free = np.setdiff1d(present, [held])
    program, theta = it.program(present), found.theta[present]
    expansion = it.evaluator.expand(program, theta, np.searchsorted(present, free), found.x0, SPREAD * width)
    here = replace(found, held=np.array([held]), information=expansion.information)
    moves = Moves(it, WhiteResiduals(it, SPREAD * width), width, 1.0, [])
    there = moves.look_back(here)
    assert there is not None
    assert sorted(there.present) == SPRING_PRESENT.tolist()


def test_all_penalties_are_those_of_one_prior_and_simple_terms_are_cheaper(states):
    it = space(states, 0)
    share = np.exp(0.5 * (np.log(it.segments.measured.size) - it.penalty))
    assert share[1:].sum() == pytest.approx(1.0)
    penalty = {m.term: p for m, p in zip(it.mechanisms, it.penalty, strict=True)}
    assert penalty["x**2"] - penalty["x"] == pytest.approx(2.0 * np.log(2.0))
    assert penalty["u*x"] == penalty["x**2"]
    assert penalty["x_ddot*x**2"] == penalty["x**3"]


@pytest.mark.slow
def test_over_seeds_the_truth_is_found_and_nothing_else(states):
    ends = [search(space(states, seed), begin(STARTS["one dropped"])) for seed in range(1000, 1060)]
    assert sum(sorted(e.fit.present) == SPRING_PRESENT.tolist() for e in ends) >= 59


def test_searches_repeat_to_the_last_bit(states):
    one, two = (search(space(states, 5), begin(STARTS["almost nothing"])) for _ in range(2))
    assert np.array_equal(one.fit.theta, two.fit.theta)
    assert one.trail == two.trail


def test_a_start_that_blows_up_gives_none_without_a_warning(states):
    theta = begin([1, 2, 3, 4])
    theta[3] = -1e8
    assert search(space(states, 0), theta) is None


@pytest.mark.slow
@pytest.mark.parametrize(("share", "left"), [(0.5, 4), (0.7, 1), (0.97, 1)])
def test_a_start_with_a_pole_inside_the_data_is_left_or_ends_as_no_fit(states, share, left):
    """The denominator 1 + theta x^2 vanishes where |x| is at that quantile.

    Which starts leave it hangs on rounding: of 24 seeds 18 to 20, 7 to 11, and 7 to 11 do, by quantile. Of the others
    one in forty to one in ten ends with another term in place of one of the law's. Stuck ends have the five terms of
    the start and seldom more: of 72 runs seventeen had one more and one had two.
    """
    right, stuck = 0, list[int]()
    for seed in range(8):
        theta, it = begin([1, 2, 3, 4, 8]), space(states, seed)
        theta[8] = -1.0 / np.quantile(states[:, 0] ** 2, share)
        found = search(it, theta)
        ended = sorted(found.fit.present)
        if found.scale < 2.0:
            assert ended == SPRING_PRESENT.tolist()
            assert worst_error(it, found) < 4.0
            right += 1
            continue
        # Stuck: the segments were not joined, the misfit is plain to see, and no terms were added against it.
        assert found.width == np.inf
        assert found.scale > 10.0
        assert len(ended) <= 7
        assert not found.clear
        stuck.append(len(ended))
    assert right >= left
    assert sum(stuck) <= 6 * len(stuck) + 1


def test_where_the_budget_is_spent_the_fit_so_far_is_returned_and_every_run_ends_alike(states):
    start = begin(STARTS["almost nothing"])
    whole = search(space(states, 0, budget=Budget()), start)
    ends = [search(space(states, 0, budget=Budget(0.2 * whole.spent)), start) for _ in range(2)]
    for end in ends:
        assert not end.finished
        assert not end.late
        assert 0.2 * whole.spent < end.spent < whole.spent
        assert end.width > whole.width or len(end.trail) < len(whole.trail)
    assert np.array_equal(ends[0].fit.theta, ends[1].fit.theta)
    assert ends[0].spent == ends[1].spent


@pytest.mark.parametrize(("limit", "spent", "left"), [(60.0, 12.0, 48.0), (60.0, 61.0, 24.0), (np.inf, 61.0, np.inf)])
def test_what_others_have_spent_leaves_a_search_its_share(limit, spent, left):
    rest = Budget(limit, spent=spent).rest(0.4)
    assert rest.limit == pytest.approx(left)
    assert rest.spent == 0.0


def test_the_clock_ends_a_search_only_where_it_is_asked_to_and_then_it_says_so(states):
    end = search(space(states, 0, budget=Budget(deadline=time.time())), begin([1, 2, 3, 4]))
    assert not end.finished
    assert end.late


def test_a_search_stops_at_the_next_evaluation_that_is_told_to(states):
    asked = iter([False] * 5)
    monitor = Monitor(stop=lambda: next(asked, True))
    with pytest.raises(Stopped):
        search(space(states, 0, budget=Budget(monitor=monitor)), begin([1, 2, 3, 4]))
    assert next(asked, "none left") == "none left"


def test_a_constant_that_a_term_needs_earns_nothing_by_itself():
    """At its nominal value it is told from that by no error, and its term is in no doubt for that."""
    space = SimpleNamespace(needed={"energy": 2}, penalty=np.array([16.0, 14.0, 13.0]))
    assert _to_earn(space, SimpleNamespace(free=np.array([0, 2]))).tolist() == [16.0, 0.0]
