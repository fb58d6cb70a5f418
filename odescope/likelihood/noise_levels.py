"""The two noises of a record, of averages and of defects, by scoring on their marginal likelihood.

Around a fit the segments are a linear Gaussian system in their initial states: its likelihood, integrated over these,
asks for factorisations of the states' block and for no integration of the equations. The noise is brought to its
maximum there, then coefficients and states are fitted anew. docs/method.md, Process noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.block_cholesky import noise_sums, state_covariances, substitute
from odescope.likelihood.expansion import correlated, eliminate
from odescope.likelihood.fit import Fit
from odescope.likelihood.kernel import Sums
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.segments import Segments

LEAST_NOISE = 1e-4  # of the first guess: standard deviations do not shrink below
CONVERGED = 0.02  # fall of the marginal cost, in units of chi-squared, that is not worth another step
ROUNDS = 10  # of noise and coefficients
TURNS = 10  # of noise and its correlations
FITS = 4  # Levenberg-Marquardt steps between two estimates of the noise
LONGEST = 10.0  # change of a variance in one step, at most, as a factor
LEAST_BEND = 1e-6  # of the gradient: second derivatives do not vanish
LARGEST_DAMPING = 1e6
ROUNDING = 1e-12  # of sums of squares, and of correlations, which are 1 where one force alone moves two states

NONE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class NoisePoint:
    """The marginal cost at some noise, and its expansion in the logarithms of the standard deviations.

    `marginal` is -2 log of the likelihood, integrated over the initial states, less a constant. Shapes, for c channels
    and n states: logs (c + n,) of the noise of averages, then of defects; gradient (c + n,); information (c + n, c + n)
    the average of the observed and the expected one; change (J, n) of the initial states to the most likely ones;
    own and following (J, n, n) as `state_covariances` returns them.
    """

    logs: FloatArray
    marginal: float
    gradient: FloatArray
    information: FloatArray
    change: FloatArray
    own: FloatArray
    following: FloatArray


@dataclass(frozen=True, eq=False)
class LinearRecord:
    """Segments around a fit, of states whose defects are independent: every channel by itself, for unit noise.

    Shapes: x0 (J, n); cost (c,); gradient (c, J, n); hessian (c, J, n, n); last (J, n) and jacobian (J, n, n) as in
    `Sums`; decorrelation (n, n) leads to these states from those of the fit.
    """

    segments: Segments
    decorrelation: FloatArray
    x0: FloatArray
    cost: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    last: FloatArray
    jacobian: FloatArray

    @staticmethod
    def of(space: SearchSpace, found: Fit) -> LinearRecord | None:
        """Return the record around a fit, None where that cannot be integrated."""
        segments, channels = space.segments, len(space.segments.noise)
        program, theta, parts = space.program(found.present), found.theta[found.present], list[Sums]()
        for c in range(channels):
            alone = np.where(np.arange(channels) == c, 1.0, np.inf)
            only = space.on(replace(segments, noise=alone))
            parts.append(only.evaluator.integrate(program, theta, NONE, found.x0))
        end, own = parts[0], segments.decorrelation
        if not np.isfinite(end.last).all() or not all(np.isfinite(p.cost.sum()) for p in parts):
            return None
        here = LinearRecord(
            segments,
            np.eye(found.x0.shape[1]),
            found.x0,
            np.array([p.cost.sum() for p in parts]),
            np.array([p.gradient for p in parts]),
            np.array([p.hessian for p in parts]),
            end.last,
            end.jacobian,
        )
        return here if own is None else here.decorrelated(own)

    def decorrelated(self, parts: FloatArray) -> LinearRecord:
        """Return the record of the states R x instead of x, R (n, n) being `parts`."""
        back = np.linalg.inv(parts)
        return replace(
            self,
            decorrelation=parts @ self.decorrelation,
            x0=self.x0 @ parts.T,
            gradient=self.gradient @ back,
            hessian=back.T @ self.hessian @ back,
            last=self.last @ parts.T,
            jacobian=parts @ self.jacobian @ back,
        )

    def at(self, logs: FloatArray) -> NoisePoint | None:
        """Return the marginal cost at this noise (c + n,), None where the states' block is singular or all rounding."""
        channels, n, joined = len(self.cost), self.x0.shape[1], self.segments.joined
        precision, spread = np.exp(-2.0 * logs), np.exp(logs[channels:])
        gradient = np.einsum("c,cji->ji", precision[:channels], self.gradient)
        # Laid out as the kernel leaves it: another layout would compile all that takes it once more.
        hessian = np.ascontiguousarray(np.einsum("c,cjik->jik", precision[:channels], self.hessian))
        sums = Sums(self.cost, gradient, hessian, np.zeros((0, 0)), self.last, self.jacobian)
        eliminated = eliminate(sums, self.x0, joined, spread, 0.0)
        if eliminated is None:
            return None
        factor, border, carry = eliminated.factor, eliminated.border, eliminated.carry
        change = substitute(factor, border, carry, joined, np.zeros(0))
        own, following = state_covariances(factor, carry, joined)
        defect = self.last - np.roll(self.x0, -1, axis=0)
        squares, known, through = noise_sums(
            precision,
            self.cost,
            self.gradient,
            self.hessian,
            self.jacobian,
            defect,
            joined,
            change,
            factor,
            carry,
            own,
            following,
        )
        if not (squares[:channels] >= ROUNDING * precision[:channels] * self.cost).all():
            return None  # of a fit that ran away: what is left of its squares is their rounding
        counted = np.concatenate([self.segments.counted, np.full(n, joined.sum())])
        return NoisePoint(
            logs,
            float(squares.sum() + eliminated.log_det + 2.0 * counted @ logs),
            2.0 * (counted - squares - known),
            4.0 * (np.diag(squares) - through),
            change,
            own,
            following,
        )

    def products(self, here: NoisePoint) -> FloatArray:
        """Return the mean products (n, n) of the defects: the most likely states' own, and their covariance."""
        joints = np.flatnonzero(self.segments.joined)
        ends = self.jacobian[joints]
        across, after = ends.transpose(0, 2, 1), here.following[joints] @ ends.transpose(0, 2, 1)
        left = self.last[joints] + np.einsum("jik,jk->ji", ends, here.change[joints])
        left -= self.x0[joints + 1] + here.change[joints + 1]
        spread = here.own[joints + 1] + ends @ here.own[joints] @ across - after - after.transpose(0, 2, 1)
        products: FloatArray = (left.T @ left + spread.sum(axis=0)) / max(len(joints), 1)
        return products

    def most_likely(self, begun: NoisePoint, least: FloatArray) -> NoisePoint:
        """Return the least marginal cost around this fit.

        Args:
            begun: where to begin.
            least: (c + n,) logarithms of the standard deviations that are the smallest possible.
        """
        here, damping = begun, 1e-3
        while damping < LARGEST_DAMPING:
            step, gain = _step(here, least, damping)
            if gain < 0.1 * CONVERGED:
                break
            trial = self.at(here.logs + step)
            if trial is not None and trial.marginal < here.marginal:
                here, damping = trial, damping / 10.0
            else:
                damping *= 10.0
        return here


