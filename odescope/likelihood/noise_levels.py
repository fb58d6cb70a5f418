"""The two noises of a record, of averages and of defects, by scoring on their marginal likelihood.

Around a fit the segments are a linear Gaussian system in their initial states, so its likelihood, integrated over these,
costs no integration: only factorisations of the states' block. The noise is brought to its maximum there, and coefficients
and states are fitted anew. docs/method.md, Process noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.block_cholesky import eliminate, state_covariances, substitute
from odescope.likelihood.fit import Fit
from odescope.likelihood.kernel import Sums
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments

LEAST_NOISE = 1e-4  # of the first guess: standard deviations do not shrink below
CONVERGED = 0.02  # fall of the marginal cost, in units of chi-squared, that is not worth another step
ROUNDS = 10  # of noise and coefficients
FITS = 4  # Levenberg-Marquardt steps between two estimates of the noise
STEPS = 40  # of the noise around one fit
STRIDE = 3.0  # change of a standard deviation in one step, at most, as a factor
LARGEST_DAMPING = 1e6

NONE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class NoisePoint:
    """The marginal cost at some noise, and its expansion in the logarithms of the standard deviations.

    `marginal` is -2 log of the likelihood, integrated over the initial states, less a constant. Shapes, for c channels
    and n states: logs (c + n,) of the noise of averages, then of defects; gradient (c + n,); information (c + n, c + n)
    the average of the observed and the expected one; change (J, n) of the initial states to the most likely ones.
    """

    logs: FloatArray
    marginal: float
    gradient: FloatArray
    information: FloatArray
    change: FloatArray


@dataclass(frozen=True, eq=False)
class LinearRecord:
    """Segments around a fit: every channel by itself, for averages of unit noise.

    Shapes: cost (c,); gradient (c, J, n); hessian (c, J, n, n); samples (c,) how many averages; last, jacobian as in
    `Sums`; x0 (J, n); joined (J,); ties those of the segments that are joined to the next.
    """

    segments: Segments
    x0: FloatArray
    cost: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    last: FloatArray
    jacobian: FloatArray
    samples: FloatArray
    ties: IntArray

    @staticmethod
    def of(space: SearchSpace, found: Fit) -> LinearRecord | None:
        """Return the record around a fit, None where that cannot be integrated."""
        segments, channels = space.segments, len(space.segments.noise)
        program, theta, parts = space.program(found.present), found.theta[found.present], list[Sums]()
        for c in range(channels):
            alone = np.where(np.arange(channels) == c, 1.0, np.inf)
            only = space.on(replace(segments, noise=alone))
            parts.append(only.evaluator.integrate(program, theta, NONE, found.x0))
        end = parts[0]
        if not np.isfinite(end.last).all() or not all(np.isfinite(p.cost.sum()) for p in parts):
            return None
        return LinearRecord(
            segments,
            found.x0,
            np.array([p.cost.sum() for p in parts]),
            np.array([p.gradient for p in parts]),
            np.array([p.hessian for p in parts]),
            end.last,
            end.jacobian,
            np.array([_count(segments, c) for c in range(channels)]),
            np.flatnonzero(segments.joined),
        )

    def at(self, logs: FloatArray) -> NoisePoint | None:
        """Return the marginal cost at this noise (c + n,), None where the states' block is singular."""
        channels, n, ties, joined = len(self.cost), self.x0.shape[1], self.ties, self.segments.joined
        precision, spread = np.exp(-2.0 * logs), np.exp(logs[channels:])
        data, process = precision[:channels], precision[channels:]
        gradient = np.tensordot(data, self.gradient, 1)
        hessian = np.tensordot(data, self.hessian, 1)
        sums = Sums(self.cost, gradient, hessian, self.last, self.jacobian)
        found = eliminate(sums, self.x0, joined, spread, 0.0)
        if not found.positive:
            return None
        change = substitute(found.factor, found.border, found.carry, joined, np.zeros(0))
        own, following = state_covariances(found.factor, found.carry, joined)
        bent = np.einsum("cjik,jk->cji", self.hessian, change)
        across = self.jacobian[ties]
        defects = self.last[ties] - self.x0[ties + 1] + np.einsum("jik,jk->ji", across, change[ties]) - change[ties + 1]
        seen = self.cost + np.einsum("cji,ji->c", 2.0 * self.gradient + bent, change)
        squares = precision * np.concatenate([seen, (defects**2).sum(axis=0)])
        apart = np.einsum("jik,jkl,jil->i", across, own[ties], across, optimize=True)
        apart += np.einsum("jii->i", own[ties + 1]) - 2.0 * np.einsum("jik,jik->i", across, following[ties])
        known = precision * np.concatenate([np.einsum("cjik,jki->c", self.hessian, own, optimize=True), apart])
        # What each noise leaves of the gradient with respect to the states, through the inverse of their block.
        edges = np.zeros((len(change), n + len(logs), n + len(logs)))
        edges[:, :n, :n] = hessian
        edges[:, :n, n : n + channels] = np.einsum("c,cji->jic", data, self.gradient + bent)
        edges[ties, :n, n + channels :] = np.einsum("i,jik,ji->jki", process, across, defects)
        edges[np.ix_(ties + 1, np.arange(n), n + channels + np.arange(n))] -= (process * defects)[:, :, None] * np.eye(n)
        wide = np.zeros((len(change), n, n + len(logs)))
        wide[:, :, :n] = self.jacobian
        through = eliminate(
            Sums(self.cost, np.zeros(edges.shape[:2]), edges, self.last, wide), self.x0, joined, spread, 0.0
        )
        counted = np.concatenate([self.samples, np.full(n, len(ties))])
        return NoisePoint(
            logs,
            float(squares.sum() + found.log_det + 2.0 * counted @ logs),
            2.0 * (counted - squares - known),
            4.0 * (np.diag(squares) + through.information),
            change,
        )

    def most_likely(self, begun: NoisePoint, least: FloatArray) -> NoisePoint:
        """Return the least marginal cost around this fit.

        Args:
            begun: where to begin.
            least: (c + n,) logarithms of the standard deviations that are the smallest possible.
        """
        here, damping = begun, 1e-3
        for _ in range(STEPS):
            trial = self.at(np.maximum(here.logs + _step(here, least, damping), least))
            fall = -np.inf if trial is None else here.marginal - trial.marginal
            if trial is not None and fall > 0.0:
                here, damping = trial, damping / 10.0
            else:
                damping *= 10.0
            if 0.0 <= fall < CONVERGED / 10.0 or damping > LARGEST_DAMPING:
                break
        return here


