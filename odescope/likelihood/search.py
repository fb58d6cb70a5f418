"""Structure search by likelihood: score tests add, Wald tests drop, while continuity is tightened.

docs/method.md, Structure by likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import msgspec
import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.library.constants import Constant
from odescope.likelihood.add_and_drop import HOPELESS, Moves
from odescope.likelihood.evidence import project
from odescope.likelihood.expansion import Expansion
from odescope.likelihood.fit import Fit
from odescope.likelihood.narrowing import narrowed
from odescope.likelihood.search_space import Move, SearchSpace

WIDTHS = (np.inf, 1.0, 0.1, 0.01, 0.001)  # of the defects, in smoothing errors of each state
TIED = (5.0, *WIDTHS[1:])  # the same for short segments, of which one alone says next to nothing
NEAR_NOISE = 2.0  # residual variance over noise variance above which continuity is not tightened
TRIALS = 3  # mechanisms tried by refitting before a move is given up
TELLING = 0.9  # of what a residual variance has beside the noise: narrower friction that leaves more explains nothing
HALF = 0.5  # of the cost: a term that leaves more explains little
WHITE = 1.1  # residual variance over noise variance of a model that lacks nothing
THIN = 4.0  # times its penalty: a term that earns less may be due to what else was chosen
LOOK_BACK = 0.1  # width of the defects from which on the search looks back
PATIENCE = 4  # rounds a relation after which a search ends
CHANCE = 2.0  # standard deviations of defects or of a residual variance that are no reason to take them for more
MOST_TERMS = 15  # a relation: a search that wants more is explaining something that is not in the library
ROUNDS = 40  # additions and drops at one width


class LikelihoodSearch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the likelihood stage.

    Attributes:
        enabled: whether there is one; without, the model is what regression proposes.
        starts: the proposals that searches begin from, beside a sparse forward selection.
        budget (about half a second of two cores): where it is spent the best model so far is returned. It counts
            evaluations by their size, so that the same study gives the same model on every machine. It limits what each
            form that competes adds and drops: to fit one model, in segments that are open and then joined, takes what
            it takes. All searches of an identification, for functions, too, may take four times as much.
        terms: the number of terms or mechanisms to stop at on the path of models, instead of what its errors say.
        seconds (s): how long after the run began the clock ends all searches as well, with the best model so far. What
            comes before and after takes its own time; a model that the clock has ended may differ from run to run.
    """

    enabled: bool = True
    starts: Annotated[int, msgspec.Meta(ge=1)] = 1
    budget: Annotated[float, msgspec.Meta(gt=0.0)] = 60.0
    terms: Annotated[int, msgspec.Meta(ge=2)] | None = None
    seconds: Annotated[float, msgspec.Meta(gt=0.0)] | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of a search: the fit over all mechanisms, the width of the defects it holds for, and the trail.

    `scale` is the residual variance over the noise variance; `penalties` (p,) what each parameter had to earn, `price`
    what they had to together; `spent` the units of budget that it took; not `finished` if the budget ended it, `late`
    if that was the clock. `constants` are those of the space where it ended, with dry friction as narrow as it became.
    `loose` are coefficients (mechanisms,) of models that follow the record in segments whose ends stay open: what they
    lack may be noise of the process. `log_noise` is that of the segments it was searched in.
    """

    fit: Fit
    width: float
    scale: float
    penalties: FloatArray
    price: float
    trail: tuple[Move, ...]
    finished: bool
    late: bool
    spent: float
    constants: Mapping[str, Constant] = field(default_factory=dict)
    loose: tuple[FloatArray, ...] = ()
    log_noise: float = 0.0

    @property
    def deviance(self) -> float:
        """-2 ln(likelihood) plus the penalties: comparable between models under different noises."""
        return self.penalised + self.log_noise

    @property
    def penalised(self) -> float:
        """Cost in units of the noise variance, plus the penalty of every term."""
        return self.fit.cost + self.price

    @property
    def clear(self) -> bool:
        """Whether another start is unlikely to end elsewhere: white residuals, and no term whose case is thin.

        That the budget ended it is no reason to begin again: it is finished where it stands.
        """
        return self.width == WIDTHS[-1] and self.scale < WHITE and self.sure

    @property
    def sure(self) -> bool:
        """Whether it has no term whose case is thin."""
        return bool(np.all(self.fit.wald / max(self.scale, 1.0) >= THIN * self.penalties))

    def padded(self, kept: IntArray, number: int) -> Outcome:
        """Return the same over all of so many mechanisms.

        Args:
            kept: numbers of those that it was searched among.
            number: of all.
        """
        theta, fit = np.zeros(number), self.fit
        theta[kept] = fit.theta
        return replace(self, fit=replace(fit, theta=theta, present=kept[fit.present], held=kept[fit.held]))

    @property
    def rank(self) -> tuple[float, float]:
        """Starts compete by how far continuity carried them, then by cost and number of terms; less is better."""
        return self.width, self.penalised


@dataclass(frozen=True, eq=False)
class WhiteResiduals:
    """Statistics of a model that follows the record but for white noise; the penalised cost of a refit decides.

    `last` is the fit that was expanded last, with its expansion.
    """

    space: SearchSpace
    defect_std: FloatArray
    trials: int = TRIALS
    binding: bool = False
    last: list[tuple[Fit, Expansion | None]] = field(default_factory=list)

    def expansion(self, here: Fit) -> Expansion | None:
        """Return the expansion of the cost with all candidates on the tape, None where they cannot be followed."""
        if not self.last or self.last[0][0] is not here:
            space = self.space
            found = space.evaluator.expand(space.whole, here.theta, space.free(here), here.x0, self.defect_std)
            self.last[:] = [(here, found)]
        return self.last[0][1]

    def wald(self, here: Fit) -> FloatArray:
        """Return the Wald statistics of the parameters."""
        return here.wald

    def scores(self, here: Fit) -> FloatArray:
        """Return the score statistic of all that is absent."""
        free, result = self.space.free(here), np.zeros(len(self.space.mechanisms))
        expansion = self.expansion(here)
        if expansion is not None:
            present = np.isin(free, here.free)
            rest = project(expansion.information, expansion.gradient[None], present)
            result[free[~present]] = rest.scores(rest.left)
        return result


def search(
    space: SearchSpace, theta: FloatArray, widths: Sequence[float] = WIDTHS, x0: FloatArray | None = None
) -> Outcome | None:
    """Return where a search from these coefficients ends, or None where the start cannot be integrated.

    Args:
        space: data, candidates, budget.
        theta: (mechanisms,) coefficients to begin with.
        widths: of the defects, one after the other.
        x0: (J, n) initial states to begin with, None for the smoothed states.

    Raises:
        Stopped: the run is to end.
    """
    segments, trail = space.segments, list[Move]()
    begun = segments.initial if x0 is None else x0
    here = space.fit(theta, np.flatnonzero(theta), begun, segments.spread * np.inf)
    if here is None:
        return None
    best, constants = (here, float(widths[0]), _scale(space, here, widths[0])), space.frame.constants
    for width in widths:
        refitted = space.again(here, here.x0, segments.spread * width)
        if refitted is None:
            break
        if np.isinf(width):
            space, here = _with_friction_as_shown(space, refitted, trail)
        else:
            space, refitted = narrowed(space, refitted, segments.spread * width)
            here = _settle(space, refitted, width, trail)
        scale = _scale(space, here, width)
        if scale > NEAR_NOISE and width == widths[0]:
            here = _settle(space, _found_again(space, here, width), width, trail)
            scale = _scale(space, here, width)
        if np.isinf(width):
            space, here, scale = _with_narrow_friction(space, here, scale, trail)
        if width != widths[0] and (scale > NEAR_NOISE * max(best[2], 1.0) or torn(space, here) or unbounded(here)):
            break
        best, constants = (here, float(width), scale), space.frame.constants
        if scale > NEAR_NOISE or space.budget.late:
            break  # where nothing that is absent explains the record joining segments would only invent terms
    budget = space.budget
    found = best[0]
    prices, log_noise = (_to_earn(space, found), space.price(found)), segments.log_noise
    return Outcome(
        *best, *prices, tuple(trail), not budget.over, budget.late, budget.spent, constants, log_noise=log_noise
    )


def _found_again(space: SearchSpace, here: Fit, width: float) -> Fit:
    """Return the fit with every segment that is nearer the record from its smoothed state begun there, if it is better.

    What was right for a model that lacked much, or had its inputs at the wrong time, may lie in another minimum than
    what is right for this one.

    Args:
        space: data and candidates.
        here: where a search ended.
        width: of the defects.
    """
    smoothed, none = space.segments.initial, np.zeros(0, dtype=np.int64)
    program, theta = space.program(here.present), here.theta[here.present]
    costs = [space.evaluator.integrate(program, theta, none, x0).cost for x0 in (here.x0, smoothed)]
    nearer = costs[1] < costs[0]
    if not nearer.any():
        return here
    again = space.again(here, np.where(nearer[:, None], smoothed, here.x0), space.segments.spread * width)
    return again if again is not None and again.cost < here.cost else here


def _with_friction_as_shown(space: SearchSpace, here: Fit, trail: list[Move]) -> tuple[SearchSpace, Fit]:
    """Return where a search in open segments ends, with dry friction as narrow as the record shows on the way.

    What creeps where a joint sticks asks for terms as soon as nothing else lacks, a dozen before any is in vain: the
    width is looked at when a term has left more than half of the cost, and less often the more often that was in vain.

    Args:
        space: data, candidates and constants.
        here: a fit in open segments.
        trail: of moves, which grows.
    """
    wait, rounds, loose = 1, 0, space.segments.spread * np.inf
    while True:
        scale = _scale(space, here, np.inf)
        if scale > WHITE and space.fixed_constants(here) and not space.budget.over:
            narrower, found = narrowed(space, here, loose)
            if _scale(narrower, found, np.inf) - 1.0 <= TELLING * (scale - 1.0):
                space, here, wait = narrower, found, 1
                continue
            wait *= 2
        before = len(trail)
        here = _settle(space, here, np.inf, trail, rounds, wait)
        rounds += len(trail) - before
        if len(trail) == before:
            return space, here


def _with_narrow_friction(
    space: SearchSpace, here: Fit, scale: float, trail: list[Move]
) -> tuple[SearchSpace, Fit, float]:
    """Return space, fit and residual variance where open segments show the width of dry friction, searched again.

    A record of little noise does: what creeps where the joint sticks then asks for terms, and none explains it.

    Args:
        space: data, candidates and constants.
        here: where a search in open segments ended, off the record.
        scale: its residual variance over the noise variance.
        trail: of moves, which grows.
    """
    loose = space.segments.spread * np.inf
    while scale > WHITE and not space.budget.over:
        narrower, found = narrowed(space, here, loose)
        if _scale(narrower, found, np.inf) - 1.0 > TELLING * (scale - 1.0):
            break
        space, here = narrower, _settle(narrower, found, np.inf, trail)
        scale = _scale(space, here, np.inf)
    return space, here, scale


def in_whole(space: SearchSpace, outcome: Outcome) -> Outcome | None:
    """Return the end of a search that saw stretches of a record as it is in the whole, None where it is lost there.

    Args:
        space: with the whole record.
        outcome: of the search.
    """
    found, spread = outcome.fit, space.segments.spread
    here = space.fit(found.theta, found.present, space.segments.initial, spread * np.inf, found.strength)
    for width in WIDTHS[1:]:
        if here is None or width < outcome.width:
            break
        here = space.again(here, here.x0, spread * width)
    if here is None or np.isinf(outcome.width):
        return None if here is None else fitted_again(space, outcome, here)
    return settle_again(space, outcome, here)


def settle_again(space: SearchSpace, outcome: Outcome, found: Fit) -> Outcome:
    """Return the end of a search with what is added and dropped where it ended, in a space with finer steps.

    Args:
        space: with the finer steps.
        outcome: of the search.
        found: its model, fitted in that space.
    """
    trail = list(outcome.trail)
    fit = _settle(space, found, outcome.width, trail)
    finished = outcome.finished or not space.budget.over
    return fitted_again(space, replace(outcome, trail=tuple(trail), finished=finished), fit)


def fitted_again(space: SearchSpace, outcome: Outcome, found: Fit) -> Outcome:
    """Return the end of a search with another fit at its width, and what that costs.

    Args:
        space: of the fit.
        outcome: of the search.
        found: the fit.
    """
    scale, noise = _scale(space, found, outcome.width), space.segments.log_noise
    prices = _to_earn(space, found), space.price(found)
    return replace(outcome, fit=found, scale=scale, penalties=prices[0], price=prices[1], log_noise=noise)


def _to_earn(space: SearchSpace, found: Fit) -> FloatArray:
    """Return what each parameter has to earn by itself: nothing where a term needs it, whatever its value."""
    return np.where(np.isin(found.free, [*space.needed.values()]), 0.0, space.penalty[found.free])


def torn(space: SearchSpace, found: Fit) -> bool:
    """Say whether the defects are larger than their width, and by chance: the record does not support a tighter one."""
    defects = int(space.segments.joined.sum()) * found.x0.shape[1]
    return bool(defects > 0 and found.cost - found.data_cost > defects + CHANCE * np.sqrt(2.0 * defects))


def unbounded(found: Fit) -> bool:
    """Say whether not one coefficient of a fit is known: somewhere runs beside it part from it without bound."""
    return bool(found.wald.max(initial=0.0) < 1.0 and len(found.wald))


def full(space: SearchSpace, found: Fit) -> bool:
    """Say whether a model has so many terms that it explains something that is not in the library."""
    return len(found.free) > MOST_TERMS * space.relations


def _scale(space: SearchSpace, found: Fit, width: float) -> float:
    """Return the residual variance over the noise variance, degrees of freedom of loose initial states counted."""
    segments = space.segments
    states = found.x0.size if np.isinf(width) else found.x0.shape[1] * int((~segments.joined).sum())
    freedom = max(segments.samples - states - len(found.free), 1)
    return max(found.data_cost / freedom, 1e-12)


def _settle(
    space: SearchSpace, here: Fit, width: float, trail: list[Move], begun: int = 0, looked_at: int | None = None
) -> Fit:
    """Add, drop and go round weak terms at one width until nothing moves; only drop once the budget is spent.

    Args:
        space: data and candidates.
        here: where to begin.
        width: of the defects.
        trail: of moves, which grows.
        begun: rounds before these.
        looked_at: after so many rounds the first move that leaves more than half of the cost ends it too, where the
            model has dry friction of a given width.
    """
    judge, due, wait = WhiteResiduals(space, space.segments.spread * width), 0, 2
    for round_ in range(begun, ROUNDS):
        scale = max(_scale(space, here, width), 1.0)
        lost = round_ >= PATIENCE * space.relations and scale > HOPELESS
        moves = Moves(space, judge, width, scale, trail)
        if full(space, here) or space.budget.late or (lost and space.budget.over):
            return here
        if space.budget.over:
            leaner = moves.drop(here)
            if leaner is None:
                return here
            here = leaner
            continue
        first, second = (moves.add, moves.drop) if scale > HOPELESS else (moves.drop, moves.add)
        far, moved = space.shared and np.isinf(width) and scale > NEAR_NOISE, None
        if far and (lost or round_ >= due):
            moved = moves.begin_anew(here)
        if moved is None and lost:
            return here
        if round_ >= due and scale <= NEAR_NOISE:
            moved = moves.leap(here, judge.expansion(here)) or moves.substitute(here, judge.expansion)
        if moved is None and round_ >= due:
            due, wait = round_ + wait, 2 * wait
        moved = moved or first(here) or moves.divide(here) or second(here)
        if moved is None and width <= LOOK_BACK:
            moved = moves.substitute(here, judge.expansion) or moves.look_back(here)
            moved = moved or moves.exchange(here, judge.expansion(here))
        if moved is None:
            return here
        telling, here = moved.cost < HALF * here.cost, moved
        if looked_at is not None and round_ + 1 >= begun + looked_at and not telling and space.fixed_constants(here):
            return here
    return here