def _step(here: NoisePoint, least: FloatArray, damping: float) -> tuple[FloatArray, float]:
    """Return a step of the logarithms (c + n,), and the fall of the marginal cost that the expansion makes of it.

    Scoring in the variances, because of two noises that the record hardly parts it knows the sum; within a box, because
    a noise that is far too large has next to no information. What all but vanishes stays: nothing is gained from it.
    """
    low = np.maximum(np.exp(2.0 * (least - here.logs)), 1.0 / LONGEST) - 1.0
    able = (np.abs(here.gradient) > CONVERGED) & ((low < 0.0) | (here.gradient < 0.0))
    change = np.zeros(len(low))
    if not able.any():
        return change, 0.0
    gradient, information = 0.5 * here.gradient[able], 0.25 * here.information[np.ix_(able, able)]
    diagonal = np.abs(np.diag(information))
    try:
        root = np.linalg.cholesky(information + np.diag(damping * diagonal + LEAST_BEND * np.abs(gradient)))
    except np.linalg.LinAlgError:
        return change, np.inf  # far from any maximum the cost may bend the other way: more damping makes up for it
    box = np.minimum(low[able], -LEAST_BEND), LONGEST - 1.0
    change[able] = lsq_linear(root.T, -np.linalg.solve(root, gradient), box, method="bvls").x
    change = np.maximum(change, low)
    gain = -change[able] @ (gradient + 0.5 * information @ change[able])
    return 0.5 * np.log1p(change), float(gain)


