"""Searches once more with short steps, where the end of the first owed its fit to long ones."""

from dataclasses import replace

import pytest
from small_systems import SPRING, spring_search

from odescope.likelihood import anew
from odescope.parallel.workers import Threads


@pytest.fixture(scope="module")
def spring():
    return spring_search()


def settled(spring, monkeypatch, rise, known=1.0):
    """Return the end where finer steps make the first model dearer by so much, and how often was searched anew.

    They leave so much of what is known of its coefficients.
    """
    (space, best), calls = spring, []

    def finer(there, outcome):
        if outcome is not best:
            return there.finer(4), outcome
        fit = replace(outcome.fit, information=known * outcome.fit.information)
        return there.finer(4), replace(outcome, price=outcome.price + rise, fit=fit)

    def searches(seen, begun, *_):
        calls.append((seen.evaluator.substeps, len(begun)))
        return [replace(best, price=best.price + 1.0)]

    monkeypatch.setattr(anew, "with_finer_steps", finer)
    monkeypatch.setattr(anew, "searches", searches)
    _, end = anew.with_steps_settled(space, best, [SPRING.theta], Threads())
    return end.price - best.price, calls


def test_what_coarse_steps_promised_and_fine_ones_do_not_keep_is_searched_for_again(spring, monkeypatch):
    assert settled(spring, monkeypatch, 20.0) == (pytest.approx(1.0), [(4, 2)])


def test_where_fine_steps_change_nothing_there_is_no_other_search(spring, monkeypatch):
    assert settled(spring, monkeypatch, 5.0) == (pytest.approx(5.0), [])


def test_a_model_of_which_fine_steps_leave_nothing_known_is_not_kept(spring, monkeypatch):
    """Near a denominator that passes zero runs part without bound: all that they share is the cost."""
    end, calls = settled(spring, monkeypatch, 0.0, 1e-12)
    assert (end, calls) == (pytest.approx(1.0), [(4, 2)])
