"""Process noise: the likelihood of a record that no model in the library follows exactly (METHOD section 9).

On a real rig the gaps between segments are not driven to zero: their widths are estimated together with the noise of
the measurement, by expectation-maximisation, and models compare by the marginal likelihood over the states. Gaps that a
missing term leaves are not white, so scores and variances are checked against those between blocks of the record.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.elimination import joint_covariances
from odescope.likelihood.evidence import Evidence, in_blocks, weigh
from odescope.likelihood.fit import Evaluator, Fit, Program
from odescope.likelihood.search import THIN, Move, Outcome, Searcher
from odescope.likelihood.segments import Segments

PIECES = (5, 2, 1)  # averages a segment: what a model lacks may change within a fraction of the shortest period
WORTH_FINER = 0.01  # fall of the marginal cost a sample that shorter segments must bring: they take longer
LARGEST_TABLE = 4e8  # bytes of the segments' Gauss-Newton matrices
FIFTH = 5  # one record in so many is held out from searches; of fewer records, that part of each
WINDOWS = 4  # free runs a stretch that is held out
EM_ITERATIONS = 30
EM_CONVERGED = 0.02  # fall of the marginal cost, in units of chi-squared
EM_FITS = 4  # Levenberg-Marquardt steps between two estimates of the noise
EM_STRIDE = 3.0  # change of a standard deviation in one step, at most, as a factor
LEAST_NOISE = 1e-4  # of the first guess: standard deviations do not shrink below
ALTERNATIONS = 5  # of search and noise
STEPS = 40
NO_WORSE = 1.02  # held-out error over the least: a term that buys less is left out


@dataclass(frozen=True, eq=False)
class Noisy:
    """A model with process noise: the searcher's segments hold both noises, of an average and of a gap.

    `marginal` is -2 log of the marginal likelihood less a constant; `held_out` the error of free runs on what the
    search did not see (`free_run_error`).
    """

    fit: Fit
    searcher: Searcher
    marginal: float
    evidence: Evidence
    held_out: float
    trail: tuple[Move, ...]

    @property
    def penalised(self) -> float:
        """Marginal cost plus the price of every term and, as Bayes' criterion has it, of every gap's width."""
        segments = self.searcher.segments
        widths = len(segments.spread) * float(np.log(segments.samples))
        return self.marginal + float(self.searcher.price[self.fit.present].sum()) + widths

    @property
    def window(self) -> float:
        """Length of a segment in seconds."""
        return float(np.median(self.searcher.segments.count)) * self.searcher.segments.step

    @property
    def unexplained(self) -> FloatArray:
        """Root mean square of what the model does not explain of each target, averaged over a segment, (targets,)."""
        following = self.searcher.following
        states = [int(np.flatnonzero(following == -1 - t)[0]) for t in range(int((following < 0).sum()))]
        rms: FloatArray = self.searcher.segments.spread[states] / self.window
        return rms


def with_noise(searcher: Searcher, measurement: FloatArray, process: FloatArray) -> Searcher:
    """Return the searcher that weighs by these standard deviations; its `spread` is then the width of a gap."""
    segments = replace(searcher.segments, noise=measurement, spread=process)
    return replace(searcher, evaluator=Evaluator(segments, searcher.evaluator.substeps))


def estimate_noise(searcher: Searcher, found: Fit) -> tuple[Searcher, Fit, float]:
    """Estimate both noises by expectation-maximisation around a structure; return searcher, fit and marginal cost."""
    floor = LEAST_NOISE * searcher.segments.spread, LEAST_NOISE * searcher.segments.noise
    process, measurement, marginal = _expected_squares(searcher, found)
    for _ in range(EM_ITERATIONS):
        segments = searcher.segments
        moved = with_noise(
            searcher,
            np.maximum(segments.noise * np.clip(measurement / segments.noise, 1.0 / EM_STRIDE, EM_STRIDE), floor[1]),
            np.maximum(segments.spread * np.clip(process / segments.spread, 1.0 / EM_STRIDE, EM_STRIDE), floor[0]),
        )
        again = moved.fit(found.theta, found.present, found.x0, moved.segments.spread, EM_FITS)
        if again is None:
            break
        process, measurement, cost = _expected_squares(moved, again)
        if not cost < marginal:
            break
        fall, searcher, found, marginal = marginal - cost, moved, again, cost
        if fall < EM_CONVERGED:
            break
    return searcher, found, marginal


def _expected_squares(searcher: Searcher, found: Fit) -> tuple[FloatArray, FloatArray, float]:
    """Return root mean squares of gaps (n,) and residuals (c,), as the posterior of the states expects them.

    And the marginal cost: -2 log of the likelihood, by Laplace's approximation over the states, less a constant.
    """
    segments, evaluator = searcher.segments, searcher.evaluator
    n, none = found.x0.shape[1], np.zeros(0, dtype=np.int64)
    program, kept = searcher.program(found.present)
    theta = found.theta[kept]
    integrated = evaluator.integrate(program, theta, none, found.x0)
    expansion = evaluator.expand(program, theta, none, found.x0, segments.spread, 0.0, integrated)
    if expansion is None:
        return segments.spread, segments.noise, np.inf
    own, following = joint_covariances(expansion.factor, expansion.carry, segments.joined)
    joints = np.flatnonzero(segments.joined)
    gaps = integrated[3][joints] - found.x0[joints + 1]
    across = integrated[4][joints][:, :, :n]
    spread = (
        np.einsum("jik,jkl,jil->ji", across, own[joints], across)
        + np.einsum("jii->ji", own[joints + 1])
        - 2.0 * np.einsum("jik,jik->ji", across, following[joints])
    )
    # MacKay's form of the step: the same fixed point as the mean of squares plus variances, reached in a few steps.
    known = np.maximum(len(joints) - spread.sum(axis=0) / segments.spread**2, 1e-3 * len(joints))
    process = np.sqrt((gaps**2).sum(axis=0) / known) if len(joints) else segments.spread
    samples = segments.samples // len(segments.noise)
    measurement = np.empty(len(segments.noise))
    for c in range(len(measurement)):
        alone = np.full(len(measurement), np.inf)
        alone[c] = 1.0
        only = Evaluator(replace(segments, noise=alone), evaluator.substeps)
        cost, _, hessian, _, _ = only.integrate(program, theta, none, found.x0)
        taken = float(np.einsum("jik,jki->", hessian, own)) / segments.noise[c] ** 2
        measurement[c] = np.sqrt(cost.sum() / max(samples - taken, 1e-3 * samples))
    marginal = (
        expansion.cost
        + expansion.log_det
        + 2.0 * samples * float(np.log(segments.noise).sum())
        + 2.0 * len(joints) * float(np.log(segments.spread).sum())
    )
    return process, measurement, float(marginal)


def robust_evidence(searcher: Searcher, program: Program, found: Fit) -> Evidence | None:
    """Return evidence that does not take coloured gaps for information, None where there is no expansion.

    By Fisher's identity the gradient of the marginal likelihood is that of the complete one at the smoothed states: a
    sum over segments. Sums over square-root-many blocks of segments are nearly independent, whatever the colour.
    """
    segments, free = searcher.segments, searcher.free
    n = found.x0.shape[1]
    integrated = searcher.evaluator.integrate(program, found.theta, free, found.x0)
    expansion = searcher.evaluator.expand(program, found.theta, free, found.x0, segments.spread, 0.0, integrated)
    if expansion is None or not expansion.finite:
        return None
    gradient = integrated[1][:, n:].copy()
    joints = np.flatnonzero(segments.joined)
    weighted = (integrated[3][joints] - found.x0[joints + 1]) / segments.spread**2
    gradient[joints] += np.einsum("ji,jip->jp", weighted, integrated[4][joints][:, :, n:])
    return weigh(searcher, found, expansion.information, in_blocks(gradient))


def cost_without_process_noise(searcher: Searcher, outcome: Outcome) -> float:
    """Return the penalised marginal cost of a model that follows its record, on the cut that `searcher` has."""
    segments = searcher.segments
    strict = with_noise(searcher, segments.noise * np.sqrt(max(outcome.scale, 1.0)), segments.spread * outcome.gap)
    found = strict.fit(outcome.fit.theta, outcome.fit.present, segments.initial, strict.segments.spread)
    if found is None:
        return np.inf
    return _expected_squares(strict, found)[2] + float(searcher.price[found.present].sum())


def in_pieces(
    cut: Callable[[int], Segments], searcher: Searcher, starts: Sequence[tuple[FloatArray, IntArray]]
) -> Searcher:
    """Return the searcher on segments so short that shorter ones would describe a first start hardly better.

    Noise that acts within a segment would be taken for measurement noise, and bias the coefficients as errors in
    variables do. All lengths describe the same samples, so their marginal costs compare.

    Args:
        cut: cuts the data into segments of so many averages.
        searcher: candidates.
        starts: as for the search; the first that can be followed is judged.
    """
    best, least = None, np.inf
    for length in PIECES:
        segments = cut(length)
        width = segments.spread.size + len(searcher.free)
        if best is not None and 8.0 * len(segments.start) * width**2 > LARGEST_TABLE:
            break
        pieces = replace(searcher, evaluator=Evaluator(segments, searcher.evaluator.substeps))
        fits = (pieces.fit(theta, present, segments.initial, segments.spread) for theta, present in starts)
        found = next((f for f in fits if f is not None), None)
        cost = np.inf if found is None else estimate_noise(pieces, found)[2]
        if best is not None and not cost < least - WORTH_FINER * segments.samples:
            break
        best, least = pieces, cost
        if time.time() > searcher.deadline:
            break
    assert best is not None
    return best


def search_with_process_noise(searcher: Searcher, starts: Sequence[tuple[FloatArray, IntArray]]) -> Noisy | None:
    """Return the best model with process noise that searches end at, or None where none can start.

    Some of the data are held out from the searches; along the way back from their ends, term by term, free runs of
    that say where to stop. The best is then fitted to all.

    Args:
        searcher: data cut into short segments (`in_pieces`), and candidates.
        starts: (slots,) coefficients to begin with, 1 in fixed slots, and the slots present.
    """
    program = Program.of(searcher.slots, searcher.variables, searcher.following, searcher.measured)
    first = without_held_out(searcher.segments)
    seen = replace(searcher, evaluator=Evaluator(first, searcher.evaluator.substeps))
    ends = []
    for theta, present in starts:
        end = _search(seen, program, theta, present)
        if end is not None:
            ends.append(end)
            seen = end[0]  # the next start begins with the noise that this one found
        if time.time() > searcher.deadline:
            break
    if not ends:
        return None
    seen, here, _, trail = min(ends, key=lambda end: end[2])
    begun = with_noise(searcher, seen.segments.noise, seen.segments.spread)
    found = begun.fit(here.theta, here.present, begun.segments.initial, begun.segments.spread)
    if found is None:
        return None
    fitted, found, marginal = estimate_noise(begun, found)
    evidence = robust_evidence(fitted, program, found)
    if evidence is None:
        return None
    return Noisy(found, fitted, marginal, evidence, free_run_error(seen, here.theta), trail)


def _search(
    seen: Searcher, program: Program, theta: FloatArray, present: IntArray
) -> tuple[Searcher, Fit, float, tuple[Move, ...]] | None:
    """Return the end of one search: the searcher with its noise, the fit, its penalised cost, the trail."""
    here = seen.fit(theta, np.sort(present), seen.segments.initial, seen.segments.spread)
    if here is None:
        return None
    trail = list[Move]()
    for _ in range(ALTERNATIONS):
        seen, here, marginal = estimate_noise(seen, here)
        before = here.present
        here = _settle(seen, program, here, trail)
        if np.array_equal(before, here.present) or time.time() > seen.deadline:
            break
    here = _shortest(seen, program, here, trail)
    return seen, here, marginal + float(seen.price[here.present].sum()), tuple(trail)


def _settle(searcher: Searcher, program: Program, here: Fit, trail: list[Move]) -> Fit:
    """Drop and add by the robust evidence until nothing moves."""
    refused = set[int]()
    gap = searcher.segments.spread
    for _ in range(STEPS):
        evidence = robust_evidence(searcher, program, here)
        if evidence is None or time.time() > searcher.deadline:
            return here
        short = evidence.wald - searcher.price[here.present]
        if short.min(initial=0.0) < 0.0:
            place = int(np.argmin(short))
            shorter = _without(searcher, here, place)
            if shorter is None:
                return here
            k = int(here.present[place])
            trail.append(searcher.move(1.0, "drop", k, float(evidence.wald[place]), shorter))
            refused.add(k)  # what was dropped once does not come back: the two tests need not agree
            here = shorter
            continue
        scores = evidence.scores.copy()
        scores[list(refused)] = 0.0
        k = int(np.argmax(scores - searcher.price))
        if scores[k] < searcher.price[k]:
            return here
        present = np.array(sorted([*here.present.tolist(), k]), dtype=np.int64)
        longer = searcher.fit(here.theta, present, here.x0, gap)
        if longer is None or here.cost - longer.cost < searcher.price[k]:
            refused.add(k)
            continue
        trail.append(searcher.move(1.0, "add", k, float(scores[k]), longer))
        here = longer
    return here


def _without(searcher: Searcher, here: Fit, place: int) -> Fit | None:
    theta = here.theta.copy()
    theta[here.present[place]] = 0.0
    return searcher.fit(theta, np.delete(here.present, place), here.x0, searcher.segments.spread)


def _shortest(searcher: Searcher, program: Program, here: Fit, trail: list[Move]) -> Fit:
    """Return the shortest model, on the way back from `here`, whose free run of what it has not seen is no worse."""
    path, moves = [here], list[Move]()
    while len(path[-1].present) > 1 and time.time() < searcher.deadline:
        evidence = robust_evidence(searcher, program, path[-1])
        if evidence is None:
            break
        thin = evidence.wald / searcher.price[path[-1].present]
        place = int(np.argmin(thin))
        if thin[place] > THIN:
            break
        shorter = _without(searcher, path[-1], place)
        if shorter is None:
            break
        k = int(path[-1].present[place])
        moves.append(searcher.move(1.0, "leave out", k, float(evidence.wald[place]), shorter))
        path.append(shorter)
    errors = np.array([free_run_error(searcher, f.theta) for f in path])
    last = int(np.flatnonzero(errors <= NO_WORSE * errors.min())[-1])
    trail.extend(moves[:last])
    return path[last]


def held_out(segments: Segments) -> list[tuple[int, int]]:
    """Return begin and end, in averages, of what searches do not see: every fifth record, or the end of each if few."""
    if len(segments.runs) >= FIFTH:
        return list(segments.runs[FIFTH - 1 :: FIFTH])
    return [(end - (end - begin) // FIFTH, end) for begin, end in segments.runs]


def without_held_out(segments: Segments) -> Segments:
    """Return the segments that have nothing in common with what is held out."""
    begin, end = segments.start, segments.start + segments.count
    keep = np.ones(len(begin), dtype=np.bool_)
    for low, high in held_out(segments):
        keep &= (end <= low) | (begin >= high)
    joined = segments.joined & np.append(keep[1:], False)
    return replace(segments, start=begin[keep], count=segments.count[keep], joined=joined[keep])


def free_run_error(searcher: Searcher, theta: FloatArray) -> float:
    """Return the mean squared error of free runs over what is held out, saturating at 1.

    They begin at smoothed states within every stretch, away from its edges where smoothing is poor, and last until its
    end; errors are in units of the channel's variance over all records.
    """
    segments = searcher.segments
    measured = segments.measured
    windows = [
        (low + (2 * k + 1) * (high - low) // (2 * WINDOWS + 2), high)
        for low, high in held_out(segments)
        for k in range(WINDOWS)
    ]
    start, end = np.array(windows, dtype=np.int64).T
    loose = replace(
        segments,
        start=start,
        count=end - start,
        joined=np.zeros(len(start), dtype=np.bool_),
        noise=np.maximum(measured.std(axis=0), 1e-300),
    )
    program, kept = searcher.program(np.flatnonzero(theta))
    evaluator = Evaluator(loose, searcher.evaluator.substeps)
    none = np.zeros(0, dtype=np.int64)
    cost, *_ = evaluator.integrate(program, theta[kept], none, segments.filtered[start])
    error = cost / (loose.count * measured.shape[1])
    return float(np.mean(np.where(np.isfinite(error), error / (1.0 + error), 1.0)))
