from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odescope.events import Monitor
from odescope.library.candidates import Library
from odescope.library.expression import Name
from odescope.library.parse import Scope
from odescope.library.tape import evaluate, write_tape
from odescope.pipeline import work
from odescope.pipeline.work import swept
from odescope.regression.factor import factorise
from odescope.regression.proposers import BackwardElimination, EnergyThreshold
from odescope.selection.sweep import Quotients, Sweep, nested_libraries, sweep

repeatable = settings(derandomize=True, deadline=None, max_examples=60)
WIDTH = 12
supports = st.lists(
    st.sets(st.integers(0, WIDTH - 1), min_size=1).map(lambda s: tuple(sorted(s))), min_size=1, max_size=12
)

NAMES = ("x", "v", "v_dot")
SCOPE = Scope.of(NAMES)


def terms_of(*texts):
    return Library.of(texts, SCOPE).products(["v_dot"])


# {1, x, v, sin(x)} to degree 3, alone and times the target
RICH = (Library.of(("x", "v", "sin(x)"), SCOPE).powers(3) * Library.of(("1", "v_dot"), SCOPE)).products(["v_dot"])
OWN = tuple(j for j, term in enumerate(RICH) if term.factor == "v_dot")


def of(found):
    return Sweep(tuple(found), ((0,),) * len(found), WIDTH)


# activation vectors, distances, clusters


@repeatable
@given(supports)
def test_distances_are_the_l1_distances_of_the_activation_vectors(found):
    sweep = of(found)
    vectors = [[int(j in support) for j in range(WIDTH)] for support in found]
    np.testing.assert_array_equal(sweep.activation(), vectors)
    expected = [[sum(abs(a - b) for a, b in zip(p, q, strict=True)) for q in vectors] for p in vectors]
    np.testing.assert_array_equal(sweep.distances(), expected)


@repeatable
@given(supports)
def test_identical_supports_fall_in_one_cluster(found):
    doubled = of([*found, *found])
    labels = doubled.clusters()
    np.testing.assert_array_equal(labels[: len(found)], labels[len(found) :])
    apart = of(sorted(set(found))).clusters(0.0)
    assert len(set(apart)) == len(set(found))  # and at no distance nothing else does


@repeatable
@given(supports, st.sampled_from([1.0, 2.0, 3.5]))
def test_clusters_are_farther_apart_on_average_than_the_cut(found, cut):
    sweep = of(found)
    distance, labels = sweep.distances(), sweep.clusters(cut)
    groups = [np.flatnonzero(labels == k) for k in sorted(set(labels.tolist()))]
    for k, a in enumerate(groups):
        for b in groups[:k]:
            assert distance[np.ix_(a, b)].mean() > cut
    near = np.argwhere(np.triu(distance <= cut, 1))
    if len(near):  # where there are neighbours at all, some pair of them is together
        assert any(labels[i] == labels[j] for i, j in near)


def test_two_laws_and_their_neighbours_are_two_clusters():
    first, second = (0, 1, 2, 3), (6, 7, 8, 9, 10)
    labels = of([first, second, (*first, 4), (*second, 11), (0, 1, 2), second[:-1]]).clusters()
    assert labels[0] == labels[2] == labels[4]
    assert labels[1] == labels[3] == labels[5]
    assert labels[0] != labels[1]


def test_a_chain_of_neighbours_is_not_one_cluster():
    chain = [tuple(range(2 * k)) for k in range(1, 7)]
    labels = of(chain).clusters(2.0)
    assert labels[0] == labels[1]
    assert labels[0] != labels[-1]


def test_restricting_keeps_supports_with_their_guesses():
    found = Sweep(((0, 1), (2, 3), (4, 5)), ((0,), (2, 3), (4,)), 6).restrict([2, 1])
    assert found == Sweep(((4, 5), (2, 3)), ((4,), (2, 3)), 6)


@pytest.mark.parametrize("count", [0, 1])
def test_one_support_or_none_needs_no_linkage(count):
    assert len(of([(0, 1)] * count).clusters()) == count


# relations less their common factor


