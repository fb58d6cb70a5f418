"""Process noise, against dense Gaussians in numpy and over seeds of systems simulated here."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve, expm
from scipy.optimize import minimize
from scipy.stats import chi2
from small_systems import CART, SPRING, System, drive

from odescope.likelihood import process_noise as module
from odescope.likelihood.block_cholesky import eliminate, state_covariances
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.evidence import weigh
from odescope.likelihood.fit import Fit, fit
from odescope.likelihood.held_out import free_run_error, held_out, without_held_out
from odescope.likelihood.kernel import Sums
from odescope.likelihood.process_noise import (
    cost_without_process_noise,
    estimate_noise,
    robust_evidence,
    search_with_process_noise,
    with_noise,
)
from odescope.likelihood.refine import FINEST, _evidence, _halve
from odescope.likelihood.search import Outcome
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments
from odescope.recordings.coordinate import Coordinate

STEP, LENGTH = 0.05, 5
NONE = np.zeros(0, dtype=np.int64)

# Two masses on springs, coupled, both positions measured; exact solutions come from a matrix exponential.
MASSES = System(
    (Coordinate("x", 2), Coordinate("z", 2)),
    ("u",),
    (
        (0, 0, "1", 1.0),
        (0, -1, "x", 4.0),
        (0, -1, "x_dot", 0.3),
        (0, -1, "z", -1.5),
        (0, -1, "u", -1.0),
        (1, 1, "1", 1.0),
        (1, -1, "z", 6.0),
        (1, -1, "z_dot", 0.5),
        (1, -1, "x", -1.5),
    ),
    (0, 5),
    None,
)
# One mass: the spring without its cube. What it lacks are the candidates that are absent.
PRESENT = np.array([1, 2, 4])
ABSENT = np.array([3, 5, 6, 7, 8, 9])
LINEAR = np.where(np.arange(len(SPRING.theta)) == 3, 0.0, SPRING.theta)
SIGMA, Q = 0.02, np.array([0.02, 0.1])


def matrices(system, theta):
    """Return A, B and C of x' = A x + B u, y = C x of a linear system, from its slots."""
    n = len(system.following)
    a, b, c = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((len(system.measured), n))
    for i, f in enumerate(system.following):
        if f >= 0:
            a[i, f] = 1.0
        for (relation, factor, text, _), value in zip(system.terms, theta, strict=True):
            if factor < 0 and relation == -1 - f and value:
                k = system.variables.index(text)
                (a if k < n else b)[i, k if k < n else k - n] -= value
    c[np.arange(len(c)), system.measured] = 1.0
    return a, b, c


def discrete(a, b, step):
    """Return Phi, and Gamma of the three nodes of a parabola, of one step: exact."""
    n = len(a)
    whole = np.zeros((n + 3, n + 3))
    whole[:n, :n], whole[:n, n] = a, b[:, 0]
    whole[n, n + 1] = whole[n + 1, n + 2] = 1.0
    power = expm(step * whole)
    taylor = np.array([[1, 0, 0], [-3 / step, 4 / step, -1 / step], [4 / step**2, -8 / step**2, 4 / step**2]])
    return power[:n, :n], power[:n, n:] @ taylor


def kicked(system, theta, nodes, kicks, start, step=STEP):
    """Return the states (N, n) of a linear system whose state jumps by kicks (N, n) just before each sample."""
    a, b, _ = matrices(system, theta)
    phi, gamma = discrete(a, b, step)
    x, rows = np.array(start), []
    for u, kick in zip(nodes[:, :, 0], kicks, strict=True):
        x = x + kick
        rows.append(x)
        x = phi @ x + gamma @ u
    return np.array(rows)


