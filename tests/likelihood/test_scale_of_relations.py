"""Searches on relations whose target is not bare, or that hold a function over and above the law."""

from dataclasses import replace

import numpy as np
import pytest
from process_cases import cut, space
from small_systems import SPRING, SPRING_STEP, System, drive, in_bare_gauge, shots, spring_run

from odescope.events import Monitor
from odescope.library.expression import Name, Term
from odescope.library.mechanism import Mechanism
from odescope.likelihood.add_and_drop import Moves
from odescope.likelihood.division import divided, divided_in_part
from odescope.likelihood.search import WhiteResiduals, search
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import searches
from odescope.likelihood.smoothed_targets import explicit, singular
from odescope.parallel.workers import Threads
from odescope.recordings.coordinate import Coordinate

# x x_dot = u - 0.8, and terms that it lacks, the bare target first.
FILL, DRAIN, STEP, COUNT, SIGMA = 1.0, 0.8, 0.05, 600, 0.01
TANK = System(
    (Coordinate("x", 1),),
    ("u",),
    (
        (0, 0, "1", 0.0),
        (0, 0, "x", 1.0),
        (0, -1, "u", -FILL),
        (0, -1, "1", DRAIN),
        (0, -1, "x", 0.0),
        (0, -1, "x**2", 0.0),
        (0, -1, "x*u", 0.0),
        (0, 0, "x**2", 0.0),
        (0, -1, "u**2", 0.0),
    ),
    (0,),
    None,
)
LAW = [1, 2, 3]
STARTS = {
    "a little of the bare target": {0: 0.05, 1: 1.0, 2: -FILL, 3: DRAIN},
    "little of all but the bare target": {0: 1.0, 1: 0.05, 2: -FILL, 3: DRAIN},
    "the bare target instead": {0: 1.0, 2: -0.4, 3: 0.3},
    "of the other sign, and a term invented": {0: -0.3, 1: 1.0, 2: -FILL, 3: DRAIN, 5: 0.02},
}


def tank(seed):
    """Return the space of a tank, whose level is exact: x^2 / 2 is the integral of what flows."""
    u = drive(COUNT, STEP) / 1.5 + DRAIN / FILL
    flow = FILL * STEP * (u[:, 0, 0] + 4 * u[:, 1, 0] + u[:, 2, 0]) / 6 - DRAIN * STEP
    x = np.sqrt(9.0 + 2.0 * np.concatenate([[0.0], np.cumsum(flow)[:-1]]))[:, None]
    measured = x + SIGMA * np.random.default_rng(seed).standard_normal(x.shape)
    return space(TANK, cut(x, measured, u, [SIGMA], [0.01], (COUNT,), 25, STEP))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", STARTS)
def test_a_bare_target_that_the_law_lacks_is_given_up(name, seed):
    it, theta = tank(seed), np.zeros(len(TANK.terms))
    for k, value in STARTS[name].items():
        theta[k] = value
    found = search(it, theta)
    assert found.fit.present.tolist() == LAW
    assert found.scale == pytest.approx(1.0, abs=0.2)
    assert found.width == 1e-3
    (relation,) = it.relations_of(found.fit, found.fit.covariance)
    terms = {t.text: t for t in relation.terms}
    assert relation.terms[0].text == "x_dot*x"
    assert terms["x_dot*x"].std_error is None
    for text, truth in (("u", -FILL), ("1", DRAIN)):
        assert abs(terms[text].coefficient - truth) < 4.0 * terms[text].std_error
        assert terms[text].std_error < 0.01


def test_the_end_is_the_same_fit_from_every_start():
    it, ends = tank(5), []
    for start in STARTS.values():
        theta = np.zeros(len(TANK.terms))
        for k, value in start.items():
            theta[k] = value
        ends.append(search(it, theta).fit)
    relations = [it.relations_of(f, f.covariance)[0] for f in ends]
    for fit, relation in zip(ends[1:], relations[1:], strict=True):
        assert fit.cost == pytest.approx(ends[0].cost, abs=1e-3)
        assert [t.text for t in relation.terms] == [t.text for t in relations[0].terms]
        for one, other in zip(relation.terms[1:], relations[0].terms[1:], strict=True):
            assert one.coefficient == pytest.approx(other.coefficient, abs=0.03 * other.std_error)
            assert one.std_error == pytest.approx(other.std_error, rel=1e-3)


