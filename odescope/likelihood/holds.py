"""What an input does between its samples, decided by the likelihood of one model under each hold.

docs/method.md, Inputs between samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from odescope.arrays import FloatArray, IntArray
from odescope.likelihood.evidence import between, in_blocks
from odescope.likelihood.fit import Fit
from odescope.likelihood.search import WHITE, WIDTHS
from odescope.likelihood.search_space import SearchSpace
from odescope.likelihood.searches import FOLLOWED
from odescope.recordings.coordinate import Hold

HINT = 1.0  # rise of the cost, in residual variances, up to which another hold is worth a look in joined segments
DEAREST = 10.0  # fall that makes it credible, and
SURE = 3.0  # standard deviations of that fall between blocks of the record, where misfit is no white noise
TRIAL_STEPS = 4  # of a refit, at most
TOLD = 2.0  # fall in joined segments that follow the record: between holds that cost the same it need not be large
LAG = 0.5  # samples that a held input comes later than one that runs linearly, all in all

Structure = tuple[FloatArray, IntArray]  # coefficients to begin with, and the numbers of what is present
Trial = tuple[SearchSpace, Fit]


@dataclass(frozen=True, eq=False)
class HoldChoice:
    """A model under the holds that suit the record best, the space with these, and the gain of each over linear.

    Gains are in log-likelihood at the residual variance, by input; only those whose hold was open and is not linear.
    """

    space: SearchSpace
    fit: Fit
    gains: dict[str, float]

    @property
    def holds(self) -> tuple[Hold, ...]:
        """What every input does between samples."""
        return holds_of(self.space)


def holds_of(space: SearchSpace) -> tuple[Hold, ...]:
    """Return what every input does between samples."""
    return () if space.segments.driven is None else space.segments.driven.holds


def under(space: SearchSpace, j: int, hold: Hold) -> SearchSpace:
    """Return a space under a hold of one of its inputs.

    Args:
        space: under the holds so far.
        j: number of the input.
        hold: of the input.
    """
    holds = holds_of(space)
    return space if hold == holds[j] else space.on(space.segments.held([*holds[:j], hold, *holds[j + 1 :]]))


def choose_holds(space: SearchSpace, found: Fit, open_: Mapping[str, Hold], width: float = float("inf")) -> HoldChoice:
    """Return the holds under which the structure that was found fits best, each input's in turn.

    All are judged on the same averages, in segments of their own. An input that is held looks late to one that runs
    linearly, by half a sample: where the delay is open, another hold has to be better than a delay, too, and better in
    joined segments, which tell more, each joined step by step from where it fits best. One that was chosen before that
    delay was found has to be better again: what the log shows needs no evidence, whatever else does, but for a hold
    that says at once what would else take a delay.

    Args:
        space: whose segments know the samples of their inputs.
        found: a model under the holds of the space.
        open_: the inputs whose holds are open, by name, and the hold that the log itself shows.
        width: of the defects of that model.
    """
    choice = HoldChoice(space, found, {})
    for j, name in enumerate(space.frame.inputs):
        if name in open_:
            choice = _chosen(choice, j, name, open_[name], width)
    return choice


def _chosen(choice: HoldChoice, j: int, name: str, seen: Hold, width: float) -> HoldChoice:
    """Return the choice with the best hold of input j, called so, of which the log shows that hold."""
    space, found = choice.space, choice.fit
    late = [k for k, m in enumerate(space.mechanisms) if m.kind == "delay" and m.place == name]
    delayed, now = bool(np.isin(late, found.present).any()), holds_of(space)[j]
    at_once, later = _structures(found, late)
    trials = _trials(space, found, j, [at_once, later] if delayed else [at_once], {})
    if now not in trials:
        return choice
    best = max(trials, key=lambda h: fall(trials[h], trials[now]))
    if best != now and late and not delayed:
        trials = _trials(space, found, j, [later], trials)
        best = max(trials, key=lambda h: fall(trials[h], trials[now]))
    usual = seen if seen in trials else now
    if best != usual and not _credible(trials[best], trials[usual]):
        best = usual
    gain: float | None = None
    if np.isfinite(width):
        if best == usual:
            best, gain = _best_joined(trials, usual, width, None if delayed or usual != now else (space, found))
        elif late and not _better_joined(trials[best], trials[usual], width):
            best = usual
    if late and best != "zero" and (now == "zero" or delayed or np.isin(late, trials[best][1].present).any()):
        held = _tried(space, found, j, at_once, "zero")
        running, prompt = (_tried(space, found, j, structure, best) for structure in (later, at_once))
        if held is not None and running is not None and _says_as_much(held, running, prompt, width):
            best, trials["zero"] = "zero", held
    gains = dict(choice.gains)
    if gain is None and best != "linear" and "linear" in trials:
        (_, linear), (there, fitted) = trials["linear"], trials[best]
        gain = 0.5 * (linear.cost - fitted.cost) / _scale(there, fitted)
    return HoldChoice(*trials[best], gains if gain is None else gains | {name: gain})


def _structures(found: Fit, late: list[int]) -> tuple[Structure, Structure]:
    """Return the structure without the delay of an input, and with one."""
    at_once = found.theta.copy()
    at_once[late] = 0.0
    return (at_once, np.setdiff1d(found.present, late)), (found.theta, np.union1d(found.present, late))


def _trials(
    space: SearchSpace, found: Fit, j: int, structures: Sequence[Structure], known: dict[Hold, Trial]
) -> dict[Hold, Trial]:
    """Return the best fit of some structures, and of those known already, under every hold of input j."""
    trials = dict(known)
    for hold in get_args(Hold):
        for structure in structures:
            trial = _tried(space, found, j, structure, hold)
            if trial is not None and (hold not in trials or fall(trial, trials[hold]) > 0.0):
                trials[hold] = trial
    return trials


def _tried(space: SearchSpace, found: Fit, j: int, structure: Structure, hold: Hold) -> Trial | None:
    """Return the fit of a structure under a hold of an input, in segments of their own; None where it is lost.

    Args:
        space: of the model.
        found: the model, whose states the fit begins with.
        j: number of the input.
        structure: coefficients to begin with, and the numbers of what is present.
        hold: of the input.
    """
    (theta, present), other = structure, under(space, j, hold)
    loose = np.full_like(space.segments.spread, np.inf)
    again = other.fit(as_late(space, j, theta, present, hold), present, found.x0, loose, found.strength, TRIAL_STEPS)
    return None if again is None else (other, again)


def _joined(trial: Trial, width: float) -> Trial | None:
    """Return the same in joined segments, which are joined step by step; None where it is lost.

    Args:
        trial: fitted in segments of their own.
        width: of the defects.
    """
    space, here = trial
    for tighter in (w for w in WIDTHS[1:] if w >= width):
        again = space.again(here, here.x0, space.segments.spread * tighter)
        if again is None:
            return None
        here = again
    return space, here


def refitted(joined: Trial, other: SearchSpace, width: float) -> Trial | None:
    """Return the same in a space under another hold, which hardly differs, in joined segments; None where it is lost.

    Args:
        joined: in joined segments.
        other: the space.
        width: of the defects.
    """
    again = other.again(joined[1], joined[1].x0, other.segments.spread * width)
    return None if again is None else (other, again)


def _best_joined(
    trials: Mapping[Hold, Trial], usual: Hold, width: float, joined: Trial | None
) -> tuple[Hold, float | None]:
    """Return the hold that is better than the usual one in joined segments, where those of their own do not tell.

    With it what it gains over linear in log-likelihood, where the usual one is linear, and another is better.

    What hardly changes from sample to sample, as the force of a swell on a ship, says little within a short segment.
    What a log shows to be held has to be worse by far: lines through its samples, half a sample later, are hardly so.

    Args:
        trials: holds in segments of their own.
        usual: what stands where nothing is better.
        width: of the defects.
        joined: the usual one in joined segments, where it is known.
    """
    near = [h for h in trials if h != usual and -HINT < fall(trials[h], trials[usual]) <= DEAREST]
    known = (joined or _joined(trials[usual], width)) if near else None
    if known is None:
        return usual, None
    others = {h: _joined(trials[h], width) if joined is None else refitted(joined, trials[h][0], width) for h in near}
    falls = {h: fall(other, known) for h, other in others.items() if other is not None}
    best = max(falls, key=falls.__getitem__, default=usual)
    least = TOLD if usual != "zero" and _scale(*known) < FOLLOWED else DEAREST
    if best == usual or not falls[best] > least:
        return usual, None
    return best, 0.5 * falls[best] if usual == "linear" else None


def _better_joined(best: Trial, usual: Trial, width: float) -> bool:
    """Say whether one hold is better than another in joined segments, too, or lost in them.

    Args:
        best: the hold that is better in segments of their own.
        usual: the other.
        width: of the defects.
    """
    better, worse = _joined(best, width), _joined(usual, width)
    return better is None or worse is None or fall(better, worse) > DEAREST


def _says_as_much(held: Trial, running: Trial, prompt: Trial | None, width: float) -> bool:
    """Say whether an input that is held and at once is no worse than one that runs on and is late.

    Half a sample late is what a held input is to one that runs linearly: there the hold alone says as much. That is
    asked in joined segments. Where the model does not hold in them, its misfit is no white noise: the delay must then
    be beyond doubt, if without it the hold is.

    Args:
        held: in segments of their own.
        running: the other.
        prompt: the other without its delay.
        width: of the defects.
    """
    if not np.isfinite(width):
        return prompt is not None and fall(held, prompt) > DEAREST and not _credible(running, held)
    simple, other = _joined(held, width), _joined(running, width)
    return simple is not None and other is not None and fall(simple, other) > 0.0


def as_late(space: SearchSpace, j: int, theta: FloatArray, present: IntArray, hold: Hold) -> FloatArray:
    """Return coefficients with the delay of input j, if present, so long that under a hold it acts when it does now.

    Args:
        space: with the hold that it has now.
        j: its number.
        theta: (mechanisms,) coefficients.
        present: numbers of the mechanisms in the model.
        hold: that it is to have.
    """
    driven, name, moved = space.segments.driven, space.frame.inputs[j], theta.copy()
    earlier = LAG * (int(hold == "zero") - int(holds_of(space)[j] == "zero"))
    for k in present.tolist():
        mechanism = space.mechanisms[k]
        if driven is not None and mechanism.kind == "delay" and mechanism.place == name:
            moved[k] -= earlier * driven.period
    return moved


def _scale(space: SearchSpace, found: Fit) -> float:
    """Return the residual variance over the noise variance."""
    freedom = max(space.segments.samples - found.x0.size - len(found.free), 1)
    return max(found.data_cost / freedom, 1e-12)


def fall(better: Trial, worse: Trial) -> float:
    """Return how much the priced cost of one is lower, in units of the better one's residual variance."""
    (space, found), (_, other) = better, worse
    return (other.cost - found.cost) / _scale(space, found) + space.price(other) - space.price(found)


def _credible(better: Trial, worse: Trial) -> bool:
    """Say whether the fall of the cost is large, also beside how it differs between blocks of the record.

    What leaves no more than white noise tells by its cost alone: that some blocks say more of an input that moves less
    in others is no doubt then.
    """
    if _scale(*better) < WHITE:
        return fall(better, worse) > DEAREST
    gains = in_blocks((_costs(*worse) - _costs(*better))[:, None]) / _scale(*better)
    spread = float(np.sqrt(between(gains)[0])) if len(gains) > 1 else 0.0
    return fall(better, worse) > max(DEAREST, SURE * spread)


def _costs(space: SearchSpace, found: Fit) -> FloatArray:
    """Return the cost of every segment, (J,)."""
    present, none = found.present, np.zeros(0, dtype=np.int64)
    return space.evaluator.integrate(space.program(present), found.theta[present], none, found.x0).cost
