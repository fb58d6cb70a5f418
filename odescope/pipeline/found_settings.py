"""What was found: mechanisms, and beside their coefficients holds and delays of inputs and offsets of sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from odescope.library.expression import ONE
from odescope.library.mechanism import Mechanism
from odescope.library.readable import readable
from odescope.likelihood.refinement import Refinement
from odescope.model.model import Model
from odescope.model.scores import DelayScore, HoldScore, OffsetScore, SuspicionScore
from odescope.signals.delays import Delay


def present_mechanisms(model: Model, refinement: Refinement | None) -> tuple[Mechanism, ...]:
    """Return the mechanisms that the model was fitted with, where the likelihood stage knows them."""
    if refinement is None or not model.mechanisms:
        return ()
    return tuple(refinement.space.mechanisms[k] for k in refinement.fit.present)


def hold_scores(model: Model, refinement: Refinement | None) -> dict[str, HoldScore]:
    """Return the holds of inputs that are better than linear or as good as another, and of those that step."""
    if refinement is None:
        return {}
    gains, found = refinement.hold_gains, refinement.settings.holds
    there = [i for i in model.inputs if i.name in gains and i.hold == found.get(i.name)]
    placed = {i.name: refinement.steps[i.name] for i in model.inputs if i.name in refinement.steps}
    scores = {i.name: HoldScore(i.hold, float(gains[i.name])) for i in there}
    scores |= {name: HoldScore("zero", None, count) for name, count in placed.items()}
    open_ = {name: other for name, other in refinement.undecided.items() if name in found}
    return scores | {name: HoldScore(found[name], gains.get(name), other=other) for name, other in open_.items()}


def delay_scores(estimated: Mapping[str, Delay], model: Model, refinement: Refinement | None) -> dict[str, DelayScore]:
    """Return the delays that were looked for, as the likelihood has them where it found more.

    Args:
        estimated: those of the regression, by input.
        model: whose inputs have what was found.
        refinement: what the likelihood led to.
    """
    delays = {name: DelayScore(d.seconds, d.std_error) for name, d in estimated.items()}
    found = {} if refinement is None else refinement.settings.delays
    acts = {i.name: i.delay for i in model.inputs}
    return delays | {name: DelayScore(acts[name], d.std_error) for name, d in found.items() if acts[name]}


def offset_scores(model: Model, refinement: Refinement | None) -> dict[str, OffsetScore]:
    """Return the offsets of the model's coordinates, as the likelihood has them."""
    found = {} if refinement is None else refinement.settings.offsets
    return {c.name: found[c.name] for c in model.coordinates if c.offset}


def suspicion_scores(
    suspicions: Sequence[SuspicionScore], model: Model, refinement: Refinement | None
) -> tuple[SuspicionScore, ...]:
    """Return what was suspected, with those of the functions found that the model holds, as its equations show them.

    A relation whose target one product multiplies is shown divided by that: I*sqrt(G) in I*G_dot is sqrt(G) there.

    Args:
        suspicions: what was made of each.
        model: as it is in the end.
        refinement: what the likelihood led to.
    """
    if refinement is None:
        return tuple(suspicions)
    shown = dict[str, dict[str, str]]()
    for number, target in enumerate(refinement.space.frame.targets):
        alone = [r.left[0].term for r in model.relations if r.targets == (target,) and len(r.left) == 1]
        by = alone[0].inverse if len(alone) == 1 else ONE
        parts = (p for k in refinement.fit.present for p in refinement.space.mechanisms[k].parts)
        terms = [p.product.term for p in parts if p.relation == number]
        shown[target] = {readable(term): readable(term * by) for term in terms}
    return tuple(
        msgspec.structs.replace(s, found=tuple(shown[s.target][f] for f in s.found if f in shown[s.target]))
        for s in suspicions
    )
