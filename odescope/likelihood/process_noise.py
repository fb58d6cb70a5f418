"""Process noise: the likelihood of a record that no model in the library follows exactly.

On a real rig the defects between segments are not driven to zero: their standard deviations are estimated together
with the noise of the measurement (`noise_levels`), and models compare by the marginal likelihood over the
states. Defects that a missing term leaves are not white, so scores and variances are checked against those between
blocks of the record. docs/method.md, Process noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.add_and_drop import GAIN, HOPELESS, Moves
from odescope.likelihood.block_cholesky import responses
from odescope.likelihood.evidence import Evidence, in_blocks, project, weigh
from odescope.likelihood.expansion import correlated, decorrelated
from odescope.likelihood.fit import Fit
from odescope.likelihood.held_out import free_run_error, thinned, without_held_out
from odescope.likelihood.negligible import one_less
from odescope.likelihood.noise_levels import estimate_noise, with_noise
from odescope.likelihood.path import VERY, ModelPath, surely
from odescope.likelihood.program import Program
from odescope.likelihood.search import WhiteResiduals
from odescope.likelihood.search_space import Move, SearchSpace
from odescope.likelihood.segments import Segments

PIECES = (5, 4, 2, 1)  # averages a segment: what a model lacks may change within a fraction of the shortest period
WORTH_FINER = 0.01  # fall of the marginal cost a sample that shorter segments must bring: they take longer
LARGEST_TABLE = 4e8  # 8 (n + p)^2 over all segments: in more of them a search is ended by its budget
ALTERNATIONS = 5  # of search and noise
STEPS = 40
ADDING = 0.8  # of the budget, after which mechanisms are only dropped
COLOURED = 1.7  # variance of coefficients between blocks of a record over that of a model whose defects are white
PATH_SHARE = 0.6  # of the budget, for the way back: a path that it ends lacks the short models


@dataclass(frozen=True, eq=False)
class Noisy:
    """A model with process noise: the space's segments hold both noises, of an average and of a defect.

    `marginal` is -2 log of the marginal likelihood less a constant; `held_out` the error of free runs on what the
    search did not see (`free_run_error`); `path` leads from the end of the search to the shortest model.
    """

    fit: Fit
    space: SearchSpace
    marginal: float
    evidence: Evidence
    held_out: float
    trail: tuple[Move, ...]
    path: ModelPath

    @property
    def penalised(self) -> float:
        """Marginal cost plus the penalty of every term and, as Bayes' criterion has it, of the defects' covariance."""
        segments, own = self.space.segments, self.space.segments.decorrelation
        numbers = len(segments.spread) + (0 if own is None else np.count_nonzero(np.tril(own, -1)))
        return self.marginal + self.space.price(self.fit) + numbers * float(np.log(segments.samples))

    @property
    def window(self) -> float:
        """Length of a segment in seconds."""
        return float(np.median(self.space.segments.count)) * self.space.segments.step

    @property
    def unexplained(self) -> FloatArray:
        """Root mean square of what the model does not explain of each target, averaged over a segment, (targets,)."""
        following = self.space.frame.following
        states = [int(np.flatnonzero(following == -1 - t)[0]) for t in range(int((following < 0).sum()))]
        parts = correlated(np.diag(self.space.segments.spread), self.space.segments.decorrelation)
        rms: FloatArray = np.sqrt(np.sum(parts**2, axis=0))[states] / self.window
        return rms


def robust_evidence(space: SearchSpace, found: Fit) -> Evidence | None:
    """Return evidence that does not take coloured defects for information, None where there is no expansion.

    By Fisher's identity the gradient of the marginal likelihood is that of the complete one at the smoothed states: a
    sum over segments, along which the states follow the coefficients. Sums over square-root-many blocks of segments are
    nearly independent, whatever the colour.
    """
    expanded = _expanded(space, space.whole, found.theta, space.free(found), found.x0)
    return None if expanded is None else weigh(space, found, *expanded)


def white(found: Fit, evidence: Evidence) -> bool:
    """Say whether defects scatter as noise of the process does: what lacks in a law makes some stretches worse."""
    ratios = evidence.variances / np.maximum(found.variances, 1e-300)
    return bool(ratios.size and np.median(ratios) < COLOURED)


@np.errstate(over="ignore")  # of coefficients that ran away
def robust_wald(space: SearchSpace, found: Fit) -> FloatArray | None:
    """Return the Wald statistics (p,) of `robust_evidence`, without looking at what is absent."""
    free = np.searchsorted(found.present, found.free)
    program, theta = space.program(found.present), found.theta[found.present]
    expanded = _expanded(space, program, theta, free, found.x0)
    if expanded is None:
        return None
    rest = project(*expanded, np.ones(len(free), dtype=np.bool_))
    wald: FloatArray = (found.theta[found.free] * rest.scale) ** 2 / np.maximum(rest.variances, 1e-300)
    return wald


def _expanded(
    space: SearchSpace, program: Program, theta: FloatArray, free: IntArray, x0: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return the information (f, f), initial states eliminated, and the gradients (b, f) of blocks.

    With states that stay where they are, the gradient of a block is for the most part what holds it to its neighbours:
    that cancels in the sum, and would pass for scatter.
    """
    segments, n = space.segments, x0.shape[1]
    integrated = space.evaluator.integrate(program, theta, free, x0)
    expansion = space.evaluator.expand(program, theta, free, x0, segments.spread, 0.0, integrated)
    if expansion is None or not expansion.finite:
        return None
    integrated, x0 = decorrelated(integrated, x0, segments.decorrelation)
    follow = responses(expansion.factor, expansion.border, expansion.carry, segments.joined)
    gradient = integrated.gradient[:, n:] + np.einsum("ji,jip->jp", integrated.gradient[:, :n], follow)
    joints = np.flatnonzero(segments.joined)
    weighted = (integrated.last[joints] - x0[joints + 1]) / segments.spread**2
    ends = integrated.jacobian[joints]
    moved = ends[:, :, n:] + np.matmul(ends[:, :, :n], follow[joints]) - follow[joints + 1]
    gradient[joints] += np.einsum("ji,jip->jp", weighted, moved)
    return expansion.information, in_blocks(gradient)


