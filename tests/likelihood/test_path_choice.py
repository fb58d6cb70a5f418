"""Where on the path of models to stop, given the errors of free runs."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from process_cases import LINEAR, Q, fitted, kicked, spring
from small_systems import SPRING, drive

from odescope.likelihood.held_out import free_run_errors, held_out, stretches
from odescope.likelihood.negligible import contributions
from odescope.likelihood.path import FAITHFUL, SURE, VERY, ModelPath, PathStep, knee

COMMON = np.array([0.02, 0.08, 0.04, 0.06])  # what is hard in each stretch, whatever the model
CHANCE = np.array([-0.009, 0.012, -0.008, 0.010])


def steps(*errors):
    """Return models with these errors in each of some stretches, one term fewer each."""
    return [PathStep(None, np.array(e), None, 0.0, len(errors) - k) for k, e in enumerate(errors)]


def chosen(unseen, anywhere=None, faithful=FAITHFUL):
    """Return the number of the model that is chosen; over the whole record errors are the same by default."""
    models = steps(*unseen)
    whole = dict(zip(map(id, models), unseen if anywhere is None else anywhere, strict=True))
    return knee(models, [s.errors for s in models], lambda step: np.array(whole[id(step)]), faithful)


@pytest.mark.parametrize(
    ("longer", "shorter", "number"),
    [
        (0.0030, 0.0045, 1),  # both near the record, and nearly as near
        (4e-5, 0.0045, 0),  # both near the record, but a hundred times further without the term
        (0.0045, 0.0080, 1),
        (0.0045, 0.0120, 0),  # the shorter one is further off than a percent
    ],
)
def test_a_term_that_brings_runs_much_nearer_stays_however_near_they_are_without(longer, shorter, number):
    assert chosen([[longer] * 3, [shorter] * 3]) == number


def test_where_a_misfit_is_white_runs_have_to_be_nearer_to_do_without_a_term():
    assert chosen([[0.0045] * 3, [0.0080] * 3], faithful=VERY) == 0
    assert chosen([[0.0045] * 3, [0.0049] * 3], faithful=VERY) == 1


def test_the_spread_of_stretches_counts_up_to_half_a_percent_alone():
    assert chosen([[0.002] * 3, [0.004, 0.006, 0.0035]]) == 1
    assert chosen([[0.006] * 3, [0.006, 0.017, 0.009]]) == 0


def test_what_all_models_find_hard_in_a_stretch_hides_no_difference():
    worse = COMMON + np.array([0.012, 0.009, 0.011, 0.010])
    assert worse.mean() - COMMON.mean() < 0.5 * COMMON.std(ddof=1)
    assert chosen([COMMON, worse]) == 0


def test_a_difference_that_is_chance_keeps_no_term():
    differs = COMMON + CHANCE
    assert np.mean(differs**2) > np.mean(COMMON**2)
    assert chosen([COMMON, differs]) == 1


def test_few_stretches_that_leave_it_open_are_decided_by_the_whole_record():
    whole = np.full(5, 0.04)
    worse = whole + np.array([0.01, 0.02, 0.015, 0.01, 0.012])
    assert chosen([COMMON, COMMON + CHANCE], [whole, worse]) == 0
    assert chosen([COMMON, COMMON + CHANCE], [worse, whole]) == 1


def test_what_runs_worse_over_what_is_held_out_has_no_say_however_well_it_describes_what_was_fitted():
    overfitted, physics, poor = COMMON + 0.03, COMMON, COMMON + 0.1
    seen = np.full(5, 0.01)
    assert chosen([overfitted, physics, poor], [seen, seen + 0.02, seen + 0.1]) == 1


@pytest.mark.parametrize("seed", range(3))
def test_where_a_random_force_leaves_long_runs_telling_nothing_shorter_ones_tell(seed):
    it = spring(seed, 1500, q=10.0 * Q)
    true, softer = fitted(it), LINEAR * np.where(np.arange(len(LINEAR)) == 1, 0.8, 1.0)
    models = [
        PathStep(replace(true, theta=theta), np.sqrt(free_run_errors(it, theta)), None, 0.0, terms)
        for theta, terms in ((LINEAR, 4), (softer, 3))
    ]
    assert models[0].error > 0.2
    assert knee(models, [s.errors for s in models], lambda step: step.errors) == 1
    assert ModelPath(it, tuple(models), 0).at_knee().chosen == 0


@pytest.mark.parametrize("lengths", [(103,), (100, 27), (30, 20, 25, 40, 35, 10, 12, 15, 18, 21)])
def test_stretches_hold_what_is_held_out_and_cover_the_record(lengths):
    segments = spring(0, sum(lengths)).segments
    edges = np.append(0, np.cumsum(lengths)).tolist()
    segments = replace(segments, runs=tuple(pairwise(edges)))
    found = stretches(segments)
    rows = np.concatenate([np.arange(low, high) for low, high in found])
    assert len(set(rows)) == len(rows) > sum(lengths) - 5 * len(lengths)
    assert held_out(segments) == found[4::5]


def test_pieces_are_runs_by_hand_one_after_the_other():
    count = 600
    it = spring(0, count, q=np.zeros(2), believed=Q)
    states, measured, nodes, errors = it.segments.filtered, it.segments.measured[:, 0], drive(count), []
    wrong = LINEAR * np.where(np.arange(len(LINEAR)) == 1, 1.1, 1.0)
    for begin, end in ((500, 540), (540, 600)):
        run = kicked(SPRING, wrong, nodes[begin:end], np.zeros((end - begin, 2)), states[begin])[:, 0]
        e = np.mean((run - measured[begin:end]) ** 2) / measured.var()
        errors.append(e / (1 + e))
    np.testing.assert_allclose(free_run_errors(it, wrong, [(480, 600)], 2), errors, rtol=1e-4)


def with_share(it, share, *terms):
    """Return a fit of the linear terms in which these make a share of the largest."""
    theta = LINEAR.copy()
    for k in terms:
        theta[k] = 1e-6
        theta[k] = 1e-6 * share / contributions(it, theta)[k]
    return replace(fitted(it), theta=theta)


@pytest.mark.parametrize(
    ("statistics", "left"),
    [((0.7, 0.95, 1.2, 0.3), 2), ((1.1, 0.3, 0.3, 0.3), 0), ((0.3, 0.3, 0.3, 0.3), 3), ((0.3, 0.3, 0.3, 2.0), 3)],
)
def test_beside_white_noise_what_earned_several_times_its_price_stays(statistics, left):
    it = spring(1)
    dropped = [it.mechanisms[k] for k in (3, 5, 6, 2)]
    prices = [it.penalty[it.mechanisms.index(m)] for m in dropped]
    earned = zip(dropped, statistics, prices, strict=True)
    whole = with_share(it, 0.001, 3)
    models = [PathStep(whole, COMMON, None, 0.0, 8)]
    models += [PathStep(whole, COMMON, m, SURE * s * p, 7) for m, s, p in earned]
    assert ModelPath(it, tuple(models), 3).keeping_sure.chosen == left


@pytest.mark.parametrize(("earned", "left"), [(1.1, 0), (0.9, 1)])
def test_the_zero_of_an_input_stays_for_its_price(earned, left):
    """That is nine or so, where the prior gives it even odds; a square at twice its price goes."""
    usual = spring(1)
    it = replace(usual, zeros_are_off=True)
    (zero,) = (k for k, m in enumerate(it.mechanisms) if m.term == "1" and m.place == "x_ddot")
    others = np.setdiff1d(np.arange(len(it.mechanisms)), [zero])
    np.testing.assert_array_equal(it.penalty[others], usual.penalty[others])
    assert it.penalty[zero] == pytest.approx(np.log(it.segments.samples) + 2.0 * np.log(2.0))
    for k, stays in ((zero, left), (5, 1)):
        price = (earned if k == zero else 2.0) * it.penalty[k]
        whole = with_share(it, 0.001, k)
        models = PathStep(whole, COMMON, None, 0.0, 8), PathStep(whole, COMMON, it.mechanisms[k], price, 7)
        assert ModelPath(it, models, 1).keeping_sure.chosen == stays


def test_the_zero_of_an_input_is_never_too_slight_to_stay():
    it = replace(spring(1), zeros_are_off=True)
    (zero,) = (k for k, m in enumerate(it.mechanisms) if m.term == "1" and m.place == "x_ddot")
    for k, stays in ((zero, 0), (5, 1)):
        sure = PathStep(fitted(it), np.full(3, 0.004), it.mechanisms[k], 100.0 * it.penalty[k], 7)
        models = PathStep(with_share(it, 0.001, k), np.full(3, 0.002), None, 0.0, 8), sure
        assert ModelPath(it, models, 1).keeping_sure.chosen == stays


def test_a_constant_where_nothing_drives_is_a_term_like_any_other():
    it = replace(spring(1), zeros_are_off=True)
    undriven = it.among([m for m in it.mechanisms if "u" not in m.names])
    assert not len(undriven.zeros)
    np.testing.assert_array_equal(undriven.penalty, replace(undriven, zeros_are_off=False).penalty)


@pytest.mark.parametrize(
    ("error", "share", "left"), [(0.004, 0.005, 3), (0.004, 0.02, 1), (0.008, 0.005, 1), (0.04, 0.005, 1)]
)
def test_what_looks_white_keeps_nothing_sure_and_slight_beside_runs_that_are_near_without(error, share, left):
    it = spring(1)
    sure = [(m, 100.0 * p) for m, p in zip(it.mechanisms[4:6], it.penalty[4:6], strict=True)]
    whole = with_share(it, share, 4, 5)
    longest = PathStep(whole, np.full(3, 0.5 * error), None, 0.0, 8)
    thin = PathStep(whole, np.full(3, 0.5 * error), it.mechanisms[3], 0.0, 7)
    models = longest, thin, *(PathStep(whole, np.full(3, error), m, s, 6) for m, s in sure)
    assert ModelPath(it, models, 3).keeping_sure.chosen == left


@pytest.mark.parametrize(("share", "left"), [(0.5, 2), (2.0, 1)])
def test_what_halves_the_unexplained_variance_stays_however_near_runs_are(share, left):
    it = spring(1)
    near, statistic = np.array([0.001, 0.0012, 0.0011]), share * it.segments.samples
    dropped = (None, 0.0), (it.mechanisms[5], 3.0), (it.mechanisms[3], statistic)
    models = tuple(PathStep(fitted(it), near, m, s, 5 - k) for k, (m, s) in enumerate(dropped))
    assert ModelPath(it, models, 0).at_knee().chosen == left