def _step(here: NoisePoint, least: FloatArray, damping: float) -> FloatArray:
    """Return the step of the logarithms (c + n,); those at their least stay there if they would fall further."""
    scale = np.sqrt(np.diag(here.information))
    able = (scale > 0.0) & ((here.logs > least) | (here.gradient < 0.0))
    step, scale = np.zeros(len(here.logs)), scale[able]
    if able.any():
        information = here.information[np.ix_(able, able)] / scale / scale[:, None]
        solved = np.linalg.solve(information + damping * np.eye(len(scale)), -here.gradient[able] / scale)
        step[able] = np.clip(solved / scale, -np.log(STRIDE), np.log(STRIDE))
    return step


def _count(segments: Segments, channel: int) -> int:
    """Return how many averages of a channel the segments see."""
    if segments.weight is None:
        return int(segments.count.sum())
    there = np.concatenate([[0], np.cumsum(segments.weight[:, channel] > 0.0)])
    return int((there[segments.start + segments.count] - there[segments.start]).sum())


def with_noise(space: SearchSpace, measurement: FloatArray, process: FloatArray) -> SearchSpace:
    """Return the space that weighs by these standard deviations; its `spread` is then that of a defect.

    Args:
        space: data and candidates.
        measurement: (c,) of an average.
        process: (n,) of a defect.
    """
    return space.on(replace(space.segments, noise=measurement, spread=process))


def marginal_cost(space: SearchSpace, found: Fit) -> float:
    """Return -2 log of the likelihood of a fit, integrated over its initial states, less a constant."""
    record = LinearRecord.of(space, found)
    point = None if record is None else record.at(_logs(space))
    return np.inf if point is None else point.marginal


def estimate_noise(
    space: SearchSpace, found: Fit, floor: FloatArray | None = None
) -> tuple[SearchSpace, Fit, float]:
    """Estimate both noises around a structure; return space, fit and marginal cost.

    Args:
        space: data and candidates, with a first guess of the noise.
        found: the structure, fitted with that.
        floor: (c,) least standard deviations of an average; a small part of the first guess by default.
    """
    channels = len(space.segments.noise)
    least = _logs(space) + np.log(LEAST_NOISE)
    if floor is not None:
        least[:channels] = np.log(floor)
    best = space, found, np.inf
    for _ in range(ROUNDS):
        record = LinearRecord.of(space, found)
        here = None if record is None else record.at(np.maximum(_logs(space), least))
        if record is None or here is None or not here.marginal < best[2]:
            break
        fall, best = best[2] - here.marginal, (space, found, here.marginal)
        there = record.most_likely(here, least)
        if min(fall, here.marginal - there.marginal) < CONVERGED:
            break
        space = with_noise(space, np.exp(there.logs[:channels]), np.exp(there.logs[channels:]))
        again = space.again(found, found.x0 + there.change, space.segments.spread, FITS)
        if again is None:
            break
        found = again
    return best


def _logs(space: SearchSpace) -> FloatArray:
    """Return the logarithms (c + n,) of both noises."""
    logs: FloatArray = np.log(np.concatenate([space.segments.noise, space.segments.spread]))
    return logs