def only_noise_lacks(space: SearchSpace, theta: FloatArray) -> bool:
    """Say whether a model lacks nothing but noise of the process: what it leaves is white with that.

    Args:
        space: data and candidates.
        theta: (mechanisms,) coefficients of the model.
    """
    pieces = space.on(thinned(space.segments.cut_anew(PIECES[0])))
    begun = pieces.begin(theta, pieces.segments.spread)
    if begun is None:
        return False
    noisy, found, cost = estimate_noise(pieces, begun)
    return bool(np.isfinite(cost)) and _lacks_nothing(noisy, found)


def in_pieces(cut: Callable[[int], Segments], space: SearchSpace, starts: Sequence[FloatArray]) -> SearchSpace:
    """Return the space on segments so short that shorter ones would describe a first start hardly better.

    Noise that acts within a segment would be taken for measurement noise, and bias the coefficients as errors in
    variables do. All lengths describe the same samples, so their marginal costs compare.

    Args:
        cut: cuts the data into segments of so many averages.
        space: candidates.
        starts: as for the search; the first that can be followed is judged.
    """
    best, least = None, np.inf
    for length in PIECES:
        whole = cut(length)
        pieces = space.on(thinned(whole))
        width = whole.spread.size + len(space.mechanisms)
        if best is not None and 8.0 * len(whole.start) * width**2 > LARGEST_TABLE:
            break
        fits = (pieces.begin(theta, whole.spread) for theta in starts)
        found, cost = next((f for f in fits if f is not None), None), np.inf
        if found is not None:
            _, found, cost = estimate_noise(pieces, found)
            starts = [found.theta, *starts]
        if best is None or cost < least - WORTH_FINER * pieces.segments.samples:
            best, least = space.on(whole), cost
        if space.budget.over:
            break
    assert best is not None
    return best