@pytest.mark.parametrize("share", [1e-2, 1e-4, 1e-6, 1e-8])
def test_what_is_said_beside_a_target_that_is_next_to_nothing_is_not_rounding(share):
    """A search that runs off leaves a coefficient that is held at so little of the others."""
    it, present = tank(0), np.arange(4)
    defect_std = 0.01 * it.segments.spread
    good = it.fit(TANK.theta, present, it.segments.initial, defect_std)
    theta = good.theta.copy()
    theta[0] = share
    bare = np.where(np.arange(len(theta)) == 0, np.inf, 0.0)
    found = it.fit(theta, present, good.x0, defect_std, bare, iterations=0)
    assert 0 not in found.held
    program, free = it.program(present), found.free
    information = it.evaluator.expand(program, found.theta[present], free, found.x0, defect_std).information
    np.testing.assert_allclose(found.wald, found.theta[free] ** 2 / np.diag(np.linalg.inv(information)), rtol=0.05)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("begun", [0.3, -0.3])
def test_a_fit_that_begins_with_a_weak_coefficient_held_is_the_fit_all_the_same(begun, seed):
    """Of either sign: where the best is on the other side of nothing, all others would have to pass infinity."""
    it, present = tank(seed), np.arange(4)
    defect_std = 0.01 * it.segments.spread
    good = it.fit(TANK.theta, present, it.segments.initial, defect_std)
    theta = TANK.theta.copy()
    theta[0] = begun
    bare = np.where(np.arange(len(theta)) == 0, np.inf, 0.0)
    found = it.fit(theta, present, it.segments.initial, defect_std, bare)
    assert 0 not in found.held
    assert found.cost == pytest.approx(good.cost, abs=0.1)


SPRING_LAW = [(f, text, c) for _, f, text, c in SPRING.terms if c]
SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
FACTORS = ["x_dot", "x", "cos(x)", "exp(x)"]


def multiplied(by, extra=()):
    """Return the spring's law, the law times a function, and more candidates."""
    longer = [(f, by if text == "1" else f"{by}*{text}", c) for f, text, c in SPRING_LAW]
    terms = [(0, *t) for t in (*SPRING_LAW, *longer, *extra)]
    return System(SPRING.coordinates, SPRING.inputs, tuple(terms), (0,), None)


def spring(system, seed):
    """Return the space of a system on the spring's record, the states smoothed: no velocity is exactly zero."""
    rng, states = np.random.default_rng(seed), spring_run()
    spread = np.array([0.01, 0.05])
    data = shots(states, drive(), SPRING_STEP, 0.02, rng, spread)
    return space(system, replace(data, filtered=states + spread * rng.standard_normal(states.shape)))


LONGER, ITS_LAW = np.arange(5, 10), np.arange(5)


