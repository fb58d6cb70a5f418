from dataclasses import replace

import numpy as np
import pytest
from small_systems import CART, RING, ROW, TIED_CART, TIED_RING, UPTAKE, drive

from odescope.likelihood.block_cholesky import substitute
from odescope.likelihood.evaluator import Evaluator
from odescope.likelihood.expansion import eliminate
from odescope.likelihood.kernel import LANES, Sums
from odescope.likelihood.segments import Segments

CASES = {
    "order 1, rational": (UPTAKE, [[0.4], [1.5], [0.1]]),
    "order 2, Lagrange": (CART, [[0.1, 2.5, -0.4, 1.0], [0.0, -0.3, 0.2, -3.0], [0.5, 3.3, 1.0, 4.0]]),
    "three targets in a ring": (RING, [[0.6, -0.4, 0.8], [0.3, 0.5, -0.5], [-0.4, 0.2, 0.3]]),
    "three targets apart": (ROW, [[0.6, -0.4, 0.8], [0.3, 0.5, -0.5], [-0.4, 0.2, 0.3]]),
}


def segments(system, nodes, measured, start, count, step):
    joined = np.zeros(len(start), dtype=bool)
    noise = 0.1 * 2.0 ** np.arange(measured.shape[1])
    n = len(system.following)
    return Segments(
        measured, nodes, np.zeros((len(measured), n)), start, count, joined, noise, np.ones(n), step, 1, ()
    )  # fmt: skip


def by_segment(sums):
    """Return what there is of every segment: cost, gradient, hessian, last, jacobian."""
    return sums.cost, sums.gradient, sums.hessian, sums.last, sums.jacobian


def differences(system, x0, nodes, step):
    """Return the states of a segment and their central differences with respect to x0 and the free coefficients."""
    here = np.concatenate([x0, system.theta[system.free]])

    def run(z):
        theta = system.theta.copy()
        theta[system.free] = z[len(x0) :]
        return system.trajectory(theta, z[: len(x0)], nodes, step)

    columns = []
    for k in range(len(here)):
        moved = 1e-5 * np.eye(len(here))[k]
        columns.append((run(here + moved) - run(here - moved)) / 2e-5)
    return run(here), np.stack(columns, axis=-1)


