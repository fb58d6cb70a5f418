"""What terms process noise lets a record show, and the search beside it."""

import math
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from process_cases import (
    LENGTH,
    LINEAR,
    NONE,
    PRESENT,
    SIGMA,
    STEP,
    TERMS,
    Q,
    cut,
    fitted,
    kicked,
    space,
    spring,
    white_kicks,
)
from small_systems import SPRING, System, drive, in_bare_gauge

from odescope.errors import Stopped
from odescope.library.mechanism import Mechanism
from odescope.likelihood import process_noise
from odescope.likelihood.add_and_drop import Moves
from odescope.likelihood.held_out import free_run_error
from odescope.likelihood.noise_levels import estimate_noise
from odescope.likelihood.noise_or_terms import cost_without_process_noise
from odescope.likelihood.process_noise import (
    robust_evidence,
    robust_wald,
    search_with_process_noise,
)
from odescope.likelihood.refine import _evidence
from odescope.likelihood.search import Outcome, WhiteResiduals
from odescope.recordings.coordinate import Coordinate


def curved(theta, kicks, count=600):
    """Return states of the spring with more terms, by RK4 in numpy."""
    x, v, rows = 0.5, 0.0, []
    _, k, c, cube, b, square, speed, *_ = (float(t) for t in theta)

    def rate(x, v, u):
        return -(k * x + c * v + cube * x**3 + b * u + square * x * x + speed * v * v)

    h = STEP / 2
    for kick, (first, middle, last) in zip(kicks.tolist(), drive(count)[:, :, 0].tolist(), strict=True):
        x, v = x + kick[0], v + kick[1]
        rows.append((x, v))
        for s in (0.0, 0.5):
            u = [
                first * (1 - r) * (1 - 2 * r) + middle * 4 * r * (1 - r) + last * r * (2 * r - 1)
                for r in (s, s + 0.25, s + 0.5)
            ]
            a1 = rate(x, v, u[0])
            a2 = rate(x + h / 2 * v, v + h / 2 * a1, u[1])
            v2 = v + h / 2 * a1
            a3 = rate(x + h / 2 * v2, v + h / 2 * a2, u[1])
            v3 = v + h / 2 * a2
            a4 = rate(x + h * v3, v + h * a3, u[2])
            v4 = v + h * a3
            x, v = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return np.array(rows)


def with_term(slot, size):
    theta = LINEAR.copy()
    theta[slot] = size
    return theta


@pytest.mark.parametrize("slot", [5, 6], ids=["x**2", "x_dot**2"])
def test_without_process_noise_half_of_the_terms_at_their_limit_are_detected(slot):
    count, spread, gap = 300, np.array([0.01, 0.05]), 1e-3

    def evidence(states, seed):
        measured = states[:, :1] + SIGMA * np.random.default_rng(seed).standard_normal((count, 1))
        it = space(SPRING, cut(states, measured, drive(count), SIGMA, spread, (count,), 25))
        found = fitted(it, gap=gap * spread)
        return it.penalty[slot], _evidence(
            it, Outcome(found, gap, 1.0, it.penalty[found.free], it.price(found), (), True, False, 0.0), 1.0
        )

    still = np.zeros((count, 2))
    limit = evidence(curved(LINEAR, still, count), 0)[1].limits[slot]
    share = {}
    for size in (1 / 3, 1.0, 2.0):
        states = curved(with_term(slot, size * limit), still, count)
        found = [evidence(states, 500 + seed) for seed in range(24)]
        share[size] = np.mean([e.scores[slot] > price for price, e in found])
    assert share[1 / 3] <= 0.1
    assert abs(share[1.0] - 0.5) < 3 * np.sqrt(0.25 / 24)
    assert share[2.0] >= 0.95


def test_with_process_noise_terms_at_twice_their_limit_are_detected():
    it = spring(0)
    limit = robust_evidence(it, fitted(it)).limits[5]
    scores = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        states = curved(with_term(5, 2.0 * limit), white_kicks(rng, Q, (600,)))
        measured = states[:, :1] + SIGMA * rng.standard_normal((600, 1))
        it = space(SPRING, cut(states, measured, drive(600), SIGMA, Q, (600,)))
        scores.append(robust_evidence(it, fitted(it)).scores[5])
    assert np.mean(np.array(scores) > it.penalty[5]) > 0.8