def with_noise(
    space: SearchSpace, measurement: FloatArray, process: FloatArray, decorrelation: FloatArray | None = None
) -> SearchSpace:
    """Return the space that weighs by these standard deviations; its `spread` is then that of a defect.

    Args:
        space: data and candidates.
        measurement: (c,) of an average.
        process: (n,) of a defect's independent parts.
        decorrelation: (n, n) that these parts are made by, None where a defect has the states' own.
    """
    return space.on(replace(space.segments, noise=measurement, spread=process, decorrelation=decorrelation))


def estimate_noise(space: SearchSpace, found: Fit) -> tuple[SearchSpace, Fit, float]:
    """Estimate both noises around a structure, not below the floor of the segments; return space, fit, marginal cost.

    Args:
        space: data and candidates, with a first guess of the noise.
        found: the structure, fitted with that.
    """
    channels, floor = len(space.segments.noise), space.segments.floor
    least = _logs(space) + np.log(LEAST_NOISE)
    if floor is not None:
        least[:channels] = np.maximum(least[:channels], np.log(np.maximum(floor, 1e-300)))
    best = space, found, np.inf
    for _ in range(ROUNDS):
        record = LinearRecord.of(space, found)
        here = None if record is None else record.at(np.maximum(_logs(space), least))
        if record is None or here is None or not here.marginal < best[2]:
            break
        fall, best = best[2] - here.marginal, (space, found, here.marginal)
        record, there = _most_likely(record, here, least, np.flatnonzero(space.frame.following < 0))
        if min(fall, here.marginal - there.marginal) < CONVERGED:
            break
        change = correlated(there.change, record.decorrelation)
        parts = None if np.array_equal(record.decorrelation, np.eye(len(change.T))) else record.decorrelation
        space = with_noise(space, np.exp(there.logs[:channels]), np.exp(there.logs[channels:]), parts)
        again = space.again(found, found.x0 + change, space.segments.spread, FITS)
        if again is None:
            break
        found = again
    return best


def _most_likely(
    record: LinearRecord, here: NoisePoint, least: FloatArray, driven: IntArray
) -> tuple[LinearRecord, NoisePoint]:
    """Return the least marginal cost around a fit, and the record of the states whose defects are then independent.

    One force moves all that it is coupled to. Expectation and maximisation say where to go with the correlations, and
    how far at least; the less a record shows of a single defect, the further it is. Where there were none they stay
    only if they are worth the price of as many numbers.

    Args:
        record: around the fit.
        here: its noise.
        least: (c + n,) logarithms of the standard deviations that are the smallest possible.
        driven: states whose derivatives are targets. Others are left as they are: what their defects hold is what a
            kick within a segment makes of them.
    """
    here = record.most_likely(here, least)
    bar = here.marginal
    if np.array_equal(record.decorrelation, np.eye(here.change.shape[1])):
        bar -= 0.5 * len(driven) * (len(driven) - 1) * float(np.log(record.segments.samples))
    alone = record, here
    for _ in range(TURNS if len(driven) > 1 else 0):
        step, further, begun = _correlations(record.products(here), driven), 1.0, here.marginal
        while True:
            moved = record.decorrelated(np.eye(len(step)) + further * step)
            trial = moved.at(here.logs)
            if trial is None or not trial.marginal < here.marginal:
                break
            best, here, further = moved, trial, 2.0 * further
        if further == 1.0:
            break
        record, here = best, best.most_likely(here, least)
        if begun - here.marginal < CONVERGED:
            break
    return (record, here) if here.marginal < bar else alone


def _correlations(products: FloatArray, driven: IntArray) -> FloatArray:
    """Return what makes independent parts of defects (n, n), less the unit matrix, by the products of some states'."""
    among, parts = products[np.ix_(driven, driven)], np.zeros_like(products)
    size = np.sqrt(np.diag(among))
    root = np.linalg.cholesky(among / size / size[:, None] + ROUNDING * np.eye(len(driven)))
    parts[np.ix_(driven, driven)] = np.linalg.inv(root / np.diag(root)) / size * size[:, None] - np.eye(len(driven))
    return parts


def _logs(space: SearchSpace) -> FloatArray:
    """Return the logarithms (c + n,) of both noises."""
    logs: FloatArray = np.log(np.concatenate([space.segments.noise, space.segments.spread]))
    return logs