@pytest.mark.parametrize("hold", ["linear", "zero"])
@pytest.mark.parametrize("name", CASES)
def test_segments_agree_with_finite_differences_of_tightly_solved_trajectories(name, hold):
    system, starts = CASES[name]
    rng = np.random.default_rng(5)
    step, count = 0.04, np.array([4, 7, 5])
    start = np.array([0, 4, 11])
    nodes = drive(16, step, len(system.inputs))
    if hold == "zero":
        nodes = np.repeat(nodes[:, :1], 3, axis=1)
    else:
        nodes[:, 1] = 0.5 * (nodes[:, 0] + nodes[:, 2])
    measured = rng.standard_normal((16, len(system.measured)))
    data = segments(system, nodes, measured, start, count, step)
    found = Evaluator(data, substeps=8).integrate(system.program, system.theta, system.free, np.array(starts))
    n, inner = len(starts[0]), np.zeros_like(found.inner)
    for j, (cost, gradient, hessian, last, jacobian) in enumerate(zip(*by_segment(found), strict=True)):
        rows = slice(start[j], start[j] + count[j])
        states, slopes = differences(system, np.array(starts[j]), nodes[rows], step)
        error = (states[:-1, system.measured] - measured[rows]) / data.noise
        weighed = (slopes[:-1, system.measured] / data.noise[:, None]).reshape(-1, slopes.shape[-1])
        np.testing.assert_allclose(cost, np.sum(error**2), rtol=1e-7)
        np.testing.assert_allclose(gradient, weighed.T @ error.ravel(), rtol=1e-5, atol=1e-5 * np.abs(gradient).max())
        whole = weighed.T @ weighed
        np.testing.assert_allclose(hessian, whole[:n], rtol=1e-5, atol=1e-7 * np.abs(hessian).max())
        np.testing.assert_allclose(last, states[-1], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(jacobian, slopes[-1], rtol=1e-5, atol=1e-6)
        inner += whole[n:, n:]
    np.testing.assert_allclose(found.inner, inner, rtol=1e-5, atol=1e-7 * np.abs(inner).max())


TIED = {
    "order 2, Lagrange": (TIED_CART, [1, 2, 3, 5]),
    "three targets in a ring": (TIED_RING, [0, 1, 2, 4, 5]),
}


def random_data(system, rng):
    """Return three segments of noise under a smooth input."""
    nodes = drive(16, 0.04, len(system.inputs))
    measured = rng.standard_normal((16, len(system.measured)))
    return segments(system, nodes, measured, np.array([0, 4, 11]), np.array([4, 7, 5]), 0.04)


@pytest.mark.parametrize("name", TIED)
def test_tied_coefficients_have_the_chained_derivatives_of_the_untied(name):
    tied, free = TIED[name]
    system, starts = tied.system, np.array(CASES[name][1])
    evaluator = Evaluator(random_data(system, np.random.default_rng(6)))
    together = evaluator.integrate(tied.program, tied.theta, np.array(free), starts)
    apart = evaluator.integrate(system.program, system.theta, np.arange(len(system.theta)), starts)
    n = starts.shape[1]
    chain = np.zeros((n + len(system.theta), n + len(free)))
    chain[:n, :n], chain[n:, n:] = np.eye(n), tied.shares[:, free]
    np.testing.assert_allclose(together.cost, apart.cost, rtol=1e-12)
    np.testing.assert_allclose(together.last, apart.last, rtol=1e-12)
    np.testing.assert_allclose(together.jacobian, apart.jacobian @ chain, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(together.gradient, apart.gradient @ chain, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(together.hessian, apart.hessian @ chain, rtol=1e-9, atol=1e-9)
    tied_to = chain[n:, n:]
    np.testing.assert_allclose(together.inner, tied_to.T @ apart.inner @ tied_to, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", TIED)
def test_tied_coefficients_agree_with_finite_differences_of_tightly_solved_trajectories(name):
    tied, free = TIED[name]
    system, starts = tied.system, np.array(CASES[name][1])
    data = random_data(system, np.random.default_rng(7))
    found = Evaluator(data, substeps=8).integrate(tied.program, tied.theta, np.array(free), starts)
    inner = np.zeros_like(found.inner)
    for j, x0 in enumerate(starts):
        rows = slice(data.start[j], data.start[j] + data.count[j])

        def run(theta, x0=x0, rows=rows):
            return system.trajectory(tied.shares @ theta, x0, data.inputs[rows], data.step)

        moves = 1e-5 * np.eye(len(tied.theta))[free]
        slopes = np.stack([(run(tied.theta + m) - run(tied.theta - m)) / 2e-5 for m in moves], axis=-1)
        error = (run(tied.theta)[:-1, system.measured] - data.measured[rows]) / data.noise
        weighed = (slopes[:-1, system.measured] / data.noise[:, None]).reshape(-1, len(free))
        n, gradient = len(x0), weighed.T @ error.ravel()
        np.testing.assert_allclose(found.jacobian[j, :, n:], slopes[-1], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(found.gradient[j, n:], gradient, rtol=1e-5, atol=1e-5 * np.abs(gradient).max())
        inner += weighed.T @ weighed
    np.testing.assert_allclose(found.inner, inner, rtol=1e-5, atol=1e-7 * np.abs(inner).max())


@pytest.mark.parametrize("name", TIED)
def test_along_the_scale_of_all_relations_nothing_changes(name):
    tied, _ = TIED[name]
    starts, everything = np.array(CASES[name][1]), np.arange(len(tied.theta))
    evaluator = Evaluator(random_data(tied.system, np.random.default_rng(8)))
    one, larger = (evaluator.integrate(tied.program, c * tied.theta, everything, starts) for c in (1.0, -3.7))
    np.testing.assert_allclose(larger.last, one.last, rtol=1e-10)
    scale = np.abs(one.jacobian).max()
    np.testing.assert_allclose(one.jacobian[:, :, starts.shape[1] :] @ tied.theta, 0.0, atol=1e-12 * scale)


def test_halving_the_step_divides_the_error_by_sixteen():
    nodes = drive(16, 0.2)
    nodes[:, 1] = 0.5 * (nodes[:, 0] + nodes[:, 2])
    data = segments(CART, nodes, np.zeros((16, 2)), np.array([0]), np.array([15]), 0.2)
    start = np.array([[0.1, 2.5, -0.4, 1.0]])
    exact = CART.trajectory(CART.theta, start[0], nodes[:15], 0.2)[-1]
    error = [
        np.linalg.norm(Evaluator(data, k).integrate(CART.program, CART.theta, CART.free, start).last[0] - exact)
        for k in (8, 16, 32)
    ]
    assert 10 < error[0] / error[1] < 22
    assert 14 < error[1] / error[2] < 18


def test_a_segment_does_not_depend_on_its_lane_or_its_neighbours():
    rng = np.random.default_rng(1)
    many = 5 * LANES  # so that lanes take segments in, and are moved when there are no more
    count = rng.integers(2, 9, many)
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    nodes, measured = drive(count.sum(), 0.05), rng.standard_normal((count.sum(), 2))
    x0 = rng.standard_normal((many, 4))
    together = Evaluator(segments(CART, nodes, measured, start, count, 0.05)).integrate(
        CART.program, CART.theta, CART.free, x0
    )
    inner = np.zeros_like(together.inner)
    for j in range(many):
        rows = slice(start[j], start[j] + count[j])
        data = segments(CART, nodes[rows], measured[rows], np.array([0]), count[j : j + 1], 0.05)
        alone = Evaluator(data).integrate(CART.program, CART.theta, CART.free, x0[j : j + 1])
        for one, all_ in zip(by_segment(alone), by_segment(together), strict=True):
            np.testing.assert_allclose(one[0], all_[j], rtol=1e-11, atol=1e-11)
        inner += alone.inner
    np.testing.assert_allclose(inner, together.inner, rtol=1e-11)


def test_second_derivatives_that_only_overflow_between_threads_are_infinite_without_a_warning():
    rng, many = np.random.default_rng(2), 2 * LANES
    count, start = np.full(many, 3), 3 * np.arange(many)
    nodes, measured = drive(3 * many, 0.05), rng.standard_normal((3 * many, 2))
    data, x0 = segments(CART, nodes, measured, start, count, 0.05), rng.standard_normal((many, 4))
    usual = Evaluator(data).integrate(CART.program, CART.theta, CART.free, x0).inner.max()
    loud = replace(data, noise=data.noise * np.sqrt(usual / 2.0) / np.sqrt(1.2e308))  # 2.4e308 in all
    assert np.isinf(Evaluator(loud).integrate(CART.program, CART.theta, CART.free, x0).inner.max())


def problem(rng, segments_, n, p):
    width = n + p
    roots = rng.standard_normal((segments_, 2 * width, width))
    hessian = np.einsum("jkr,jkc->jrc", roots, roots)
    jacobian = rng.standard_normal((segments_, n, width))
    last, x0 = rng.standard_normal((2, segments_, n))
    gradient, inner = rng.standard_normal((segments_, width)), hessian[:, n:, n:].sum(axis=0)
    return Sums(np.zeros(segments_), gradient, hessian[:, :n], inner, last, jacobian), x0


def dense(sums, x0, joined, gap, damping):
    """Return matrix and right-hand side over all initial states, then the parameters, and the joints' cost."""
    _, gradient, hessian, inner, last, jacobian = sums
    j, n = x0.shape
    p = len(inner)
    matrix, rhs, cost = np.zeros((j * n + p, j * n + p)), np.zeros(j * n + p), 0.0
    matrix[j * n :, j * n :] = inner
    for k in range(j):
        own = np.arange(k * n, k * n + n)
        place = np.r_[own, j * n : j * n + p]
        matrix[np.ix_(own, place)] += hessian[k]
        matrix[np.ix_(place[n:], own)] += hessian[k, :, n:].T
        rhs[place] += gradient[k]
        if k + 1 < j and joined[k]:
            row = np.zeros((n, j * n + p))
            row[:, place] = jacobian[k]
            row[:, k * n + n : k * n + 2 * n] -= np.eye(n)
            row /= gap[:, None]
            error = (last[k] - x0[k + 1]) / gap
            matrix += row.T @ row
            rhs += row.T @ error
            cost += error @ error
    return matrix + damping * np.diag(np.diag(matrix)), rhs, cost


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("joined", ["none", "all", "two recordings"])
@pytest.mark.parametrize(("n", "p"), [(1, 1), (2, 0), (4, 7), (3, 2)])
def test_elimination_agrees_with_a_dense_system(n, p, joined, damping):
    rng = np.random.default_rng(10 * n + p)
    j = 9
    ties = np.full(j, joined != "none")
    ties[-1] = False
    if joined == "two recordings":
        ties[3] = False
    gap = np.exp(rng.standard_normal(n))
    parts = problem(rng, j, n, p)
    matrix, rhs, cost = dense(*parts, ties, gap, damping)
    expansion = eliminate(*parts, ties, gap, damping)
    states = slice(0, j * n), slice(j * n, None)
    block, edge = matrix[states[0], states[0]], matrix[states[0], states[1]]
    inner = np.linalg.solve(block, np.column_stack([edge, rhs[states[0]]]))
    assert expansion.defect_cost == pytest.approx(cost, rel=1e-12)
    assert expansion.log_det == pytest.approx(np.linalg.slogdet(block)[1], rel=1e-11)
    np.testing.assert_allclose(
        expansion.information, matrix[states[1], states[1]] - edge.T @ inner[:, :p], rtol=1e-8, atol=1e-9
    )
    np.testing.assert_allclose(expansion.gradient, rhs[states[1]] - edge.T @ inner[:, p], rtol=1e-8, atol=1e-9)
    step = -np.linalg.solve(matrix, rhs)
    change = substitute(
        expansion.factor, expansion.border, expansion.carry, ties, np.ascontiguousarray(step[states[1]])
    )
    np.testing.assert_allclose(change.ravel(), step[states[0]], rtol=1e-8, atol=1e-9)


def test_parameters_that_are_almost_alike_are_told_apart_where_segments_are_tied_closely():
    j, n, p, gap = 40, 2, 3, np.full(2, 1e-4)
    ties = np.arange(j) < j - 1
    sums, x0 = problem(np.random.default_rng(3), j, n, p)
    apart = eliminate(sums, x0, ties, gap, 0.0)
    warm = np.array([[1.0, 300.0, 9e4], [0.0, 1.0, 600.0], [0.0, 0.0, 1.0]])  # 1, T, T^2 of T = 300 + x, in x's
    whole = np.eye(n + p)
    whole[n:, n:] = warm
    alike = sums._replace(
        gradient=sums.gradient @ whole,
        hessian=sums.hessian @ whole,
        inner=warm.T @ sums.inner @ warm,
        jacobian=sums.jacobian @ whole,
    )
    back = np.linalg.inv(warm)
    found = eliminate(alike, x0, ties, gap, 0.0)
    np.testing.assert_allclose(back.T @ found.information @ back, apart.information, rtol=1e-3, atol=1e-3)


def test_parameters_whose_matrix_rounding_leaves_indefinite_are_taken_as_they_are():
    sums, x0 = problem(np.random.default_rng(1), 5, 2, 3)
    sums.inner[:] = 5.0
    sums.inner[1, 2] = sums.inner[2, 1] = 5.0 - 5e-9  # 0 is like 1 and like 2, but 1 is not like 2
    matrix, _, _ = dense(sums, x0, np.zeros(5, dtype=bool), np.ones(2), 0.0)
    schur = matrix[10:, 10:] - matrix[10:, :10] @ np.linalg.solve(matrix[:10, :10], matrix[:10, 10:])
    found = eliminate(sums, x0, np.zeros(5, dtype=bool), np.ones(2), 0.0)
    np.testing.assert_allclose(found.information, schur, rtol=1e-9, atol=1e-9)


def test_a_block_that_is_not_positive_definite_is_reported():
    parts = problem(np.random.default_rng(0), 4, 2, 1)
    parts[0].hessian[2, :2, :2] = [[1.0, 2.0], [2.0, 1.0]]
    assert eliminate(*parts, np.zeros(4, dtype=bool), np.ones(2), 0.0) is None


def test_a_block_that_is_not_a_number_is_reported():
    parts = problem(np.random.default_rng(0), 4, 2, 1)
    parts[0].hessian[1, 0, 0] = np.nan
    assert eliminate(*parts, np.zeros(4, dtype=bool), np.ones(2), 0.0) is None
