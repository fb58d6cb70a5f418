"""Process noise, against dense Gaussians in numpy and over seeds of systems simulated here."""

from dataclasses import replace

import numpy as np
import pytest
from process_cases import (
    NONE,
    cut,
    discrete,
    fitted,
    kicked,
    matrices,
    space,
    spring,
    white_kicks,
)
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from small_systems import CART, System, drive

from odescope.likelihood.block_cholesky import state_covariances
from odescope.likelihood.expansion import decorrelated, eliminate
from odescope.likelihood.fit import fit
from odescope.likelihood.kernel import Sums
from odescope.likelihood.noise_levels import LinearRecord, estimate_noise, with_noise
from odescope.likelihood.noise_or_terms import cost_without_process_noise
from odescope.likelihood.search import Outcome
from odescope.recordings.coordinate import Coordinate

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


def masses(seed, sigma, q, lengths, kicks=None):
    rng = np.random.default_rng(seed)
    nodes = drive(sum(lengths))
    kicks = white_kicks(rng, np.array(q), lengths) if kicks is None else kicks
    states = np.concatenate(
        [
            kicked(MASSES, MASSES.theta, nodes[low : low + n], kicks[low : low + n], [0.5, 0.0, -0.3, 0.4])
            for low, n in zip(np.cumsum([0, *lengths[:-1]]), lengths, strict=True)
        ]
    )
    measured = states[:, [0, 1]] + sigma * rng.standard_normal((len(states), 2))
    return space(MASSES, cut(states, measured, nodes, sigma, q, lengths))


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
    hessian = np.ascontiguousarray(np.einsum("jki,jkl->jil", roots, roots))
    joined = rng.random(segments) < 0.7
    joined[-1] = False
    gap = rng.uniform(0.3, 2.0, n)
    zeros = np.zeros((segments, n))
    sums = Sums(np.zeros(segments), zeros, hessian, np.zeros((0, 0)), zeros, jacobian)
    expansion = eliminate(sums, zeros, joined, gap, 0.0)
    whole = dense_states_hessian(hessian, jacobian, joined, gap)
    assert expansion.log_det == pytest.approx(np.linalg.slogdet(whole)[1], rel=1e-10)
    assert_blocks_of_the_inverse(*state_covariances(expansion.factor, expansion.carry, joined), whole, joined)


