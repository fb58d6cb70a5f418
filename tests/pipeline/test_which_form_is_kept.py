"""Which of several forms is kept, where free runs say it and where they cannot."""

from types import SimpleNamespace

import pytest

from odescope.likelihood.path import LOST
from odescope.pipeline.contender import Contender, best_of, leave_little


def contender(form, coefficients, free_run, cost):
    """A form that follows its record with noise of the process, at this penalised cost; None: it does not compare."""

    def gained_over(other):
        return None if None in (cost, other.cost) else other.cost - cost

    refinement = SimpleNamespace(exact=False, follows=True, cost=cost, gained_over=gained_over)
    return Contender(form, None, refinement, None, coefficients, free_run)


@pytest.mark.parametrize(
    ("errors", "costs", "kept"),
    [
        ((0.3, 0.2), (0.0, 100.0), "relations"),  # free runs tell
        ((0.92, 0.7), (0.0, 100.0), "lagrangian"),  # those of what a controller balances do not: likelihood does
        ((0.92, 0.7), (100.0, 0.0), "relations"),
        ((0.92, 0.7), (None, 0.0), "relations"),  # where that does not compare, they are all there is
        ((LOST + 0.1, LOST - 0.1), (0.0, 100.0), "relations"),  # one of them stays with the record
    ],
)
def test_likelihood_decides_where_every_free_run_leaves_the_record(errors, costs, kept):
    sizes = {"lagrangian": 7, "relations": 3}
    pairs = zip(sizes.items(), errors, costs, strict=True)
    forms = [contender(form, size, error, cost) for (form, size), error, cost in pairs]
    assert best_of(forms).form == kept
    assert best_of(forms[::-1]).form == kept


def test_of_forms_that_run_as_well_the_one_of_fewer_coefficients_is_kept():
    forms = [contender("lagrangian", 7, 0.10, 0.0), contender("relations", 3, 0.105, 50.0)]
    assert best_of(forms).form == "relations"


@pytest.mark.parametrize(("coefficients", "kept"), [(5, "relations"), (6, "relations"), (7, "lagrangian")])
def test_an_energy_that_is_not_told_from_nothing_gives_way_to_what_says_as_much(coefficients, kept):
    segments = SimpleNamespace(block=1)

    def exact(form, count, deviance, loose):
        refinement = SimpleNamespace(
            exact=True,
            follows=True,
            outcome=SimpleNamespace(deviance=deviance),
            space=SimpleNamespace(segments=segments),
        )
        return Contender(form, None, refinement, None, count, 0.03, loose=loose)

    forms = [exact("lagrangian", 6, 0.0, True), exact("relations", coefficients, 5.0, False)]
    assert best_of(forms).form == kept


@pytest.mark.parametrize(("coefficients", "free_run", "left"), [(13, 0.021, False), (13, 0.03, True), (20, 0.02, True)])
def test_mechanisms_that_take_more_to_run_as_well_as_relations_do_leave_these_to_find(coefficients, free_run, left):
    clear = SimpleNamespace(clear=True, follows=True, exact=True, says_all=True)
    mechanisms = Contender("lagrangian", None, clear, None, 20, 0.02)
    assert leave_little([mechanisms], [Contender("relations", None, None, None, coefficients, free_run)]) is left