def predicted(support, xi, columns, rows):
    """The target that a relation gives, by hand: -(terms without it) / (what multiplies it)."""
    values = evaluate(write_tape(NAMES, [p.expanded for p in RICH]), columns)
    target = columns[NAMES.index("v_dot")]
    top = sum(c * values[j] for j, c in zip(support, xi, strict=True) if j not in OWN)
    bottom = sum(c * values[j] / target for j, c in zip(support, xi, strict=True) if j in OWN)
    return -top / bottom


@repeatable
@given(st.sets(st.integers(0, len(RICH) - 1), min_size=2, max_size=5), st.integers(0, 2**32 - 1))
def test_dividing_out_leaves_no_common_factor_and_the_same_prediction(support, seed):
    support = tuple(sorted({*support, OWN[seed % len(OWN)]}))
    if all(j in OWN for j in support):
        support = (0, *support)
    quotients = Quotients(RICH).primitive(support)
    relation = tuple(sorted(quotients.values()))
    # A library of monomials holds every quotient: what is left is primitive.
    atoms = {atom for p in RICH for atom, _ in p.expanded.factors}
    common = [min(RICH[j].expanded.power_of(atom) for j in relation) for atom in atoms]
    assert max(common) == 0
    assert len(relation) == len(support)
    rng = np.random.default_rng(seed)
    columns, xi = rng.uniform(0.5, 2.0, (3, 20)), rng.uniform(0.5, 2.0, len(support))
    moved = {quotients[j]: c for j, c in zip(support, xi, strict=True)}
    np.testing.assert_allclose(
        predicted(relation, [moved[j] for j in relation], columns, 20), predicted(support, xi, columns, 20), rtol=1e-9
    )
    assert Quotients(RICH).primitive(relation) == {j: j for j in relation}


def test_a_quotient_that_the_library_lacks_leaves_the_relation_as_it_is():
    terms = terms_of("x*v", "x**2", "x*v_dot", "v", "v_dot")
    assert Quotients(terms).primitive((0, 1, 2)) == {0: 0, 1: 1, 2: 2}  # x**2/x = x is not there
    assert Quotients(terms).primitive((0, 2)) == {0: 3, 2: 4}


def test_a_common_function_is_divided_out():
    terms = terms_of("sin(x)", "v*sin(x)", "v_dot*sin(x)", "1", "v", "v_dot", "cos(x)")
    assert Quotients(terms).primitive((0, 1, 2)) == {0: 3, 1: 4, 2: 5}
    assert Quotients(terms).primitive((0, 1, 6)) == {0: 0, 1: 1, 6: 6}


# sweep


@dataclass
class Scripted:
    """A proposer that answers from a table and remembers what it was asked."""

    answers: dict
    asked: list = field(default_factory=list)

    def supports(self, factor, left, columns):
        self.asked.append((left, columns))
        yield from self.answers.get(left, ())


def test_every_column_is_a_guess_in_every_library_that_holds_it():
    factor = factorise([np.random.default_rng(0).standard_normal((30, 5))])
    first, second = Scripted({}), Scripted({})
    nested = ((0, 1, 2, 3, 4), (1, 3))
    assert sweep(factor, terms_of("1", "x", "v", "v_dot", "x*v"), nested, [first, second]).supports == ()
    for proposer in (first, second):
        assert sorted(proposer.asked) == sorted([(g, nested[0]) for g in range(5)] + [(1, nested[1]), (3, nested[1])])


def test_consensus_counts_distinct_guesses():
    factor = factorise([np.random.default_rng(0).standard_normal((30, 5))])
    terms = terms_of("1", "x", "v", "v_dot", "x*v")
    whole = ((0, 1, 2, 3, 4),)
    answers = {1: [(2, 3), (2, 3)], 2: [(1, 3)], 4: [(0,)]}
    found = sweep(factor, terms, whole, [Scripted(answers), Scripted(answers)])
    assert dict(zip(found.supports, found.guesses, strict=True)) == {(1, 2, 3): (1, 2), (0, 4): (4,)}


