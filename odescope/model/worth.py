"""What a model is worth as a whole, in a sentence, from its scores."""

from __future__ import annotations

from odescope.model.choice_notes import imitating, listed, some
from odescope.model.free_run_notes import grows_by_itself
from odescope.model.scores import Doubts, Likelihood, ModelScores

FLOWS = 'name what flows in or out as inputs, or add reactions with the world outside, such as "-> S" and "S ->"'
ONE_OF_TWO = "of two states one of which was measured the law is one equation with order = 2"
MINOR = 0.1  # of the root mean square of every target: noise of the process that leaves a model most of the say
MUCH = 0.3  # of the root mean square of a target, that a model leaves: no disturbance of what was measured whole
FAR = 0.5  # standard deviations of the record: free runs further off say that little is known
OPEN = 0.1  # drift of a sum: no small leak, and no gain of a sensor that is a little off
HALF = 0.5  # of the variance of a target: a regression that predicts less is no law yet
FEW = 3  # terms in doubt that the sentence names
NEXT_TO_NOTHING = 0.0005  # of the root mean square of a target: less is not told


def uncertain(scores: ModelScores | None) -> str:
    """Return a sentence that says why a model is uncertain as a whole; nothing where no score says so.

    A model that does not follow the record is, and so is one that only follows it with process noise and leaves much to
    that, or whose reactions keep what the record does not, or whose free runs over what it was not fitted to go far
    off. Those of a chaotic system do for any law: its likelihood answers for one that follows without such noise, or
    with little of it where errors grow by themselves.
    """
    if scores is None:
        return ""
    judged = scores.likelihood
    if judged is not None and not judged.follows:
        return "uncertain: even in short segments this model does not follow the record to within its noise"
    if judged is not None and judged.truncated and judged.residual_variance is not None:
        return (
            "uncertain: with as few terms as [likelihood] terms asks for, this model misses the record by"
            f" {judged.residual_variance**0.5:.2g} times its noise"
        )
    noisy = judged is not None and bool(judged.process_noise)
    lacking = [c.sum for c in scores.conserved if c.drift is not None and c.drift > OPEN]
    if noisy and lacking:
        return f"uncertain: these reactions would keep {listed(lacking)} constant, but the record does not: {FLOWS}"
    for step in scores.path if noisy and not _parts_as_any(scores) else ():
        if step.chosen and step.error is not None and step.error > FAR:
            return (
                f"uncertain: run freely over what it was not fitted to, this model is off by {step.error:.2g} times the"
                " standard deviation of the record"
            )
    if parts := much(judged):
        left = listed([f"{share(part)} of {target}" for target, part in parts.items()])
        return f"uncertain: this model leaves {left} unexplained, by root mean squares"
    poor = [(t, s.telling_r2) for t, s in scores.targets.items() if s.telling_r2 is not None]
    least = min(poor, key=lambda pair: pair[1], default=None)
    if judged is None and least is not None and least[1] < HALF:
        return f"uncertain: on held-out data this model predicts {share(least[1])} of the variance of {least[0]}"
    return ""


def verdict(scores: ModelScores | None, doubts: Doubts | None, warned: bool) -> str:
    """Return in a sentence what a model is worth, uncertain or not; nothing where no likelihood has judged it.

    Args:
        scores: of the model.
        doubts: of the likelihood stage, where it ran.
        warned: whether anything is warned of.
    """
    judged = None if scores is None else scores.likelihood
    if (doubt := uncertain(scores)) or scores is None or judged is None:
        return doubt
    if judged.exact:
        within = " to within its noise"
    else:
        shares = judged.unexplained or {}
        left = [f"{share(part)} of {t}" for t, part in shares.items() if part > NEXT_TO_NOTHING]
        left = left or [f"less than {share(NEXT_TO_NOTHING)} of every target"]
        within = f" but for {listed(left)}" if shares else ""
    doubtful = _doubtful(scores, doubts)
    if judged.exact and not doubtful:
        doubtful = ["what may be in doubt is warned of below" if warned else "no term of it is in doubt"]
    return "; ".join([f"this model follows the record{within}", *doubtful])


def _doubtful(scores: ModelScores, doubts: Doubts | None) -> list[str]:
    """Return clauses on what of a model may be something else.

    Args:
        scores: of the model.
        doubts: of the likelihood stage, where it ran.
    """
    said = list[str]()
    if targets := imitating(scores.suspicions):
        said.append(f"what it has for {listed(targets)} may imitate another function")
    unsure = () if doubts is None else (*doubts.thin, *doubts.alike)
    if terms := list(dict.fromkeys(f"{term} in {target}" for term, target, _ in unsure)):
        said.append(f"in doubt {'is' if len(terms) == 1 else 'are'} {listed(some(terms, FEW))}")
    return said


def _parts_as_any(scores: ModelScores) -> bool:
    """Say whether a model leaves little to noise of the process and parts from its record where any law would."""
    judged = scores.likelihood
    shares = {} if judged is None or judged.unexplained is None else judged.unexplained
    return max(shares.values(), default=1.0) < MINOR and grows_by_itself(scores.free_runs, judged)


def much(judged: Likelihood | None) -> dict[str, float]:
    """Return the targets of which a model leaves much unexplained, and what share."""
    shares = None if judged is None else judged.unexplained
    return {t: part for t, part in (shares or {}).items() if part > MUCH}


def share(part: float) -> str:
    """Return a part of 1 as a percentage that is not rounded up to the whole."""
    return "more than 99.99 %" if 0.9999 < part < 1.0 else f"{100.0 * part:.2f} %"