def search_with_process_noise(
    space: SearchSpace, starts: Sequence[FloatArray], terms: int | None = None
) -> Noisy | None:
    """Return the best model with process noise that searches end at, or None where none can start.

    Some of the data are held out from the searches; along the way back from the best of their ends, term by term, free
    runs of that say where to stop; where what is left is white, of thin mechanisms only. What is chosen is then fitted
    to all. Of a long record searches see stretches; where the best of them ends is searched from once more in the
    whole of what is not held out. After one that ends where nothing lacks, all that are left may cost as much as that.

    Args:
        space: data cut into short segments (`in_pieces`), and candidates.
        starts: (mechanisms,) coefficients to begin with.
        terms: number of mechanisms to stop at, where that is given.
    """
    open_ = without_held_out(space.segments)
    seen = space.on(thinned(open_))
    ends, able, most = [], _able(seen, starts), np.inf
    for left, here in zip(range(len(able), 0, -1), able, strict=True):
        # One with many terms in vain may not spend what others need to add theirs.
        own = space.budget.rest(0.0).part(1.0 / left)
        own.limit = min(own.limit, most)
        ended, longest, cost, trail = _search(seen.within(own), here)
        space.budget.spent += own.spent
        seen = ended.within(space.budget)  # the next start begins with the noise that this one found
        ends.append((seen, longest, cost, trail))
        if space.budget.over:
            break
        if left > 1 and not own.over and _lacks_nothing(seen, longest):
            most = min(most, own.spent / (left - 1))  # all others together may cost as much as this did
    if not ends:
        return None
    seen, longest, _, trail = min(ends, key=lambda end: end[2])
    if len(open_.start) > len(seen.segments.start):
        seen, longest, trail = _searched_on(space.on(open_), seen, longest, trail)
    way = ModelPath.back(seen.within(seen.budget.part(PATH_SHARE)), longest, seen.segments.spread)
    sure = terms is None and _lacks_nothing(seen, longest)
    if terms is not None:
        way = way.chosen_at(terms)
    elif sure:
        way = way.at_knee(VERY).keeping_sure.keeping_friction
    else:
        way = way.at_knee().keeping_friction
    here = way.choice.fit
    begun = with_noise(space, seen.segments.noise, seen.segments.spread, seen.segments.decorrelation)
    found = _near(begun, space.segments.spread, here)
    if found is None:
        return None
    if sure and way.chosen == 0:  # nothing had to be held out: all of the record says what else is sure
        begun, found, _, more = _search(begun, found)
        found, unsure = _without_unsure(begun, found, here.present)
        trail += more + unsure
    end = _without_worthless(begun, found)
    if end is None:
        return None
    fitted, found, marginal, evidence, dropped = end
    return Noisy(found, fitted, marginal, evidence, free_run_error(seen, here.theta), trail + dropped, way)


def _lacks_nothing(space: SearchSpace, found: Fit) -> bool:
    """Say whether what a model leaves is white."""
    known = robust_evidence(space, found)
    return known is not None and white(found, known)


def _near(space: SearchSpace, spread: FloatArray, here: Fit) -> Fit | None:
    """Return a fit begun at the smoothed states of other segments, None where it cannot be followed.

    Where next to no noise acts, ties are far tighter than smoothed states are right: looser ones come first.

    Args:
        space: with the segments and their noise.
        spread: (n,) smoothing errors of the states.
        here: the fit.
    """
    near = space.again(here, space.segments.initial, np.maximum(spread, space.segments.spread))
    return None if near is None else space.again(near, near.x0, space.segments.spread)


def _without_unsure(space: SearchSpace, found: Fit, before: IntArray) -> tuple[Fit, tuple[Move, ...]]:
    """Return the fit without mechanisms that have earned no more than SURE times their price, but for some, and how.

    Args:
        space: data and candidates.
        found: the fit.
        before: numbers of those that stay.
    """
    moves, enough = Moves(space, _BlockSpread(space), 1.0, 1.0, []), surely(space)
    while (wald := robust_wald(space, found)) is not None:
        earned = dict(zip(found.free.tolist(), wald.tolist(), strict=True))
        added = [k for k in earned if k not in before and space.mechanisms[k].parts]
        k = min(added, key=lambda k: earned[k] / space.penalty[k], default=None)
        shorter = None if k is None or earned[k] > enough[k] else moves.without(found, k)
        if k is None or shorter is None:
            break
        found = shorter
        moves.trail.append(space.move(1.0, "drop", k, earned[k], found))
    return found, tuple(moves.trail)


def _without_worthless(
    space: SearchSpace, found: Fit
) -> tuple[SearchSpace, Fit, float, Evidence, tuple[Move, ...]] | None:
    """Return space, fit, marginal cost and evidence without what is not worth its penalty or next to nothing, and how.

    None where there is no evidence.
    """
    fitted, found, marginal = estimate_noise(space, found)
    evidence, trail = robust_evidence(fitted, found), list[Move]()
    lean = None if evidence is None else _without_idle(fitted, found, evidence)
    if lean is not None:
        fitted, found, marginal = estimate_noise(fitted, lean)
        evidence = robust_evidence(fitted, found)
    if evidence is None:
        return None
    while (leaner := one_less(fitted, found, evidence.wald, fitted.segments.spread)) is not None:
        refitted, less, cost = estimate_noise(fitted, leaner[0])
        rest = robust_evidence(refitted, less)
        if rest is None:
            break
        fitted, found, marginal, evidence = refitted, less, cost, rest
        trail.append(fitted.move(1.0, "drop", leaner[1], leaner[2], found))
    return fitted, found, marginal, evidence, tuple(trail)