def cut(states, measured, nodes, sigma, q, lengths, length=LENGTH, step=STEP):
    """Return segments of records of these lengths, end to end."""
    start, count, joined, runs, total = [], [], [], [], 0
    for samples in lengths:
        edges = np.append(np.arange(0, samples - length + 1, length), samples)
        start += (total + edges[:-1]).tolist()
        count += np.diff(edges).tolist()
        joined += [True] * (len(edges) - 2) + [False]
        runs.append((total, total + samples))
        total += samples
    return Segments(
        measured, nodes, states, np.array(start), np.array(count), np.array(joined),
        np.atleast_1d(np.array(sigma, dtype=float)), np.array(q, dtype=float), step, 1, tuple(runs),
    )  # fmt: skip


def white_kicks(rng, q, lengths):
    """Return kicks of the widths q at the joints, none elsewhere."""
    kicks = np.zeros((sum(lengths), len(q)))
    begin = np.cumsum([0, *lengths[:-1]])
    for low, samples in zip(begin, lengths, strict=True):
        at = low + np.arange(LENGTH, samples - LENGTH + 1, LENGTH)
        kicks[at] = q * rng.standard_normal((len(at), len(q)))
    return kicks


def space(system, segments, substeps=2, budget=None):
    return SearchSpace(
        Evaluator(segments, substeps, budget),
        system.parts,
        system.frame,
    )


def spring(seed, count=600, sigma=SIGMA, q=Q, kicks=None, believed=None):
    """Return the space of a kicked linear spring with white noise."""
    rng = np.random.default_rng(seed)
    kicks = white_kicks(rng, np.array(q), (count,)) if kicks is None else kicks
    states = kicked(SPRING, LINEAR, drive(count), kicks, [0.5, 0.0])
    measured = states[:, :1] + sigma * rng.standard_normal((count, 1))
    believed = q if believed is None else believed
    return space(SPRING, cut(states, measured, drive(count), sigma, believed, (count,)))


def fitted(it, theta=LINEAR, present=PRESENT, gap=None):
    found = it.fit(theta, present, it.segments.initial, it.segments.spread if gap is None else gap)
    assert found is not None
    return found


def masses(seed, sigma, q, lengths):
    rng = np.random.default_rng(seed)
    nodes = drive(sum(lengths))
    kicks = white_kicks(rng, np.array(q), lengths)
    states = np.concatenate(
        [
            kicked(MASSES, MASSES.theta, nodes[low : low + n], kicks[low : low + n], [0.5, 0.0, -0.3, 0.4])
            for low, n in zip(np.cumsum([0, *lengths[:-1]]), lengths, strict=True)
        ]
    )
    measured = states[:, [0, 1]] + sigma * rng.standard_normal((len(states), 2))
    return space(MASSES, cut(states, measured, nodes, sigma, q, lengths))


# posterior


def dense_states_hessian(hessian, jacobian, joined, gap):
    segments, n = len(joined), hessian.shape[2] if jacobian is None else jacobian.shape[1]
    whole = np.zeros((segments * n, segments * n))
    for j in range(segments):
        here = slice(j * n, (j + 1) * n)
        whole[here, here] += hessian[j, :n, :n]
        if joined[j]:
            after = slice((j + 1) * n, (j + 2) * n)
            f, w = jacobian[j][:, :n], np.diag(1.0 / gap**2)
            whole[here, here] += f.T @ w @ f
            whole[after, after] += w
            whole[after, here] -= w @ f
            whole[here, after] -= f.T @ w
    return whole


def assert_blocks_of_the_inverse(own, following, whole, joined):
    inverse, (segments, n, _) = np.linalg.inv(whole), own.shape
    scale = np.abs(inverse).max()
    for j in range(segments):
        here = slice(j * n, (j + 1) * n)
        np.testing.assert_allclose(own[j], inverse[here, here], rtol=1e-8, atol=1e-11 * scale)
        if joined[j]:
            after = slice((j + 1) * n, (j + 2) * n)
            np.testing.assert_allclose(following[j], inverse[after, here], rtol=1e-8, atol=1e-11 * scale)
        else:
            assert not following[j].any()


