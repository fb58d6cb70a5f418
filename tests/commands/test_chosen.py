"""What candidates.csv marks as chosen is the model: of relations, of mechanisms, and where the study overrules."""

import csv

import msgspec
import numpy as np
import pytest
from logs import oscillator
from scipy.integrate import solve_ivp

from odescope.commands.demo import simulate_log
from odescope.commands.files import candidates_csv
from odescope.likelihood.search import LikelihoodSearch
from odescope.model.relation import Relation
from odescope.pipeline.adopted import adopted
from odescope.pipeline.identification import identify
from odescope.study.library_options import Candidates
from odescope.study.options import Data, Driven, Measured, Study

OSCILLATOR = Study(
    data=Data(time="t"),
    coordinates={"x": Measured(order=2)},
    inputs={"u": Driven()},
    library=Candidates(terms=("1", "x", "x_dot", "u", "x**2", "u*x", "x_ddot", "x*x_ddot")),
)


def rows_of(result):
    return list(csv.DictReader(candidates_csv(result).splitlines()))


def assert_the_model_is_chosen(result):
    """One row a target is marked, and its terms are those of the model's relation; ranks count on."""
    rows = rows_of(result)
    chosen = {r["target"]: set(r["support"].split(" + ")) for r in rows if r["chosen"] == "1"}
    assert len([r for r in rows if r["chosen"] == "1"]) == len(result.model.targets)
    for target, relation in zip(result.model.targets, result.model.relations, strict=True):
        assert chosen[target] == {t.product.expanded.text for t in relation.terms}
        own = [r for r in rows if r["target"] == target]
        assert [int(r["rank"]) for r in own] == list(range(1, len(own) + 1))
        assert all(float(r["implicit_rmse"]) >= 0.0 and float(r["acceleration_rmse"]) >= 0.0 for r in own)


@pytest.fixture(scope="module")
def free():
    return identify(OSCILLATOR, oscillator())


def test_of_relations(free):
    assert_the_model_is_chosen(free)
    assert {t.text for t in free.model.relations[0].terms} == {"x_ddot", "x", "x_dot", "u"}


def test_where_the_study_says_how_many_terms(free):
    fewer = msgspec.structs.replace(OSCILLATOR, likelihood=LikelihoodSearch(terms=3))
    overruled = identify(fewer, oscillator())
    assert len(overruled.model.relations[0].terms) < len(free.model.relations[0].terms)
    assert_the_model_is_chosen(overruled)
    judged = overruled.model.scores.likelihood
    assert free.model.scores.likelihood.residual_variance < 1.5 < judged.residual_variance
    assert judged.truncated
    assert "times its noise" in repr(overruled)
    assert not any("to within its noise" in note for note in overruled.notes)


def test_where_another_model_of_the_path_is_taken(free):
    for step in free.model.scores.path:
        other = free.with_terms(step.terms)
        assert_the_model_is_chosen(other)
        (run,) = other.model.scores.free_runs
        assert run.duration == free.model.scores.free_runs[0].duration


def test_terms_that_no_search_came_upon_take_their_place_in_the_ranking(free):
    (search,) = free.searches
    place = {t.text: t for t in search.problem.terms}
    texts = ("x_ddot", "x", "x_dot", "u", "1", "x**2", "u*x")
    known = {frozenset(c.support) for c in search.ranked.candidates}
    terms = {t.text: t for t in free.model.relations[0].terms}
    some = next(iter(terms.values()))
    wide = Relation(tuple(terms.get(text, with_product(some, place[text])) for text in texts))
    columns = frozenset(search.problem.terms.index(place[text]) for text in texts)
    fewer = type(search)(**{**vars(search), "ranked": without(search.ranked, columns)})
    model = type(free.model)(free.model.coordinates, free.model.inputs, (wide,))
    (seen,), (found,) = adopted((fewer,), model)
    assert frozenset(found.support) == columns
    assert any(c is found for c in seen.ranked.candidates)
    assert len(seen.ranked.candidates) == len(fewer.ranked.candidates) + 1
    # As a known one it would have got the same numbers.
    same = next((c for c in search.ranked.candidates if frozenset(c.support) == columns), None)
    if columns in known:
        assert found.target_rmse == pytest.approx(same.target_rmse)
    first = search.problem.factor.solve(found.support, search.problem.left)
    np.testing.assert_allclose(found.xi, first, rtol=1e-9, atol=1e-12)
    heads = {c.family: c.criterion for c in reversed(seen.ranked.candidates)}
    assert [heads[f] for f in sorted(heads)] == sorted(heads.values())


def with_product(like, product):
    """Return a term of a relation that has another product."""
    return type(like)(product, 0.1)


def without(ranked, columns):
    kept = tuple(c for c in ranked.candidates if frozenset(c.support) != columns)
    return type(ranked)(kept, ranked.discarded)


@pytest.mark.slow
def test_of_lagranges_equations_beside_relations_and_alone():
    log = simulate_log(0, 2)
    data = {"t": log.t, "x": log.measured[:, 0], "phi": log.measured[:, 1], "u": log.force}
    study = Study(
        data=Data(time="t"),
        coordinates={"x": Measured(order=2, cyclic=True), "phi": Measured(order=2, angle=True)},
        inputs={"u": Driven()},
        library=Candidates(form="lagrangian"),
    )
    alone = identify(study, data)
    assert alone.model.mechanisms
    assert_the_model_is_chosen(alone)
    assert len(rows_of(alone)) == 2
    both = identify(msgspec.structs.replace(study, library=Candidates(form="auto")), data)
    assert_the_model_is_chosen(both)
    if both.model.mechanisms:
        (first, *_) = [r for r in rows_of(both) if r["chosen"] == "1"]
        assert "phi_ddot" in first["support"]
        assert len(rows_of(both)) > 2


def test_of_reactions():
    t = 0.05 * np.arange(200)
    rng, runs = np.random.default_rng(0), []
    for a, b in ((1.0, 0.2), (0.3, 1.5)):
        y = solve_ivp(lambda _, y: [-y[0] + 0.3 * y[1], y[0] - 0.3 * y[1]], (0.0, t[-1]), [a, b], t_eval=t, rtol=1e-9).y
        runs.append({"t": t, **{n: row + 1e-3 * rng.standard_normal(len(t)) for n, row in zip("AB", y, strict=True)}})
    study = Study(
        data=Data(time="t"),
        coordinates={"A": Measured(), "B": Measured()},
        library=Candidates(form="reactions", reactions=("A <-> B",)),
    )
    result = identify(study, runs)
    assert {m.kind for m in result.model.mechanisms} == {"reaction"}
    assert_the_model_is_chosen(result)