@pytest.mark.parametrize("system", [CART, MASSES], ids=["cart", "masses"])
def test_covariances_of_a_record_are_blocks_of_the_dense_inverse(system):
    rng = np.random.default_rng(0)
    lengths, gap = (20, 33), np.array([0.02, 0.03, 0.1, 0.2])
    x0, nodes = 0.3 * rng.standard_normal((53, 4)), drive(53)
    it = space(system, cut(x0, x0[:, :2].copy(), nodes, [0.02, 0.05], gap, lengths)).evaluator
    theta, joined, start = system.theta, it.segments.joined, it.segments.initial
    assert not joined.all()
    for free in (NONE, system.free):
        integrated = it.integrate(system.program, theta, free, start)
        found = it.expand(system.program, theta, free, start, gap, 0.0, integrated)
        whole = dense_states_hessian(integrated.hessian, integrated.jacobian, joined, gap)
        assert_blocks_of_the_inverse(*state_covariances(found.factor, found.carry, joined), whole, joined)


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
        v = kicks @ np.kron(np.eye(kicks.shape[1] // n), np.diag(np.square(q)) if np.ndim(q) == 1 else q) @ kicks.T
        v += np.diag(np.tile(np.array(sigma) ** 2, len(rest) // len(sigma)))
        factor = cho_factor(v, lower=True)
        precision = first.T @ cho_solve(factor, first)
        left = rest - first @ np.linalg.solve(precision, first.T @ cho_solve(factor, rest))
        total += left @ cho_solve(factor, left) + 2 * np.log(np.diag(factor[0])).sum() + np.linalg.slogdet(precision)[1]
    return total


def marginal_cost(it, found):
    """Return -2 log of the likelihood of a fit, integrated over its initial states, less a constant."""
    return LinearRecord.of(it, found).at(np.log([*it.segments.noise, *it.segments.spread])).marginal


def linear_record(it, system, theta, sigma, q, decorrelation=None):
    """Return the record around a model that is given, its states fitted, and the logarithms of the noise."""
    moved = with_noise(it, np.array(sigma, dtype=float), np.array(q, dtype=float), decorrelation)
    everything = np.arange(len(theta))
    settled = fit(moved.evaluator, system.program, theta, everything, moved.segments.initial, moved.segments.spread)
    assert settled is not None
    return LinearRecord.of(moved, replace(settled, present=everything)), np.log([*sigma, *q])


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
    ours = []
    for setting in settings:
        record, logs = linear_record(it, MASSES, *setting)
        ours.append(record.at(logs).marginal)
    ours = np.array(ours)
    dense = np.array([dense_cost(linear_maps(it, MASSES, theta), sigma, q) for theta, sigma, q in settings])
    assert np.ptp(dense) > 500.0
    # RK4 at half a step against the exponential is what is left: parts in a million of costs of up to thousands.
    np.testing.assert_allclose(ours - ours[0], dense - dense[0], rtol=1e-5, atol=2e-3)


# A force that moves the second mass one and a half times as much as the first, and one on the second alone.
PARTS, APART = np.array([0.02, 0.03, 0.3, 0.1]), np.eye(4)
APART[3, 2] = -1.5


def covariance(parts, decorrelation):
    mixed = np.linalg.solve(decorrelation, np.diag(parts))
    return mixed @ mixed.T


def test_costs_of_defects_that_go_together_are_those_of_a_dense_gaussian():
    it = masses(0, np.array([0.02, 0.03]), PARTS, (60, 43))
    maps, sigma, ours, dense = linear_maps(it, MASSES, MASSES.theta), [0.02, 0.03], [], []
    for share in (0.0, 0.5, 1.0, -1.0):
        decorrelation = np.eye(4) + share * (APART - np.eye(4))
        record, logs = linear_record(it, MASSES, MASSES.theta, sigma, PARTS, decorrelation)
        ours.append(record.at(logs).marginal)
        dense.append(dense_cost(maps, sigma, covariance(PARTS, decorrelation)))
    assert np.ptp(dense) > 50.0
    np.testing.assert_allclose(np.array(ours) - ours[0], np.array(dense) - dense[0], rtol=1e-5, atol=2e-3)


def test_states_are_mixed_as_matrices_say():
    rng = np.random.default_rng(0)
    gradient, hessian, jacobian = rng.random((5, 7)), rng.random((5, 4, 7)), rng.random((5, 4, 7))
    sums = Sums(rng.random(5), gradient, hessian, rng.random((3, 3)), rng.random((5, 4)), jacobian)
    # Rounding leaves ones that are not quite ones, and 1e-15 where terms of size 1 cancel.
    for parts in (APART, APART + np.diag([0.0, -1e-16, 2e-16, 0.5])):
        mixed, x0 = decorrelated(sums, sums.last, parts)
        back = np.linalg.inv(parts)
        states = np.block([[back, np.zeros((4, 3))], [np.zeros((3, 4)), np.eye(3)]])
        np.testing.assert_allclose(mixed.gradient, gradient @ states, rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(mixed.hessian, back.T @ hessian @ states, rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(mixed.jacobian, parts @ jacobian @ states, rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(mixed.last, sums.last @ parts.T, rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(x0, sums.last @ parts.T, rtol=1e-13, atol=1e-15)


def test_where_nothing_but_rounding_is_left_of_the_squares_there_is_no_marginal_cost():
    it = masses(0, np.array([0.02, 0.03]), PARTS, (60, 43))
    record, logs = linear_record(it, MASSES, MASSES.theta, [0.02, 0.03], PARTS)
    assert record.at(logs) is not None
    assert replace(record, cost=np.zeros(2)).at(logs) is None


def test_without_process_noise_each_channel_has_its_own_whatever_it_was_taken_for():
    it, costs = masses(0, np.array([0.02, 0.03]), PARTS, (600,), np.zeros((600, 4))), []
    for times in ([1.0, 1.0], [2.5, 1.0]):
        told = with_noise(it, it.segments.noise * times, it.segments.spread)
        joined = told.fit(MASSES.theta, np.arange(9), told.segments.initial, 1e-3 * told.segments.spread)
        scale = joined.data_cost / told.segments.samples
        outcome = Outcome(joined, 1e-3, scale, told.penalty[joined.free], told.price(joined), (), True, False, 0.0)
        costs.append(cost_without_process_noise(told, outcome))
    assert costs[1] == pytest.approx(costs[0], abs=3.0)  # with one scale for both it is hundreds more


def test_what_one_force_does_to_two_masses_is_found_without_bias():
    sigma, ratios, spreads, fell = 0.01, [], [], []
    for seed in range(12):
        rng = np.random.default_rng(500 + seed)
        kicks = np.linalg.solve(APART, white_kicks(rng, PARTS, (600,)).T).T
        it = masses(seed, np.array([sigma, sigma]), PARTS, (600,), kicks)
        here = it.fit(MASSES.theta, np.arange(9), it.segments.initial, it.segments.spread)
        ended, found, marginal = estimate_noise(it, here)
        alone = with_noise(ended, ended.segments.noise, ended.segments.spread * [1.0, 1.0, 1.0, 4.6])
        fell.append(marginal_cost(alone, found) - marginal)
        ratios.append(ended.segments.decorrelation[3, 2])
        spreads.append(ended.segments.spread[2:] / PARTS[2:])
        np.testing.assert_allclose(ended.segments.decorrelation[:3], np.eye(4)[:3], atol=1e-9)
    assert np.mean(ratios) == pytest.approx(APART[3, 2], abs=3.5 * np.std(ratios, ddof=1) / np.sqrt(12))
    assert np.std(ratios) < 0.08
    # Nine coefficients and a correlation take 10 of the 240 kicks: half of that from a standard deviation.
    lost, scatter = 10 / 480, np.std(spreads, axis=0, ddof=1)
    assert np.all(scatter < [0.08, 0.17])
    assert np.all(np.abs(np.mean(spreads, axis=0) - 1.0 + lost) < 3.5 * scatter / np.sqrt(12) + lost)
    assert min(fell) > 50.0


def test_gradient_and_information_of_the_noise_are_those_of_the_dense_likelihood():
    sigma, q = np.array([0.01, 0.02]), np.array([0.04, 0.06, 0.3, 0.4])
    it = masses(1, sigma, q, (60, 45))
    maps = linear_maps(it, MASSES, MASSES.theta)

    def cost(logs):
        return dense_cost(maps, *np.split(np.exp(logs), [2]))

    for factors in (np.ones(6), np.array([0.7, 1.4, 1.3, 0.8, 0.6, 1.5])):
        record, logs = linear_record(it, MASSES, MASSES.theta, sigma * factors[:2], q * factors[2:])
        point = record.at(logs)
        steps = 1e-3 * np.eye(6)
        slopes = [(cost(logs + s) - cost(logs - s)) / 2e-3 for s in steps]
        np.testing.assert_allclose(point.gradient, slopes, rtol=1e-3, atol=1e-2)
        # Of the second derivative in a direction the average leaves out the traces, which it replaces by squares.
        assert np.all(np.linalg.eigvalsh(point.information) > 0.0)


def test_information_of_the_noise_is_right_on_average():
    sigma, q = np.array([0.01, 0.02]), np.array([0.04, 0.06, 0.3, 0.4])
    gradients, information = [], 0.0
    for seed in range(150):
        it = masses(1000 + seed, sigma, q, (60,))
        record, logs = linear_record(it, MASSES, MASSES.theta, sigma, q)
        point = record.at(logs)
        gradients.append(point.gradient)
        information = information + point.information / 150
    # The gradient is that of -2 log of the likelihood, so its covariance is twice the expected second derivative.
    scale = np.sqrt(np.diag(information))
    expected = information / scale / scale[:, None]
    np.testing.assert_allclose(np.cov(np.array(gradients).T) / 2.0 / scale / scale[:, None], expected, atol=0.4)


def test_the_likeliest_noise_is_that_of_the_dense_likelihood():
    sigma, q = np.array([0.01, 0.02]), np.array([0.04, 0.06, 0.3, 0.4])
    it = masses(1, sigma, q, (60, 45))
    maps = linear_maps(it, MASSES, MASSES.theta)
    best = minimize(
        lambda z: dense_cost(maps, *np.split(np.exp(z), [2])), np.log([*sigma, *q]), method="BFGS",
        options={"gtol": 1e-3},
    )  # fmt: skip
    for factor in (0.1, 10.0):
        record, logs = linear_record(it, MASSES, MASSES.theta, factor * sigma, factor * q)
        found = record.most_likely(record.at(logs), np.full(6, -np.inf))
        np.testing.assert_allclose(found.logs, best.x, atol=0.02)
    floor = np.where(np.arange(6) == 0, best.x[0] + 0.5, -np.inf)
    found = record.most_likely(record.at(np.maximum(logs, floor)), floor)
    assert found.logs[0] == floor[0]
    assert np.all(np.abs(record.at(found.logs).gradient[1:]) < 1.0)


def own_maximum(it):
    """Return the least marginal cost over both noises, coefficients fitted, found by SciPy."""

    def cost(z):
        moved = with_noise(it, it.segments.noise * np.exp(z[0]), it.segments.spread * np.exp(z[1:]))
        return marginal_cost(moved, fitted(moved))

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
    assert marginal == marginal_cost(ended, found)


def test_noise_estimated_from_below_is_the_maximum_of_the_marginal_likelihood():
    it = spring(0, q=[0.01, 0.08])
    begun = with_noise(it, 3.0 * it.segments.noise, [0.3, 3.0] * it.segments.spread)
    truth = marginal_cost(it, fitted(it))
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