@pytest.mark.parametrize(("segments", "n"), [(1, 3), (2, 1), (7, 2), (9, 4)])
def test_covariances_of_a_random_chain_are_blocks_of_the_dense_inverse(segments, n):
    rng = np.random.default_rng(segments)
    jacobian = rng.standard_normal((segments, n, n))
    roots = rng.standard_normal((segments, n + 2, n))
    hessian = np.einsum("jki,jkl->jil", roots, roots)
    joined = rng.random(segments) < 0.7
    joined[-1] = False
    gap = rng.uniform(0.3, 2.0, n)
    zeros = np.zeros((segments, n))
    *_, factor, _, carry, log_det, ok = eliminate(
        Sums(np.zeros(segments), zeros, hessian, zeros, jacobian), zeros, joined, gap, 0.0
    )
    assert ok
    whole = dense_states_hessian(hessian, jacobian, joined, gap)
    assert log_det == pytest.approx(np.linalg.slogdet(whole)[1], rel=1e-10)
    assert_blocks_of_the_inverse(*state_covariances(factor, carry, joined), whole, joined)


@pytest.mark.parametrize("system", [CART, MASSES], ids=["cart", "masses"])
def test_covariances_of_a_record_are_blocks_of_the_dense_inverse(system):
    rng = np.random.default_rng(0)
    lengths, gap = (20, 33), np.array([0.02, 0.03, 0.1, 0.2])
    x0, nodes = 0.3 * rng.standard_normal((53, 4)), drive(53)
    it = space(system, cut(x0, x0[:, :2], nodes, [0.02, 0.05], gap, lengths)).evaluator
    theta, joined, start = system.theta, it.segments.joined, it.segments.initial
    assert not joined.all()
    for free in (NONE, system.free):
        integrated = it.integrate(system.program, theta, free, start)
        found = it.expand(system.program, theta, free, start, gap, 0.0, integrated)
        whole = dense_states_hessian(integrated.hessian, integrated.jacobian, joined, gap)
        assert_blocks_of_the_inverse(*state_covariances(found.factor, found.carry, joined), whole, joined)


# the marginal likelihood


def linear_maps(it, system, theta):
    """Return of each record the effect (m, n (1 + joints)) of first state and kicks on the measured, and the rest."""
    segments = it.segments
    a, b, c = matrices(system, theta)
    phi, gamma = discrete(a, b, segments.step)
    n, found = len(a), []
    for low, high in segments.runs:
        joints = [s for s in segments.start if low < s < high]
        effect, forced = np.zeros((n, n * (1 + len(joints)))), np.zeros(n)
        effect[:, :n] = np.eye(n)
        rows, rest = [], []
        for k in range(low, high):
            if k in joints:
                place = n * (1 + joints.index(k))
                effect[:, place : place + n] = np.eye(n)
            rows.append(c @ effect)
            rest.append(segments.measured[k] - c @ forced)
            forced = phi @ forced + gamma @ segments.inputs[k, :, 0]
            effect = phi @ effect
        found.append((np.concatenate(rows), np.concatenate(rest)))
    return found


