"""A law times a function is that law: the bootstrap counts both as one."""

import numpy as np
import pytest

from odescope import Data, EnergyThreshold, Measured, Study, identify
from odescope.likelihood.search import LikelihoodSearch
from odescope.parallel.workers import Threads
from odescope.selection.bootstrap import inclusion

LAW = {"x_dot", "x", "x**2"}


@pytest.fixture(scope="module")
def logistic():
    """x' = x - x^2, from many beginnings."""
    rng, t, records = np.random.default_rng(4), 0.02 * np.arange(500), []
    for x0 in rng.uniform(0.02, 0.3, 6):
        x = 1.0 / (1.0 + (1.0 / x0 - 1.0) * np.exp(-t))
        records.append({"t": t, "x": x + 1e-4 * rng.standard_normal(len(t))})
    study = Study(data=Data(time="t"), coordinates={"x": Measured()}, likelihood=LikelihoodSearch(enabled=False))
    return identify(study, records)


class Multiples:
    """Proposes the law times x alone, x x' = x^2 - x^3: another form of the same."""

    def __init__(self, problem):
        place = {term.text: j for j, term in enumerate(problem.terms)}
        self.form = [place[text] for text in ("x_dot*x", "x**2", "x**3")]

    def supports(self, factor, left, columns):
        if left in self.form:
            yield tuple(j for j in self.form if j != left)


def test_a_multiple_of_the_law_counts_as_the_law(logistic):
    search, chosen = logistic.searches[0], logistic.chosen[0]
    problem = search.problem
    assert {problem.terms[j].text for j in chosen.support} == LAW
    multiples = Multiples(problem)
    guess = next(j for j in multiples.form if problem.terms[j].text == "x**2")
    at_guess = type(chosen)(**{**vars(chosen), "guess": guess})
    whole = [tuple(range(len(problem.terms)))]
    shares = inclusion(problem, at_guess, whole, [multiples], np.random.default_rng(0), Threads())
    assert {problem.terms[j].text for j in np.flatnonzero(shares)} == LAW
    assert set(shares[shares > 0.0]) == {1.0}


def test_with_multiples_among_what_is_searched_the_terms_of_the_law_stay_certain(logistic):
    search, chosen = logistic.searches[0], logistic.chosen[0]
    problem = search.problem
    whole = [tuple(range(len(problem.terms)))]
    both = [EnergyThreshold(), Multiples(problem)]
    shares = inclusion(problem, chosen, whole, both, np.random.default_rng(1), Threads())
    for j in chosen.support:
        assert shares[j] >= 0.9, problem.terms[j].text
