"""The scale of a relation is a gauge: nothing that is said of a model depends on which coefficient is held."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from process_cases import cut, space
from small_systems import CART, SPRING, SPRING_PRESENT, SPRING_STEP, TIED_CART, drive, shots, spring_run

from odescope.library.mechanism import candidate
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.fit import fit
from odescope.likelihood.gauge import WEAK, held_of, inverse, rechosen, scale_groups
from odescope.likelihood.search import WhiteResiduals
from odescope.likelihood.search_space import SearchSpace

COUNT, STEP, SIGMA = 200, 0.05, 0.01


def spring():
    """Return the space of a spring, what is present, and the numbers of its scale groups."""
    data = shots(spring_run(), drive(), SPRING_STEP, 0.02, np.random.default_rng(0), np.array([0.01, 0.05]))
    return SearchSpace(Evaluator(data, 2), SPRING.mechanisms, SPRING.frame), SPRING.theta, SPRING_PRESENT


def cart(tied):
    """Return the same of a cart with a pendulum: two relations apart, or tied to one group."""
    rng, nodes = np.random.default_rng(1), drive(COUNT)
    states = CART.trajectory(CART.theta, [0.1, 2.5, -0.4, 1.0], nodes[:-1], STEP)
    measured = states[:, :2] + SIGMA * rng.standard_normal((COUNT, 2))
    gaps = np.array([0.01, 0.01, 0.05, 0.05])
    segments = cut(states, measured, nodes, [SIGMA] * 2, gaps, (COUNT,), 20, STEP)
    absent = [candidate(0, CART.product(-1, t), "x_ddot") for t in ("x", "phi_dot", "x_dot**2")]
    absent += [candidate(1, CART.product(f, t), "phi_ddot") for f, t in ((-1, "x_dot"), (-1, "u"), (1, "cos(phi)"))]
    system = TIED_CART if tied else CART
    it = replace(space(CART, segments), mechanisms=(*system.mechanisms, *absent))
    present = np.arange(len(system.theta))
    return it, np.append(system.theta, np.zeros(len(absent))), present


CASES = {"one relation": spring, "two": lambda: cart(False), "two that are tied": lambda: cart(True)}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    return CASES[request.param]()


def gauges(it, present):
    """Return every choice of one held mechanism a scale group."""
    return [np.sort(pick) for pick in product(*scale_groups(it.mechanisms, present))]


def in_gauge(it, present, held, start, x0, defect_std):
    """Return the fit with these held, carried on until it stands still, of all mechanisms."""
    found = None
    for _ in range(3):
        begin = start[present] if found is None else found.theta
        found = fit(it.evaluator, it.program(present), begin, held_at(present, held), x0, defect_std)
        assert found is not None
        x0 = found.x0
    theta = np.zeros(len(start))
    theta[present] = found.theta
    return replace(found, theta=theta, present=present, held=held)


def held_at(present, held):
    return np.searchsorted(present, held)


@pytest.mark.parametrize("width", [np.inf, 0.01], ids=["loose", "tight"])
def test_cost_and_scores_are_the_same_whichever_coefficient_is_held(case, width):
    it, theta, present = case
    defect_std = it.segments.spread * width
    begin = it.begin(theta, defect_std)
    fits = [in_gauge(it, present, held, begin.theta, begin.x0, defect_std) for held in gauges(it, present)]
    assert len(fits) >= 5
    judge = WhiteResiduals(it, defect_std)
    first, absent = judge.scores(fits[0]), np.setdiff1d(np.arange(len(theta)), present)
    assert np.all(first[absent] > 0.0)
    for found in fits:
        scores = judge.scores(found)
        assert found.cost == pytest.approx(fits[0].cost, rel=1e-6)
        assert not scores[present].any()
        np.testing.assert_allclose(scores[absent], first[absent], rtol=1e-6, atol=1e-6)
        # The price is that of the structure.
        assert it.price(found) == it.price(fits[0])


def test_scores_away_from_the_minimum_are_the_same_too(case):
    it, theta, present = case
    begin, defect_std = it.begin(theta, it.segments.spread), it.segments.spread
    away = replace(begin, theta=begin.theta * (1.0 + 0.01 * np.cos(np.arange(len(theta)))))
    every = [WhiteResiduals(it, defect_std).scores(replace(away, held=held)) for held in gauges(it, present)]
    for scores in every[1:]:
        np.testing.assert_allclose(scores, every[0], rtol=1e-6, atol=1e-6)


def information(it, found, held, defect_std):
    """Return the information about what is not held, straight from the kernel."""
    free = np.setdiff1d(np.arange(len(found.present)), held_at(found.present, held))
    program, theta = it.program(found.present), found.theta[found.present]
    return it.evaluator.expand(program, theta, free, found.x0, defect_std).information


def weak_first(it, theta, present, share):
    """Return a fit with so little of an absent term that it is weak, which is held, and its number.

    The term is at its estimate times `share`, in units of standard errors: Wald statistics are then about share^2.
    """
    k = int(np.setdiff1d(np.arange(len(theta)), present)[0])
    many, defect_std = np.append(present, k), 0.1 * it.segments.spread
    found = it.fit(theta, np.sort(many), it.segments.initial, defect_std)
    error = np.sqrt(found.variances[np.searchsorted(found.free, k)])
    moved = found.theta.copy()
    moved[k] = share * error
    return replace(found, theta=moved), k, defect_std


def test_a_weak_coefficient_is_given_up_for_one_that_a_fit_then_knows_well(case):
    found, weak, defect_std = weak_first(*case, 0.5)
    it = case[0]
    group = next(g for g in scale_groups(it.mechanisms, found.present) if weak in g)
    held = np.sort(np.append(np.setdiff1d(found.held, group), weak))
    here = information(it, found, held, defect_std)
    # What all others look like beside it: no better known than it is.
    free = np.setdiff1d(found.present, held)
    of_group = np.isin(free, group)
    assert (found.theta[free] ** 2 / np.diag(inverse(here)))[of_group].max() < 1.0
    others = rechosen(it.mechanisms, found.present, held, found.theta, here, it._size(found.theta))
    assert weak not in others
    assert np.array_equal(np.setdiff1d(held, group), np.setdiff1d(others, group))
    (best,) = np.intersect1d(others, group)
    assert it._size(found.theta)[best] == it._size(found.theta)[[k for k in group if k != weak]].max()
    there = information(it, found, others, defect_std)
    strong = np.setdiff1d(found.present, others)
    wald = found.theta[strong] ** 2 / np.diag(inverse(there))
    assert wald[np.isin(strong, group) & (strong != weak)].max() > 1000.0
    # A second choice changes nothing.
    again = rechosen(it.mechanisms, found.present, others, found.theta, there, it._size(found.theta))
    assert np.array_equal(again, others)


def sampled_medians(theta, covariance, group):
    """Return the median Wald statistic of the others of a group beside each, from ratios of coefficients as drawn."""
    shrunk = 1e-6  # so that ratios go linearly
    drawn = np.random.default_rng(0).multivariate_normal(theta, shrunk * covariance, 20_000, method="eigh")[:, group]
    medians = []
    for k in range(len(group)):
        ratios = np.delete(drawn / drawn[:, [k]], k, axis=1)
        medians.append(float(np.median(ratios.mean(axis=0) ** 2 / ratios.var(axis=0))) * shrunk)
    return np.array(medians)


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "with a look-alike"])
def test_where_one_is_held_that_is_hardly_known_it_is_one_beside_which_the_others_are_known_best(case, beside):
    """Two that look alike may be well known beside each other, and neither beside the rest."""
    it, theta, _ = case
    defect_std = it.segments.spread
    found = it.begin(theta, defect_std)
    groups = [g for g in scale_groups(it.mechanisms, found.present) if len(g) > 4]  # of four it is two against two
    assert groups
    for group in groups:
        for own in group:
            held = np.sort(np.append(np.setdiff1d(found.held, group), own))
            free = np.setdiff1d(found.present, held)
            apart = np.isin(free, group) & (free != next(k for k in group if k != own) if beside else True)
            together = 0.3 * np.where(apart, found.theta[free], 0.0)  # what is held is known to three tenths
            covariance = inverse(information(it, found, held, defect_std)) + np.outer(together, together)
            size = it._size(found.theta)
            chosen = rechosen(it.mechanisms, found.present, held, found.theta, np.linalg.inv(covariance), size)
            (now,) = np.intersect1d(chosen, group)
            whole = np.zeros((len(theta), len(theta)))
            whole[np.ix_(free, free)] = covariance
            medians = dict(zip(group, sampled_medians(found.theta, whole, list(group)), strict=True))
            assert now != own
            assert medians[own] < WEAK
            assert medians[now] > 0.9 * max(medians.values())
            if beside:  # and that one was well known beside it
                partner = next(k for k in group if k != own)
                assert found.theta[partner] ** 2 / whole[partner, partner] > WEAK
            # What is well known, or as well as with any other, stays.
            stays = np.linalg.inv(covariance / 1e4)
            assert np.array_equal(rechosen(it.mechanisms, found.present, held, found.theta, stays, size), held)


@pytest.mark.parametrize("strength", [1.0, 3.0])
def test_a_fit_that_is_told_to_hold_a_weak_coefficient_ends_as_one_that_holds_a_strong_one(case, strength):
    """The refit begins from the same relations: what is held instead is 1, and nothing has run off."""
    found, weak, defect_std = weak_first(*case, strength)
    it = case[0]
    told = np.where(np.arange(len(found.theta)) == weak, np.inf, found.strength)
    end = it.fit(found.theta, found.present, found.x0, defect_std, told)
    good = it.fit(found.theta, found.present, found.x0, defect_std, found.strength)
    assert weak not in end.held
    assert end.cost == pytest.approx(good.cost, abs=1e-2)
    np.testing.assert_allclose(end.theta[np.setdiff1d(end.held, good.held)], 1.0, rtol=1e-12)
    assert np.abs(end.theta).max() < 1e6
    for group in scale_groups(it.mechanisms, end.present):
        (held,) = np.intersect1d(group, good.held)
        scaled = end.theta[list(group)] / end.theta[held] * good.theta[held]
        errors = np.zeros(len(good.theta))
        errors[good.free] = np.sqrt(good.variances)
        assert np.all(np.abs(scaled - good.theta[list(group)]) <= 0.1 * errors[list(group)] + 1e-12)


@pytest.mark.parametrize("share", [1e-2, 1e-3, 1e-4, 1e-6, 1e-8])
def test_what_is_next_to_nothing_is_not_held_however_little_it_is(case, share):
    """Beside it all information drowns in rounding: that of another gauge is none the less that of an expansion."""
    it, theta, present = case
    defect_std = 0.1 * it.segments.spread
    begin = it.begin(theta, defect_std)
    weak = int(np.setdiff1d(np.arange(len(theta)), present)[0])
    little, many = begin.theta.copy(), np.sort(np.append(present, weak))
    little[weak] = share
    strength = np.where(np.arange(len(theta)) == weak, np.inf, begin.strength)
    found = it.fit(little, many, begin.x0, defect_std, strength, iterations=0)
    assert weak not in found.held
    expected = information(it, found, found.held, defect_std)
    np.testing.assert_allclose(found.wald, found.theta[found.free] ** 2 / np.diag(inverse(expected)), rtol=1e-2)


def test_a_coefficient_that_is_known_stays_held_however_weak(case):
    found, weak, defect_std = weak_first(*case, 0.5)
    it = case[0]
    mechanisms = tuple(
        replace(m, known=float(found.theta[weak])) if k == weak else m for k, m in enumerate(it.mechanisms)
    )
    group = next(g for g in scale_groups(mechanisms, found.present) if weak in g)
    held = held_of(mechanisms, found.present, found.strength)
    assert np.intersect1d(held, group).tolist() == [weak]
    here = information(it, found, held, defect_std)
    size = it._size(found.theta)
    assert np.array_equal(rechosen(mechanisms, found.present, held, found.theta, here, size), held)


def test_groups_are_the_connected_components_of_mechanisms_and_relations():
    rng = np.random.default_rng(2)
    for _ in range(50):
        relations = int(rng.integers(1, 6))
        owned = [rng.choice(relations, int(rng.integers(1, min(3, relations) + 1)), replace=False) for _ in range(7)]
        parts = [tuple(replace(TIED_CART.mechanisms[0].parts[0], relation=int(r)) for r in own) for own in owned]
        mechanisms = [replace(TIED_CART.mechanisms[0], parts=p) for p in parts]
        present = np.flatnonzero(rng.random(7) < 0.7)
        near = np.array([[bool(set(a) & set(b)) for b in owned] for a in owned])[np.ix_(present, present)]
        reach = np.linalg.matrix_power(near.astype(int) + np.eye(len(present), dtype=int), 7) > 0
        expected = {tuple(present[row].tolist()) for row in reach}
        groups = scale_groups(mechanisms, present)
        assert set(groups) == expected
        assert len(groups) == len(expected)


def test_the_inverse_is_that_of_the_matrix_and_never_negative_where_there_is_none():
    rng = np.random.default_rng(3)
    root = rng.standard_normal((9, 4)) * 10.0 ** np.array([-6, 0, 3, 8])
    scale = np.sqrt(np.diag(root.T @ root))
    np.testing.assert_allclose(
        inverse(root.T @ root) * scale * scale[:, None],
        np.linalg.inv(root.T @ root / scale / scale[:, None]),
        rtol=1e-8,
    )
    twins = np.column_stack([root, root[:, 0]])
    variances = np.diag(inverse(twins.T @ twins))
    assert np.all(variances > 0.0)
    assert variances[0] > 1e6 * variances[1] * (scale[1] / scale[0]) ** 2
    nothing = np.diag(inverse(np.zeros((2, 2))))
    assert np.all(nothing > 1e100)