def dense_cost(maps, sigma, q):
    """Return -2 log density of all measurements, flat over the first state of each record, by dense matrices."""
    n, total = len(q), 0.0
    for effect, rest in maps:
        first, kicks = effect[:, :n], effect[:, n:]
        v = (kicks * np.tile(np.array(q) ** 2, kicks.shape[1] // n)) @ kicks.T
        v += np.diag(np.tile(np.array(sigma) ** 2, len(rest) // len(sigma)))
        factor = cho_factor(v, lower=True)
        precision = first.T @ cho_solve(factor, first)
        left = rest - first @ np.linalg.solve(precision, first.T @ cho_solve(factor, rest))
        total += left @ cho_solve(factor, left) + 2 * np.log(np.diag(factor[0])).sum() + np.linalg.slogdet(precision)[1]
    return total


def expected(it, system, theta, sigma, q):
    """Return what the module makes of the states at a model and noise that are given."""
    moved = with_noise(it, np.array(sigma, dtype=float), np.array(q, dtype=float))
    settled = fit(moved.evaluator, system.program, theta, NONE, moved.segments.initial, moved.segments.spread)
    assert settled is not None
    return module._expected_squares(moved, replace(settled, present=system.free))


def test_marginal_costs_differ_as_those_of_a_dense_gaussian_do():
    it = masses(0, np.array([0.02, 0.03]), [0.02, 0.03, 0.1, 0.15], (60, 43))
    other = MASSES.theta.copy()
    other[[1, 2, 4, 6, 8]] *= [1.05, 0.7, 0.96, 0.98, 1.1]
    settings = [
        (theta, sigma, q)
        for theta in (MASSES.theta, other)
        for sigma in ([0.02, 0.03], [0.05, 0.01])
        for q in ([0.02, 0.03, 0.1, 0.15], [0.001, 0.1, 0.5, 0.01])
    ]
    ours = np.array([expected(it, MASSES, *s)[2] for s in settings])
    dense = np.array([dense_cost(linear_maps(it, MASSES, theta), sigma, q) for theta, sigma, q in settings])
    assert np.ptp(dense) > 500.0
    # RK4 at half a step against the exponential is what is left: parts in a million of costs of up to thousands.
    np.testing.assert_allclose(ours - ours[0], dense - dense[0], rtol=1e-5, atol=2e-3)


def test_the_step_of_the_noise_stands_still_at_the_maximum_of_the_dense_likelihood_and_nowhere_else():
    sigma, q = np.array([0.01, 0.02]), np.array([0.04, 0.06, 0.3, 0.4])
    it = masses(1, sigma, q, (60, 45))
    maps = linear_maps(it, MASSES, MASSES.theta)
    best = minimize(
        lambda z: dense_cost(maps, *np.split(np.exp(z), [2])), np.log([*sigma, *q]), method="BFGS",
        options={"gtol": 1e-3},
    )  # fmt: skip
    at = np.split(np.exp(best.x), [2])
    process, measurement, _ = expected(it, MASSES, MASSES.theta, *at)
    np.testing.assert_allclose(measurement, at[0], rtol=1e-3)
    np.testing.assert_allclose(process, at[1], rtol=1e-3)
    # A step from beside it goes towards it, in every coordinate.
    for k in range(6):
        for factor in (0.7, 1.4):
            beside = np.exp(best.x)
            beside[k] *= factor
            process, measurement, _ = expected(it, MASSES, MASSES.theta, *np.split(beside, [2]))
            moved = np.array([*measurement, *process])[k] / beside[k]
            assert (moved > 1.0) == (factor < 1.0)


def own_maximum(it):
    """Return the least marginal cost over both noises, coefficients fitted, found by SciPy."""

    def cost(z):
        moved = with_noise(it, it.segments.noise * np.exp(z[0]), it.segments.spread * np.exp(z[1:]))
        return module._expected_squares(moved, fitted(moved))[2]

    found = minimize(cost, np.zeros(3), method="Nelder-Mead", options={"xatol": 3e-3, "fatol": 1e-2})
    return found.fun, it.segments.noise * np.exp(found.x[0]), it.segments.spread * np.exp(found.x[1:])


def test_noise_estimated_from_above_is_the_maximum_of_the_marginal_likelihood():
    it = spring(3, q=[0.05, 0.25], sigma=0.01)
    cost, sigma, q = own_maximum(it)
    begun = with_noise(it, 2.0 * it.segments.noise, 3.0 * it.segments.spread)
    ended, found, marginal = estimate_noise(begun, fitted(begun))
    assert marginal == pytest.approx(cost, abs=0.5)
    np.testing.assert_allclose(ended.segments.noise, sigma, rtol=0.02)
    np.testing.assert_allclose(ended.segments.spread, q, rtol=0.05)
    assert marginal == module._expected_squares(ended, found)[2]


def test_noise_estimated_from_below_is_the_maximum_of_the_marginal_likelihood():
    it = spring(0, q=[0.01, 0.08])
    begun = with_noise(it, 3.0 * it.segments.noise, [0.3, 3.0] * it.segments.spread)
    truth = module._expected_squares(it, fitted(it))[2]
    # The maximum is below the truth's cost.
    assert estimate_noise(begun, fitted(begun))[2] < truth + 1.0


def test_estimated_noise_is_unbiased_over_seeds():
    sigma, q = 0.01, np.array([0.05, 0.25])
    ratios = []
    for seed in range(20):
        it = spring(100 + seed, sigma=sigma, q=q)
        begun = with_noise(it, 2.0 * it.segments.noise, 2.0 * it.segments.spread)
        ended = estimate_noise(begun, fitted(begun))[0].segments
        ratios.append([*ended.noise / sigma, *ended.spread / q])
    scatter = np.std(ratios, axis=0, ddof=1)
    assert np.all(scatter < [0.06, 0.15, 0.15])
    # Three fitted coefficients take 3 of 120 kicks: half of that from a standard deviation.
    lost = np.array([0.0, 3 / 240, 3 / 240])
    assert np.all(np.abs(np.mean(ratios, axis=0) - 1.0 + lost / 2) < 3.5 * scatter / np.sqrt(20) + lost / 2)


# evidence that allows for colour


@pytest.fixture
def weighed(monkeypatch):
    """What robust_evidence passes on: the arguments of its last call of weigh."""
    last = []

    def spy(*arguments):
        last[:] = arguments
        return weigh(*arguments)

    monkeypatch.setattr(module, "weigh", spy)
    return last


def test_gradients_of_blocks_sum_to_that_of_the_marginal_fit(weighed):
    it = spring(0)
    theta = LINEAR * np.where(np.arange(len(LINEAR)) == 2, 0.0, 1.0)
    found = fitted(it, theta, np.array([1, 4]))  # lacks friction: a gradient that is not zero
    assert robust_evidence(it, found) is not None
    _, _, information, blocks = weighed
    expansion = it.evaluator.expand(SPRING.program, found.theta, it.free, found.x0, it.segments.spread)
    scale = np.sqrt(np.diag(information))
    np.testing.assert_allclose(blocks.sum(axis=0) / scale, expansion.gradient / scale, atol=0.01)
    assert abs(expansion.gradient[1] / scale[1]) > 10.0


def test_with_white_gaps_blocks_scatter_as_the_model_says(weighed):
    ratios, squares = [], 0.0
    for seed in range(30):
        it = spring(200 + seed)
        found = fitted(it)
        robust = robust_evidence(it, found)
        _, _, information, blocks = weighed
        own = weigh(it, found, information, blocks.sum(axis=0)[None]).variances
        np.testing.assert_allclose(own, found.variances, rtol=1e-3)
        # Information and gradients larger by one factor leave of the two variances that of the blocks.
        alone = weigh(it, found, 1e6 * information, 1e6 * blocks).variances
        np.testing.assert_allclose(robust.variances, np.maximum(own, alone), rtol=1e-9)
        ratios.append(alone / own)
        error = (found.theta - LINEAR)[PRESENT]
        squares += error @ found.information @ error
    # Ten blocks that sum to zero, and three coefficients fitted to them: a tenth to a fifth less than the variance.
    mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0) / np.sqrt(30)
    assert np.all(np.abs(mean - 0.85) < 0.05 + 3 * error)
    assert chi2.ppf(1e-3, 90) < squares < chi2.ppf(1 - 1e-3, 90)


def slow_force(rng, count, size, correlated):
    force, keep = np.empty(count), math.exp(-STEP / correlated)
    force[0] = rng.standard_normal()
    for k, fresh in enumerate(rng.standard_normal(count - 1)):
        force[k + 1] = keep * force[k] + math.sqrt(1.0 - keep**2) * fresh
    return size * force


def test_with_coloured_gaps_robust_intervals_cover_and_plain_ones_do_not():
    # Small beside the input: a large force moves the states with it, which biases coefficients, whatever their errors.
    count, plain, robust, ratio = 2000, [], [], []
    for seed in range(25):
        force = slow_force(np.random.default_rng(seed), count, 0.25, 0.5)
        kicks = STEP * np.column_stack([0.5 * STEP * force, force])
        gaps = np.add.reduceat(kicks, np.arange(0, count, LENGTH), axis=0)
        it = spring(300 + seed, count, 0.005, kicks=kicks, believed=np.maximum(gaps.std(axis=0), 0.002))
        found = fitted(it)
        evidence = robust_evidence(it, found)
        error = np.abs(found.theta - LINEAR)[PRESENT]
        plain.append(error < 1.96 * np.sqrt(found.variances))
        robust.append(error < 1.96 * np.sqrt(evidence.variances))
        ratio.append(evidence.variances / found.variances)
    assert np.mean(ratio) > 2.0
    assert np.mean(plain) < 0.8
    assert np.mean(robust) > 0.87


def test_scores_of_absent_terms_are_chi_squared_with_one_degree_of_freedom(weighed):
    own, robust = [], []
    for seed in range(40):
        it = spring(400 + seed, 800)
        found = fitted(it)
        evidence = robust_evidence(it, found)
        assert not evidence.scores[[0, *PRESENT]].any()
        assert not evidence.limits[[0, *PRESENT]].any()
        _, _, information, blocks = weighed
        robust.append(evidence.scores[ABSENT])
        own.append(weigh(it, found, information, blocks.sum(axis=0)[None]).scores[ABSENT])
    own, robust = np.array(own), np.array(robust)
    # 240 scores: a share of 5 % has standard deviation 1.4 %, their mean one of 0.09, correlation apart.
    assert own.mean() == pytest.approx(1.0, abs=0.3)
    assert np.mean(own > 3.84) == pytest.approx(0.05, abs=0.035)
    assert np.mean(own < 0.455) == pytest.approx(0.5, abs=0.1)
    # The larger of two variances: never above the model's own, at most a few points below.
    assert np.all(robust <= own * (1 + 1e-9))
    assert 0.01 < np.mean(robust > 3.84) < 0.085


def test_a_missing_strong_term_scores_above_its_price_on_a_short_record():
    it = spring(0)
    lacks = fitted(it, LINEAR * np.where(np.arange(len(LINEAR)) == 2, 0.0, 1.0), np.array([1, 4]))
    fall = lacks.cost - fitted(it).cost
    assert fall > 20.0 * it.penalty[2]
    assert robust_evidence(it, lacks).scores[2] > it.penalty[2]


# limits of detection


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
        return it.penalty[slot], _evidence(it, Outcome(found, gap, 1.0, it.penalty, (), True, False, 0.0))

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


# with and without


def test_only_a_record_with_kicks_is_better_described_with_process_noise():
    costs = []
    for seed in range(5):
        for q in (Q, np.zeros(2)):
            it = spring(600 + seed, q=q, believed=Q)
            strict = 1e-3
            joined = fitted(it, gap=strict * Q)
            outcome = Outcome(joined, strict, joined.data_cost / it.segments.samples, it.penalty, (), True, False, 0.0)
            with_it = estimate_noise(it, fitted(it))[2] + it.penalty[PRESENT].sum()
            costs.append((cost_without_process_noise(it, outcome), with_it))
    costs = np.array(costs)
    assert np.all(costs[::2, 0] > costs[::2, 1] + 100.0)
    # Widths that are there to be fitted gain a little, never much, where there is nothing to fit.
    assert np.all(np.abs(costs[1::2, 0] - costs[1::2, 1]) < 6.0)


@pytest.mark.parametrize("lengths", [(100, 27), (30, 20, 25, 40, 35, 10), (12,) * 11])
def test_what_searches_see_and_what_is_held_out_have_nothing_in_common(lengths):
    total = sum(lengths)
    segments = cut(np.zeros((total, 2)), np.zeros((total, 1)), drive(total), SIGMA, Q, lengths)
    seen = without_held_out(segments)
    covered = np.concatenate([np.arange(s, s + c) for s, c in zip(seen.start, seen.count, strict=True)])
    out = np.concatenate([np.arange(low, high) for low, high in held_out(segments)])
    assert not set(covered) & set(out)
    assert 0.1 < len(out) / total < 0.25
    # Between them no more than the segment that holds the edge is lost.
    assert total - len(covered) - len(out) < LENGTH * len(held_out(segments))
    follows = np.append(seen.start[1:] == (seen.start + seen.count)[:-1], False)
    borders = {high for _, high in segments.runs}
    np.testing.assert_array_equal(
        seen.joined, follows & ~np.array([e in borders for e in (seen.start + seen.count).tolist()])
    )


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


# the search

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
PENDULUM_PRESENT = [1, 2, 3]


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
        found.append(search_with_process_noise(it, [(theta, np.array([1, 2, 3, 6, 7]))]))
    right = [n for n in found if n.fit.present.tolist() == PENDULUM_PRESENT]
    assert len(right) >= 4
    # A kick at the joint is what the model has; torque within segments also moves their states.
    unexplained = np.array([n.unexplained[0] for n in found])
    assert np.all(np.abs(unexplained / size - 1.0) < (0.15 if when == "a kick a segment" else 0.3))
    for n in right:
        error = (n.fit.theta - PENDULUM.theta)[PENDULUM_PRESENT]
        assert np.all(np.abs(error) < 4.5 * np.sqrt(n.evidence.variances))
        prices = n.space.penalty[PENDULUM_PRESENT].sum() + 2 * np.log(n.space.segments.samples)
        assert n.penalised == pytest.approx(n.marginal + prices)
        if when == "a kick a segment":
            assert n.space.segments.noise[0] == pytest.approx(0.005, rel=0.15)


# steps of RK4


def coarse(sigma):
    """Return the space of a spring sampled so rarely that one step a sample is far too long."""
    step, count = 0.5, 400
    nodes = drive(count, step)
    states = kicked(SPRING, LINEAR, nodes, np.zeros((count, 2)), [0.5, 0.0], step)
    measured = states[:, :1] + sigma * np.random.default_rng(0).standard_normal((count, 1))
    return space(SPRING, cut(states, measured, nodes, sigma, [0.01, 0.05], (count,), 25, step), 1)


def test_steps_are_halved_until_that_moves_no_coefficient():
    it = coarse(0.005)
    gap = 0.01 * it.segments.spread
    rough = fitted(it, gap=gap)
    finer, found = _halve(it, rough, gap)
    assert 1 < finer.evaluator.substeps <= FINEST
    best = replace(it, evaluator=Evaluator(it.segments, 32)).fit(LINEAR, PRESENT, found.x0, gap)

    def moved(fit: Fit):
        return np.abs((fit.theta - best.theta)[PRESENT] / np.sqrt(best.variances)).max()

    assert moved(rough) > 5.0
    assert moved(found) < 0.1


def test_steps_that_are_short_enough_stay_and_so_does_the_fit():
    it = spring(0)
    found = fitted(it)
    same, kept = _halve(it, found, it.segments.spread)
    assert same is it
    assert kept is found


def test_programs_of_present_slots_alone_and_of_all_slots_cost_the_same():
    it = spring(0)
    found = fitted(it)
    program, kept = it.program(found.present)
    gap = it.segments.spread
    short = it.evaluator.expand(program, found.theta[kept], NONE, found.x0, gap)
    whole = it.whole
    assert short.cost == pytest.approx(it.evaluator.expand(whole, found.theta, NONE, found.x0, gap).cost, rel=1e-12)
