"""Inclusion of terms under a bootstrap of pieces: their factors, certain and uncertain terms, the cost in searches."""

import numpy as np
import pytest

from odescope import Data, Driven, EnergyThreshold, Measured, Study, identify
from odescope.likelihood.search import LikelihoodSearch
from odescope.parallel.workers import Threads
from odescope.regression.factor import factorise, merge
from odescope.selection.bootstrap import REPLICATES, _drawn, _merged, inclusion
from odescope.selection.sweep import nested_libraries

STUDY = Study(
    data=Data(time="t"),
    coordinates={"x": Measured(order=2)},
    inputs={"u": Driven()},
    likelihood=LikelihoodSearch(enabled=False),
)


def driven(seed, noise):
    """Return a Duffing oscillator x'' = u - 4 x - 0.3 x' - x^3 under two tones, by RK4 on a fine grid."""
    step, count, fine = 0.02, 3000, 5
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)

    def u(t):
        return 3.0 * np.sin(0.9 * t + phases[0]) + 2.0 * np.sin(2.3 * t + phases[1]) + np.sin(3.7 * t + phases[2])

    def slope(t, s):
        return np.array([s[1], u(t) - 4.0 * s[0] - 0.3 * s[1] - s[0] ** 3])

    h, state, rows = step / fine, np.array([0.5, 0.0]), []
    for k in range(count * fine):
        t = k * h
        if k % fine == 0:
            rows.append(state[0])
        a = slope(t, state)
        b = slope(t + h / 2, state + h / 2 * a)
        c = slope(t + h / 2, state + h / 2 * b)
        state = state + h / 6 * (a + 2 * b + 2 * c + slope(t + h, state + h * c))
    t = step * np.arange(count)
    return {"t": t, "x": np.array(rows) + noise * rng.standard_normal(count), "u": u(t)}


@pytest.fixture(scope="module")
def clear():
    return identify(STUDY, driven(0, 1e-3))


def test_pieces_make_up_the_rows_of_the_problem(clear):
    problem = clear.searches[0].problem
    assert sum(p.rows for p in problem.pieces) == problem.factor.rows
    whole = merge(problem.pieces)
    np.testing.assert_allclose(np.abs(whole.r), np.abs(problem.factor.r), atol=1e-10)


def test_a_drawn_factor_is_that_of_the_repeated_rows(clear):
    problem = clear.searches[0].problem
    times = np.random.default_rng(3).integers(0, 3, len(problem.pieces))
    quick = _merged(times, _drawn(problem, clear.chosen[0], [range(len(problem.terms))], [EnergyThreshold()]))
    rows = [p.r * p.scale for p, n in zip(problem.pieces, times, strict=True) for _ in range(n)]
    slow = factorise(rows)
    assert quick.rows == sum(p.rows * n for p, n in zip(problem.pieces, times, strict=True))
    support = clear.chosen[0].support
    for left in support:
        np.testing.assert_allclose(quick.solve(support, left), slow.solve(support, left), rtol=1e-6, atol=1e-9)


def test_terms_of_a_clear_law_are_always_chosen_and_others_hardly_ever(clear):
    search, chosen = clear.searches[0], clear.chosen[0]
    true = list(chosen.support)
    assert {search.problem.terms[j].text for j in true} == {"x_ddot", "x", "x_dot", "u", "x**3"}
    assert np.all(search.inclusion[true] >= 0.95)
    assert np.all(np.delete(search.inclusion, true) <= 0.2)


def test_with_more_noise_the_choice_is_less_sure(clear):
    noisy = identify(STUDY, driven(0, 0.1))

    def doubt(result):
        share = result.searches[0].inclusion
        return float(np.sum(share * (1.0 - share)))

    assert doubt(noisy) > 3.0 * doubt(clear) + 0.1
    counts = noisy.searches[0].inclusion * REPLICATES
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)


def test_the_seed_decides_and_the_cost_is_that_of_few_guesses(clear):
    problem, chosen = clear.searches[0].problem, clear.chosen[0]
    asked = []

    class Counted:
        def supports(self, factor, left, columns):
            asked.append(left)
            yield from EnergyThreshold(terms=30).supports(factor, left, columns)

    nested = nested_libraries(problem.terms, problem.own)
    one, two = (inclusion(problem, chosen, nested, [Counted()], np.random.default_rng(7), Threads()) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert set(asked) == {chosen.guess}
    sweep = sum(len(n) for n in nested)  # searches of one sweep: every guess in every set that holds it
    assert len(asked) / 2 <= 3 * sweep