def test_only_a_record_with_kicks_is_better_described_with_process_noise():
    costs = []
    for seed in range(5):
        for q in (Q, np.zeros(2)):
            it = spring(600 + seed, q=q, believed=Q)
            strict = 1e-3
            joined = fitted(it, gap=strict * Q)
            scale, prices = joined.data_cost / it.segments.samples, it.penalty[joined.free]
            outcome = Outcome(joined, strict, scale, prices, it.price(joined), (), True, False, 0.0)
            with_it = estimate_noise(it, fitted(it))[2] + it.penalty[TERMS].sum()
            costs.append((cost_without_process_noise(it, outcome), with_it))
    costs = np.array(costs)
    assert np.all(costs[::2, 0] > costs[::2, 1] + 100.0)
    # Widths that are there to be fitted gain a little, never much, where there is nothing to fit.
    assert np.all(np.abs(costs[1::2, 0] - costs[1::2, 1]) < 6.0)


def test_the_free_run_error_is_that_of_runs_by_hand_and_least_at_the_truth():
    count = 600
    it = spring(0, count, q=np.zeros(2), believed=Q)
    states, measured = it.segments.filtered, it.segments.measured[:, 0]
    nodes, errors = drive(count), []
    wrong = LINEAR * np.where(np.arange(len(LINEAR)) == 1, 1.1, 1.0)
    for begin in (492, 516, 540, 564):
        run = kicked(SPRING, wrong, nodes[begin:], np.zeros((count - begin, 2)), states[begin])[:, 0]
        e = np.mean((run - measured[begin:]) ** 2) / measured.var()
        errors.append(e / (1 + e))
    assert free_run_error(it, wrong) == pytest.approx(np.mean(errors), rel=1e-4)
    assert free_run_error(it, LINEAR) < 0.05 * np.mean(errors)


def read_with(offset):
    """Return the space of a spring whose sensor reads so much more, the offset its last candidate."""
    it = spring(0, 600, q=np.zeros(2), believed=Q)
    segments = it.segments
    read = replace(segments, measured=segments.measured + offset, filtered=segments.filtered + np.array([offset, 0.0]))
    mechanisms = (*it.mechanisms, Mechanism("offset", "offset x", "x", (), 0.0))
    return it, replace(it.on(read), mechanisms=mechanisms)


def test_free_runs_begin_by_the_zeros_of_the_sensors():
    plain, read = read_with(0.3)
    error = free_run_error(plain, LINEAR)
    assert free_run_error(read, np.append(LINEAR, 0.3)) == pytest.approx(error, rel=1e-6)
    assert free_run_error(read, np.append(LINEAR, 0.0)) > 10.0 * error


@pytest.mark.parametrize(("offset", "found"), [(0.6, 0.6), (1.2, 0.25 * np.pi)])
def test_an_offset_is_no_more_than_turns_sines_half_way_into_cosines(offset, found):
    _, read = read_with(offset)
    theta, present = np.append(LINEAR, 0.5), np.append(PRESENT, len(LINEAR))
    fit = read.fit(theta, present, read.segments.initial, np.full(2, np.inf))
    assert fit.theta[-1] == pytest.approx(found, abs=0.05)


PENDULUM = System(
    (Coordinate("th", 2, angle=True),),
    ("u",),
    (
        (0, 0, "1", 1.0),
        (0, -1, "sin(th)", 9.0),
        (0, -1, "th_dot", 0.4),
        (0, -1, "u", -2.0),
        (0, -1, "1", 0.0),
        (0, -1, "th_dot**3", 0.0),
        (0, -1, "u*cos(th)", 0.0),
        (0, -1, "sin(th)*cos(th)", 0.0),
        (0, 0, "cos(th)**2", 0.0),
    ),
    (0,),
    None,
)


PENDULUM_TERMS = [1, 2, 3]


def pendulum(nodes, torque, kicks):
    """Return states of the pendulum under kicks (N,) of its velocity and a torque (N,) that holds over each step."""
    th, v, rows, h = 0.3, 0.0, [], STEP / 2
    steps = zip(torque.tolist(), kicks.tolist(), nodes[:, :, 0].tolist(), strict=True)
    for w, kick, (first, middle, last) in steps:
        v += kick
        rows.append((th, v))
        quarters = [0.375 * first + 0.75 * middle - 0.125 * last, -0.125 * first + 0.75 * middle + 0.375 * last]
        for u in ((first, quarters[0], middle), (middle, quarters[1], last)):
            a = 2.0 * u[0] - 9.0 * math.sin(th) - 0.4 * v + w
            v2 = v + h / 2 * a
            b = 2.0 * u[1] - 9.0 * math.sin(th + h / 2 * v) - 0.4 * v2 + w
            v3 = v + h / 2 * b
            c = 2.0 * u[1] - 9.0 * math.sin(th + h / 2 * v2) - 0.4 * v3 + w
            v4 = v + h * c
            d = 2.0 * u[2] - 9.0 * math.sin(th + h * v3) - 0.4 * v4 + w
            th, v = th + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a + 2 * b + 2 * c + d)
    return np.array(rows)