def start_from(system, drop=None):
    theta = system.theta.copy()
    theta[ITS_LAW] = 0.0
    theta[list(drop or ())] = 0.0
    return theta


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    "lacks", [pytest.param(None, id="whole"), pytest.param([7], id="without friction", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("by", FACTORS)
def test_a_function_times_the_law_ends_as_the_law(by, lacks, seed):
    system = multiplied(by, ((-1, "x**2", 0.0), (-1, "1", 0.0)))
    it = spring(system, seed)
    found = search(it, start_from(system, lacks))
    assert found.fit.present.tolist() == ITS_LAW.tolist()
    bare = in_bare_gauge(it, found.fit)
    terms = ITS_LAW[1:]
    assert np.abs((bare.theta - system.theta)[terms] / bare.errors[terms]).max() < 4.0


@pytest.mark.parametrize("by", ["x", *(pytest.param(by, marks=pytest.mark.slow) for by in ("cos(x)", "exp(x)"))])
def test_the_law_is_as_good_as_a_function_times_it_and_cheaper(by):
    system = multiplied(by)
    it = spring(system, 0)
    defect_std = 0.01 * it.segments.spread
    longer = it.begin(start_from(system), defect_std)
    law = it.fit(system.theta, ITS_LAW, longer.x0, defect_std)
    assert law.cost == pytest.approx(longer.cost, abs=0.01)
    # A factor more in each of five terms.
    assert it.price(longer) - it.price(law) == pytest.approx(5 * 2.0 * np.log(2.0))
    moves = Moves(it, WhiteResiduals(it, defect_std), 0.01, 1.0, [])
    shorter = moves.divide(longer)
    assert shorter.present.tolist() == ITS_LAW.tolist()
    assert shorter.cost == pytest.approx(law.cost, abs=0.01)
    assert moves.divide(law) is None


def at(it, theta):
    """Return a fit that stands at these coefficients."""
    begin = it.begin(theta, it.segments.spread)
    return replace(begin, theta=theta, present=np.flatnonzero(theta))


def test_division_takes_the_coefficients_along_and_the_other_relations_stay():
    system = multiplied("x")
    it = spring(system, 0)
    theta = 2.0 * start_from(system)
    np.testing.assert_allclose(divided(it, at(it, theta))[ITS_LAW], theta[LONGER])
    assert not divided(it, at(it, theta))[LONGER].any()
    bare = system.theta.copy()
    bare[LONGER] = 0.0
    assert divided(it, at(it, bare)) is None  # the bare target is not divisible


def test_what_makes_a_relation_simpler_need_not_be_in_all_its_terms():
    """As in the law of a gas bubble, which holds 1/x: of x times that one term is without x."""
    system = multiplied("exp(x)", ((-1, "exp(x)**-1", 0.0), (-1, "1", 0.0)))
    it = spring(system, 0)
    theta = start_from(system)
    theta[11] = 0.3
    shorter = divided(it, at(it, theta))
    assert np.flatnonzero(shorter).tolist() == [*ITS_LAW, 10]
    np.testing.assert_allclose(shorter[[*ITS_LAW, 10]], theta[[*LONGER, 11]])
    assert divided(it, at(it, shorter)) is None


def spring_times(power):
    """Return the spring's law with the candidates of its product with x**power, and what that product gives each."""
    law = {SPRING.product(f, text): c for f, text, c in SPRING_LAW}
    gained = {replace(p, term=p.term * Term(((Name("x"), power),))): c for p, c in law.items()}
    products = list(dict.fromkeys([*law, *gained]))
    terms = tuple((0, 0 if p.factor else -1, p.term.text, law.get(p, 0.0)) for p in products)
    system = System(SPRING.coordinates, SPRING.inputs, terms, (0,), None)
    return system, np.array([gained.get(p, 0.0) for p in products])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("by", "share"), [(1, -0.9), (1, 0.3), (2, -0.4), (2, 0.2)])
def test_a_sum_times_the_law_ends_as_the_law(by, share, seed):
    """Where the sum passes zero within the data, every term that is too many looks certain."""
    system, gained = spring_times(by)
    it = spring(system, seed)
    found = search(it, system.theta + share * gained)
    assert found.fit.present.tolist() == ITS_LAW.tolist()
    bare = in_bare_gauge(it, found.fit)
    terms = ITS_LAW[1:]
    assert np.abs((bare.theta - system.theta)[terms] / bare.errors[terms]).max() < 4.0


@pytest.mark.parametrize("by", [1, 2])
def test_of_a_sum_times_the_law_the_law_is_left_and_of_what_is_none_all(by):
    system, gained = spring_times(by)
    it = spring(system, 0)
    theta = system.theta + 0.3 * gained
    found = at(it, theta)
    np.testing.assert_allclose(divided(it, found), system.theta, atol=1e-12)
    for k in np.flatnonzero(gained)[1:]:  # friction alone over 1 + .3 x, for one, is another law
        for share in (0.0, 3.0):
            other = theta.copy()
            other[k] *= share
            assert divided(it, replace(found, theta=other, present=np.flatnonzero(other))) is None


def test_nothing_is_divided_where_the_library_lacks_what_is_left():
    system = multiplied("x")
    it = spring(system, 0)
    found = at(it, start_from(system))
    for k in ITS_LAW:
        shorter = replace(it, mechanisms=tuple(m for j, m in enumerate(it.mechanisms) if j != k))
        moved = replace(found, theta=np.delete(found.theta, k), present=found.present - 1)
        assert divided(shorter, moved) is None


def test_what_is_tied_or_known_is_not_divided():
    system = multiplied("x")
    it = spring(system, 0)
    found = at(it, start_from(system))
    assert divided(it, found) is not None

    def with_one(mechanism) -> SearchSpace:
        return replace(it, mechanisms=tuple(mechanism if j == LONGER[1] else m for j, m in enumerate(it.mechanisms)))

    plain = it.mechanisms[LONGER[1]]
    assert divided(with_one(replace(plain, known=4.0)), found) is None
    two = Mechanism("tie", "both", "x_ddot", (*plain.parts, *it.mechanisms[LONGER[2]].parts), 1.0)
    assert divided(with_one(two), found) is None


def test_the_price_leaves_out_one_mechanism_a_group_and_what_is_known():
    it = tank(0)
    found = at(it, TANK.theta)
    bare = it.penalty[0]
    assert it.price(found) == pytest.approx(it.penalty[LAW].sum() - bare)
    known = tuple(replace(m, known=1.0) if k == 1 else m for k, m in enumerate(it.mechanisms))
    given = replace(it, mechanisms=known)
    assert given.penalty[1] == 0.0
    fixed = at(given, TANK.theta)
    assert fixed.held.tolist() == [1]
    # Its scale is given, so every other coefficient is a parameter.
    assert given.price(fixed) == pytest.approx(given.penalty[[2, 3]].sum())
    assert 1 not in given.free(fixed)


@pytest.mark.slow
@pytest.mark.parametrize(("by", "ends"), [("x_dot", 3), ("x", 3), ("exp(x)", 2)])
def test_a_law_times_what_passes_zero_is_not_the_last_that_is_searched_from(by, ends):
    """The library lacks one of the terms that a division would leave; the last search begins with the others."""
    system = multiplied(by)
    it, kept = spring(system, 0), np.delete(np.arange(len(system.theta)), 2)
    it = replace(it, mechanisms=tuple(it.mechanisms[k] for k in kept))
    starts = [start_from(system)[kept], np.where(np.isin(kept, ITS_LAW), system.theta[kept], 0.0)]
    outcomes = searches(it, starts, None, Monitor(), Threads())
    assert outcomes[0].clear
    assert len(outcomes) == ends
    assert singular(it, outcomes[0].fit) == (ends == 3)


@pytest.mark.parametrize("by", FACTORS)
def test_a_law_times_a_function_has_the_targets_of_the_law(by):
    system = multiplied(by)
    it = spring(system, 0)
    u = it.segments.inputs[:, 0, 0]
    x, v = it.segments.filtered.T
    law = u - 4.0 * x - 0.5 * v - 0.8 * x**3
    np.testing.assert_allclose(explicit(it, at(it, system.theta * np.isin(np.arange(10), ITS_LAW)))[0], law)
    np.testing.assert_allclose(explicit(it, at(it, start_from(system)))[0], law, rtol=1e-6)


def test_of_a_law_times_something_that_the_library_holds_in_part_the_rest_is_left_out():
    """x times the law without its friction, which a cosine stands for."""
    system = multiplied("x", ((-1, "cos(x)", 0.0),))
    it = spring(system, 0)
    theta = start_from(system, [LONGER[2]])
    theta[10] = 0.4
    found = at(it, theta)
    assert divided(it, found) is None
    left = divided_in_part(it, theta)
    assert np.flatnonzero(left).tolist() == [k for k in ITS_LAW if k != ITS_LAW[2]]
    np.testing.assert_allclose(left[ITS_LAW], np.where(ITS_LAW[2] == ITS_LAW, 0.0, theta[LONGER]))
    assert divided_in_part(it, system.theta) is None


def test_of_several_divisors_that_which_leaves_most_is_taken():
    system = multiplied("x", ((0, "cos(x)", 0.0), (-1, "cos(x)", 0.0)))
    theta = start_from(system)
    theta[[10, 11]] = 0.1, 0.3
    left = divided_in_part(spring(system, 0), theta)
    assert np.flatnonzero(left).tolist() == ITS_LAW.tolist()
    np.testing.assert_allclose(left[ITS_LAW], theta[LONGER])
    theta[ITS_LAW[0]] = 0.5
    assert divided_in_part(spring(system, 0), theta) is None  # the bare target is there


def test_a_target_is_not_left_alone_by_a_division():
    it = tank(0)
    assert divided_in_part(it, TANK.theta) is None


# T' = q (350 - T) - 0.8 (T - 290), of which the library holds T times the law but for T^2 q.
HEATED = System(
    (Coordinate("T", 1),),
    ("q",),
    (
        (0, 0, "1", 1.0),
        (0, -1, "q", -350.0),
        (0, -1, "T", 0.8),
        (0, -1, "T*q", 1.0),
        (0, -1, "1", -0.8 * 290.0),
        (0, 0, "T", 0.0),
        (0, -1, "T**2", 0.0),
        (0, 0, "q", 0.0),
        (0, -1, "q**2", 0.0),
    ),
    (0,),
    lambda theta, x, u: [-(theta[1] * u[0] + (theta[2] + theta[3] * u[0]) * x[0] + theta[4])],
)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_searches_end_as_the_law_where_one_ends_as_a_part_of_the_law_times_its_state(seed):
    """Of kelvins that hardly move beside their size T times the law is nearly in the library."""
    nodes, sigma = 0.6 + drive(COUNT, STEP) / 15.0, 0.1
    states = HEATED.trajectory(HEATED.theta, [310.0], nodes[:-1], STEP)
    measured = states + sigma * np.random.default_rng(seed).standard_normal(states.shape)
    it = space(HEATED, cut(states, measured, nodes, [sigma], [0.05], (COUNT,), 25, STEP))
    middle, theta = states.mean(), np.zeros(len(HEATED.theta))
    # T (350 - T) = m^2 + (350 - 2 m) T - (T - m)^2, the last of which is lacking.
    theta[[5, 1, 3, 4, 2, 6]] = 1.0, -(middle**2), -(350.0 - 2.0 * middle), 0.0, -0.8 * 290.0, 0.8
    outcomes = searches(it, [theta], None, Monitor(), Threads())
    best = min(outcomes, key=lambda o: o.rank)
    assert best.fit.present.tolist() == [0, 1, 2, 3, 4]
