"""A joined trajectory that hangs above the lowest minimum of its cost is opened and joined again."""

from dataclasses import replace

import numpy as np
import pytest
from small_systems import spring_search

from odescope.likelihood import local_minima
from odescope.likelihood.local_minima import joined_again, out_of_local_minima
from odescope.likelihood.search import fitted_again


@pytest.fixture(scope="module")
def spring():
    return spring_search()


def test_what_is_at_the_lowest_minimum_stays_as_it_is(spring):
    space, best = spring
    assert joined_again(space, best) is best


def test_what_hangs_above_it_comes_down_with_the_same_terms(spring):
    space, best = spring
    width = space.segments.spread * best.width
    off = best.fit.theta.copy()
    off[best.fit.free] *= 1.0 + 0.02 * np.arange(len(best.fit.free))
    hung = space.again(replace(best.fit, theta=off), best.fit.x0, width, iterations=0)
    assert hung.cost > best.fit.cost + 10.0
    end = joined_again(space, fitted_again(space, best, hung))
    assert end.fit.present.tolist() == best.fit.present.tolist()
    assert end.fit.cost == pytest.approx(best.fit.cost, abs=0.1)
    assert end.price == pytest.approx(best.price, rel=1e-6)


@pytest.mark.parametrize("width", [5.0, None])
def test_no_term_that_is_needed_is_left_out(spring, width, monkeypatch):
    space, best = spring
    end = replace(best, width=width or best.width)
    monkeypatch.setattr(local_minima, "_shared", lambda *_: [[k] for k in best.fit.free.tolist()])
    assert out_of_local_minima(space, end).fit is end.fit


def test_a_term_that_stands_for_nothing_is_left_out(spring, monkeypatch):
    space, best = spring
    more = int(np.setdiff1d(np.arange(len(space.mechanisms)), best.fit.present)[0])
    present = np.union1d(best.fit.present, [more])
    with_more = space.fit(best.fit.theta, present, best.fit.x0, space.segments.spread * best.width)
    monkeypatch.setattr(local_minima, "_shared", lambda *_: [[more]])
    end = out_of_local_minima(space, fitted_again(space, best, with_more))
    assert end.fit.present.tolist() == best.fit.present.tolist()