def _without_idle(space: SearchSpace, found: Fit, evidence: Evidence) -> Fit | None:
    """Return the fit without the offsets, delays and constants that are not worth their penalty, None if all are."""
    idle = [
        k
        for k, wald in zip(found.free.tolist(), evidence.wald, strict=True)
        if not space.mechanisms[k].parts and k not in space.needed.values() and wald < space.penalty[k]
    ]
    if not idle:
        return None
    theta = found.theta.copy()
    theta[idle] = 0.0
    return space.fit(theta, np.setdiff1d(found.present, idle), found.x0, space.segments.spread, found.strength)


def _searched_on(
    whole: SearchSpace, seen: SearchSpace, longest: Fit, trail: tuple[Move, ...]
) -> tuple[SearchSpace, Fit, tuple[Move, ...]]:
    """Return where a search on part of the record ends on the whole, as fitted to that part: space, fit, trail."""
    more = with_noise(whole, seen.segments.noise, seen.segments.spread, seen.segments.decorrelation)
    begun = None if whole.budget.over else _near(more, whole.segments.spread, longest)
    if begun is None:
        return seen, longest, trail
    _, found, _, moves = _search(more, begun)
    if np.array_equal(found.present, longest.present):
        return seen, longest, trail
    again = _near(seen, whole.segments.spread, found)
    return (seen, longest, trail) if again is None else (seen, again, trail + moves)


def _able(seen: SearchSpace, starts: Sequence[FloatArray]) -> list[Fit]:
    """Return the starts as fitted, the best first, each model once, without those that are hopeless beside it."""
    fits = [f for f in (seen.begin(theta, seen.segments.spread) for theta in starts) if f is not None]
    fits.sort(key=lambda f: f.cost)
    able = list[Fit]()
    for f in fits:
        met = any(np.array_equal(f.present, a.present) and f.cost - a.cost < GAIN for a in able)
        if f.cost <= HOPELESS * fits[0].cost and not met:
            able.append(f)
    return able


def _search(seen: SearchSpace, start: Fit) -> tuple[SearchSpace, Fit, float, tuple[Move, ...]]:
    """Return the end of one search: the space with its noise, the fit, its penalised cost, the trail."""
    seen, here, marginal = estimate_noise(seen, start)
    trail = list[Move]()
    for _ in range(ALTERNATIONS):
        before = here.present
        here = _settle(seen, here, trail)
        if np.array_equal(before, here.present):
            break
        seen, here, marginal = estimate_noise(seen, here)
        if seen.budget.over:
            break
    return seen, here, marginal + seen.price(here), tuple(trail)


@dataclass(frozen=True, eq=False)
class _BlockSpread:
    """Statistics checked against the spread between blocks of the record; they decide alone, and once."""

    space: SearchSpace
    trials: int = STEPS
    binding: bool = True

    def wald(self, here: Fit) -> FloatArray | None:
        """Return the Wald statistics of the parameters."""
        return robust_wald(self.space, here)

    def scores(self, here: Fit) -> FloatArray | None:
        """Return the score statistics of the absent mechanisms."""
        evidence = robust_evidence(self.space, here)
        return None if evidence is None else evidence.scores


def _settle(space: SearchSpace, here: Fit, trail: list[Move]) -> Fit:
    """Drop and add by the robust evidence until nothing moves; the last of the budget is for drops alone.

    Then exchange: of two look-alikes the wrong one may have come first, and is sure while the other is not there. Or a
    few may stand for all that a relation has.
    """
    moves, plain = Moves(space, _BlockSpread(space), 1.0, 1.0, trail), WhiteResiduals(space, space.segments.spread)
    for _ in range(STEPS):
        if space.budget.over:
            break
        late = space.budget.spent > ADDING * space.budget.limit
        moved = moves.drop(here) or moves.divide(here) or (None if late else moves.add(here))
        if moved is None and not late:
            moved = (
                moves.add_uneven(here, plain.scores(here))
                or moves.exchange(here, plain.expansion(here))
                or moves.substitute(here, plain.expansion)
            )
        if moved is None:
            break
        here = moved
    return here