@pytest.mark.parametrize("when", ["a kick a segment", "a torque a sample"])
def test_the_search_finds_the_pendulum_under_a_white_torque_and_its_size(when):
    count, size, found = 1500, 2.0, []
    for seed in range(5):
        rng = np.random.default_rng(700 + seed)
        kicks, torque = np.zeros(count), np.zeros(count)
        if when == "a kick a segment":
            kicks[LENGTH::LENGTH] = LENGTH * STEP * size * rng.standard_normal(count // LENGTH - 1)
        else:
            torque = math.sqrt(LENGTH) * size * rng.standard_normal(count)
        states = pendulum(drive(count), torque, kicks)
        measured = states[:, :1] + 0.005 * rng.standard_normal((count, 1))
        # Wider to begin with than what there is, as the smoothing errors of the stage are.
        it = space(PENDULUM, cut(states, measured, drive(count), 0.005, [0.05, 2.0], (count,)), 1)
        theta = PENDULUM.theta.copy()
        theta[[1, 2, 6, 7]] = [8.0, 0.6, 0.2, 0.5]
        found.append(search_with_process_noise(it, [theta]))
    right = [n for n in found if n.fit.present.tolist() == [0, *PENDULUM_TERMS]]
    assert len(right) >= 4
    # A kick at the joint is what the model has; torque within segments also moves their states.
    unexplained = np.array([n.unexplained[0] for n in found])
    assert np.all(np.abs(unexplained / size - 1.0) < (0.15 if when == "a kick a segment" else 0.3))
    for n in right:
        bare = in_bare_gauge(n.space, n.fit, n.evidence.covariance)
        error = (bare.theta - PENDULUM.theta)[PENDULUM_TERMS]
        assert np.all(np.abs(error) < 4.5 * bare.errors[PENDULUM_TERMS])
        prices = n.space.penalty[PENDULUM_TERMS].sum() + 2 * np.log(n.space.segments.samples)
        assert n.penalised == pytest.approx(n.marginal + prices)
        if when == "a kick a segment":
            assert n.space.segments.noise[0] == pytest.approx(0.005, rel=0.15)


@pytest.mark.parametrize(
    ("lacks", "spends", "limits"),
    [
        (True, 1.0, [4.0, 4.0, 4.0]),
        (True, 0.0, [4.0, 6.0, 12.0]),
        (True, 2.5, [4.0, 1.0]),
        (False, 1.0, [4.0, 2.0, 2.0]),
    ],
)
def test_no_start_spends_what_others_need_to_add_terms(monkeypatch, lacks, spends, limits):
    it, seen = spring(1, 600), list[float]()
    it = it.within(replace(it.budget, limit=12.0))
    starts = [np.where(np.arange(len(LINEAR)) == k, 0.0, LINEAR) for k in (None, *TERMS[:2])]

    def searched(own, start):
        assert own.budget.spent == 0.0
        seen.append(own.budget.limit)
        own.budget.spent = spends * own.budget.limit
        return own, start, start.cost, ()

    monkeypatch.setattr(
        process_noise, "_able", lambda space, thetas: [space.begin(t, space.segments.spread) for t in thetas]
    )
    monkeypatch.setattr(process_noise, "_search", searched)
    monkeypatch.setattr(process_noise, "white", lambda found, evidence: not lacks)
    monkeypatch.setattr(process_noise.ModelPath, "back", Mock(side_effect=Stopped))
    with pytest.raises(Stopped):  # after the searches
        search_with_process_noise(it, starts)
    assert seen == pytest.approx(limits, rel=1e-2)


@pytest.mark.parametrize("lacks", [1, 2], ids=["x", "x_dot"])
def test_a_term_that_a_transient_alone_shows_is_found(lacks):
    """Of twenty blocks three hold all that it explains: its score differs between them as much as it is large."""
    count, q = 600, np.array([0.0, 0.02])
    theta, nodes = np.where(np.arange(len(LINEAR)) == lacks, 0.0, LINEAR), 0.02 * drive(count)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        states = kicked(SPRING, LINEAR, nodes, white_kicks(rng, q, (count,)), [5.0, 0.0])
        measured = states[:, :1] + SIGMA * rng.standard_normal((count, 1))
        it = space(SPRING, cut(states, measured, nodes, SIGMA, [0.005, 0.02], (count,)))
        noisy, without, _ = estimate_noise(it, it.begin(theta, it.segments.spread))
        assert robust_evidence(noisy, without).scores[lacks] < 0.5 * it.penalty[lacks]
        assert WhiteResiduals(noisy, noisy.segments.spread).scores(without)[lacks] > 5.0 * it.penalty[lacks]
        assert search_with_process_noise(it, [theta]).fit.present.tolist() == PRESENT.tolist()


def test_what_is_not_sure_beside_its_look_alike_is_tried_once_and_may_take_its_place(monkeypatch):
    it = spring(0)
    here = fitted(it, np.where(np.arange(len(LINEAR)) == 2, 0.0, LINEAR), np.array([0, 1, 4]))
    moves = Moves(it, process_noise._BlockSpread(it), 1.0, 1.0, [])
    scores = np.where(np.arange(len(LINEAR)) == 2, 1000.0, 0.0)
    monkeypatch.setattr(Moves, "_weak", lambda *_: True)
    assert moves.add_uneven(here, scores) is None
    assert moves.unsure == {2}
    assert not moves.barred
    monkeypatch.setattr(Moves, "having", Mock(side_effect=AssertionError))
    assert moves.add_uneven(here, scores) is None


def test_a_term_takes_the_place_of_two_that_add_up_to_it():
    """Beside u cos^2 and u sin^2 each other is sure, and u has no score."""
    halves = ((0, -1, "u*cos(th)**2", -2.0), (0, -1, "u*sin(th)**2", -2.0))
    system, count = replace(PENDULUM, terms=(*PENDULUM.terms, *halves)), 1000
    theta = np.where(np.arange(len(system.terms)) == 3, 0.0, system.theta)
    for seed in range(3):
        rng = np.random.default_rng(800 + seed)
        kicks = np.where(np.arange(count) % LENGTH == 0, 0.3 * rng.standard_normal(count), 0.0)
        states = pendulum(drive(count), np.zeros(count), kicks)
        measured = states[:, :1] + 0.005 * rng.standard_normal((count, 1))
        it = space(system, cut(states, measured, drive(count), 0.005, [0.05, 2.0], (count,)), 1)
        assert search_with_process_noise(it, [theta]).fit.present.tolist() == [0, *PENDULUM_TERMS]


def test_programs_of_present_slots_alone_and_of_all_slots_cost_the_same():
    it = spring(0)
    found = fitted(it)
    gap = it.segments.spread
    short = it.evaluator.expand(it.program(found.present), found.theta[found.present], NONE, found.x0, gap)
    whole = it.whole
    assert short.cost == pytest.approx(it.evaluator.expand(whole, found.theta, NONE, found.x0, gap).cost, rel=1e-12)


def test_statistics_of_what_is_there_do_not_depend_on_what_is_absent():
    it = spring(1)
    found = fitted(it)
    np.testing.assert_allclose(robust_wald(it, found), robust_evidence(it, found).wald, rtol=1e-9)


def test_the_cost_of_a_search_is_that_of_where_it_ended_wherever_it_was_stopped(monkeypatch):
    monkeypatch.setattr(process_noise, "ALTERNATIONS", 1)
    it = spring(1)
    theta = LINEAR.copy()
    theta[1] = 0.0  # without what holds it back
    there, found, cost, trail = process_noise._search(it, fitted(it, theta, np.flatnonzero(theta)))
    assert trail
    _, _, marginal = estimate_noise(there, found)
    assert cost == pytest.approx(marginal + there.price(found), abs=0.01)


def test_measurement_noise_does_not_fall_below_its_floor():
    it = spring(2, sigma=0.003)
    free, _, least = estimate_noise(it, fitted(it))
    assert free.segments.noise[0] < 0.004
    bounded = it.on(replace(it.segments, floor=np.array([0.006])))
    bound, _, cost = estimate_noise(bounded, fitted(bounded))
    assert bound.segments.noise[0] == pytest.approx(0.006)
    assert cost > least + 10.0


def test_a_long_record_is_searched_in_stretches_and_fitted_whole():
    count = 30_000
    it = spring(3, count)
    theta = LINEAR.copy()
    theta[5] = 0.05
    found = search_with_process_noise(it, [theta])
    assert found.fit.present.tolist() == PRESENT.tolist()
    assert len(found.fit.x0) == len(it.segments.start)
    bare = in_bare_gauge(found.space, found.fit, found.evidence.covariance)
    assert np.all(np.abs(bare.theta - LINEAR)[TERMS] < 4.0 * bare.errors[TERMS])
    # As sure as the whole record makes them, not a part of it.
    short = spring(3, 12_000)
    assert np.all(bare.errors[TERMS] < 0.8 * in_bare_gauge(short, fitted(short)).errors[TERMS])