def test_a_multiple_of_a_relation_counts_for_the_relation():
    terms = terms_of("1", "x", "v", "v_dot", "x*v", "x*v_dot", "x**2")
    factor = factorise([np.random.default_rng(0).standard_normal((30, 7))])
    # x**2 + x*v + x*v_dot = 0, found from x*v, is x + v + v_dot = 0, found from v.
    found = sweep(factor, terms, (tuple(range(7)),), [Scripted({4: [(5, 6)], 3: [(1, 2)]})])
    assert found.supports == ((1, 2, 3),)
    assert sorted(found.guesses[0]) == [2, 3]


@pytest.fixture(scope="module")
def planted():
    """v_dot (1 + .4 x) = 2 - 3 x v + small noise, on a library of degree 3 with all multiples of that."""
    rng = np.random.default_rng(5)
    x, v = rng.uniform(-1, 1, (2, 4000))
    target = (2.0 - 3.0 * x * v) / (1 + 0.4 * x)
    columns = np.array([x, v, target + 1e-5 * rng.standard_normal(4000)])
    terms = (Library.of(("x", "v"), SCOPE).powers(3) * Library.of(("1", "v_dot"), SCOPE)).products(["v_dot"])
    return terms, factorise([evaluate(write_tape(NAMES, [p.expanded for p in terms]), columns).T])


@pytest.mark.parametrize("proposer", [EnergyThreshold(), BackwardElimination()], ids=lambda p: type(p).__name__)
def test_a_planted_relation_is_found_from_each_of_its_terms(planted, proposer):
    terms, factor = planted
    own = [j for j, p in enumerate(terms) if p.factor is not None]
    found = sweep(factor, terms, nested_libraries(terms, own), [proposer])
    truth = tuple(sorted(terms.index(p) for p in terms_of("1", "x*v", "v_dot", "x*v_dot")))
    guesses = dict(zip(found.supports, found.guesses, strict=True))
    assert sorted(guesses[truth]) == list(truth)
    assert len(set(found.supports)) == len(found.supports)
    for support, from_ in guesses.items():
        assert set(from_) <= set(support)
        assert support == tuple(sorted(set(support)))
        assert len(set(from_)) == len(from_)


def test_the_sweep_gives_the_same_every_time(planted):
    terms, factor = planted
    whole = (tuple(range(len(terms))),)
    first = sweep(factor, terms, whole, [EnergyThreshold()])
    assert all(sweep(factor, terms, whole, [EnergyThreshold()]) == first for _ in range(3))


# nested libraries


def test_nested_libraries_grow_by_degree_and_keep_the_target():
    explicit, *by_degree = nested_libraries(RICH, OWN)
    degree = [sum(power for atom, power in p.expanded.factors if atom != Name("v_dot")) for p in RICH]
    assert explicit == tuple(j for j, t in enumerate(RICH) if j not in OWN or t.text == "v_dot")
    assert by_degree == [tuple(j for j, d in enumerate(degree) if d <= k) for k in (1, 2, 3)]
    assert by_degree[-1] == tuple(range(len(RICH)))


def test_a_library_of_one_degree_is_searched_whole():
    terms = terms_of("x", "v", "sin(x)", "v_dot")
    assert nested_libraries(terms, (3,)) == ((0, 1, 2, 3),)


def test_of_a_wide_library_only_columns_that_hold_the_target_are_left_hand_sides(monkeypatch):
    sides = []

    class Told:
        def supports(self, factor, guess, columns):
            sides.append(guess)
            return []

    terms = terms_of("1", "x", "v", "v_dot", "x*v_dot")
    problem = SimpleNamespace(factor=SimpleNamespace(width=5), terms=terms, own=(3, 4))
    study = SimpleNamespace(regression=SimpleNamespace(proposers=[Told()], nested=False))
    asked = SimpleNamespace(study=study, monitor=Monitor())
    swept(asked, problem)
    assert sorted(sides) == [0, 1, 2, 3, 4]
    sides.clear()
    monkeypatch.setattr(work, "WIDE", 4)
    swept(asked, problem)
    assert sorted(sides) == [3, 4]
